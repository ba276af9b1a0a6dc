"""From an MJCF file to a model: its names, its contact law, what MJX supports of it, and what follows from a number."""
