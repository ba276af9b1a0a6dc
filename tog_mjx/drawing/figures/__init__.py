"""Figures, one file each: arrays in, a figure out."""

from tog_mjx.drawing.figures.descents import draw_descents as draw_descents
from tog_mjx.drawing.figures.fading import draw_motions as draw_motions
from tog_mjx.drawing.figures.gradient_fields import draw_agreement as draw_agreement
from tog_mjx.drawing.figures.landscapes import draw_landscape as draw_landscape
