"""Results as figures, in one self-contained page."""

from updyn.control.report.plant_page import write_plant_page
from updyn.report.comparison import write_comparison
from updyn.report.page import write_report

__all__ = ["write_comparison", "write_plant_page", "write_report"]
