"""The paper: its two tasks, Table I, its figures and published numbers, and what only they need."""
