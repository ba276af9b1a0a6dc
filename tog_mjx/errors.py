"""The one exception for bad input."""


class InputError(ValueError):
    """Bad input, told in one line: what is wrong, where, and the remedy. Scripts print it and exit with status 2."""
