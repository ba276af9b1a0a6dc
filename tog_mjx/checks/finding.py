"""What a check says, and what all of them say together."""

import enum


class Level(enum.IntEnum):
    """How much a finding weighs: nothing, read it before you rely on the gradient, do not rely on it."""

    FINE = 0
    CARE = 1
    FAULT = 2
