"""Self-contained pages: words, tables, figures and motions in one file."""

from tog_mjx.drawing.report.page import Picture as Picture
from tog_mjx.drawing.report.page import Section as Section
from tog_mjx.drawing.report.page import Table as Table
from tog_mjx.drawing.report.page import write_page as write_page
