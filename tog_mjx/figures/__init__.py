"""The paper's figures, one file each."""

from tog_mjx.figures.agreement import draw_agreement as draw_agreement
from tog_mjx.figures.descents import draw_descents as draw_descents
from tog_mjx.figures.landscapes import draw_landscape as draw_landscape
from tog_mjx.figures.motions import draw_motions as draw_motions
from tog_mjx.figures.setups import draw_setups as draw_setups
