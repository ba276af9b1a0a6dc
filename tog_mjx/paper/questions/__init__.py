"""Questions about the two tasks: studies by name, and what they ask."""
