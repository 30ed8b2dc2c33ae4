"""Results as figures, in one self-contained page."""

from updyn.report.page import write_report

__all__ = ["write_report"]
