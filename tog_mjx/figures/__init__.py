"""The paper's figures, one file each."""

from tog_mjx.figures.descents import draw_descents as draw_descents
