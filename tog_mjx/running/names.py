"""Names that a room knows and a higher one gives: the paper's problems and its engine."""

import importlib


def load_givers() -> None:
    """Imports what gives them: of a part that was imported alone, it may not be there yet."""
    importlib.import_module(f"{__name__.partition('.')[0]}.paper.tasks")
