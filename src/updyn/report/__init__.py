"""Results as figures, in one self-contained page."""

from updyn.report.comparison import write_comparison
from updyn.report.page import write_report
from updyn.report.planning import write_plan

__all__ = ["write_comparison", "write_plan", "write_report"]
