"""Information of each force level in the report."""

from __future__ import annotations

from updyn.report.section import PageContent, ReportSection

__all__ = ["LEVELS"]


class _LevelsSection(ReportSection):
    """Standard deviations with fewer and with further force levels."""

    anchor = "levels"
    name = "Force levels"
    heading = "Information of the force levels"
    place = 550
    template = "updyn.report/levels.html"

    def applies(self, content: PageContent) -> bool:
        """Whether the page shows an update."""
        return content.update is not None

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the recommended level and both tables."""
        found = content.further["levels"]
        head, rows = found.deviation_table()
        candidate_head, candidates = found.candidate_table()
        return {
            "statement": found.statement,
            "head": head,
            "rows": rows,
            "candidate_head": candidate_head,
            "candidates": candidates,
            "kinds": ["", "", "", "word", "word"],
        }


LEVELS = _LevelsSection()
