"""One self-contained page that holds a whole comparison: what was asked, what came out, every figure, every motion."""

from tog_mjx.drawing.report.page import Section as Section
from tog_mjx.drawing.report.page import write_report as write_report
