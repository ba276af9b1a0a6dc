"""The paper's figures, one file each."""

from tog_mjx.figures.agreement import draw_agreement as draw_agreement
from tog_mjx.figures.descents import draw_descents as draw_descents
