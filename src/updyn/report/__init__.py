"""Self-contained HTML pages with the figures of results."""

from updyn.report.acceptance import write_acceptance
from updyn.report.before import write_start
from updyn.report.candidates import write_candidates
from updyn.report.comparison import write_comparison
from updyn.report.location import write_location
from updyn.report.page import write_report
from updyn.report.planning import write_plan
from updyn.report.start import Start

__all__ = [
    "Start",
    "write_acceptance",
    "write_candidates",
    "write_comparison",
    "write_location",
    "write_plan",
    "write_report",
    "write_start",
]
