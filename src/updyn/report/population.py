"""Mean and scatter over specimens in the report."""

from __future__ import annotations

from updyn.population.result import HEADINGS
from updyn.report.section import PageContent, ReportSection

__all__ = ["POPULATION"]


class _PopulationSection(ReportSection):
    """Mean and scatter of the unknowns over specimens."""

    anchor = "population"
    name = "Population"
    heading = "Specimens"
    place = 46
    template = "updyn.report/population.html"
    first_screen = True

    def applies(self, content: PageContent) -> bool:
        """Whether the page shows an update."""
        return content.update is not None

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the statement, the unknowns, and the values of each specimen."""
        found = content.further["population"]
        names = list(found.mean)
        return {
            "statement": found.statement,
            "head": list(HEADINGS),
            "rows": found.rows(),
            "kinds": ["text"],
            "specimen_head": ["specimen", *names],
            "specimens": [
                [name, *(f"{one.values[unknown]:.5g}" for unknown in names)]
                for name, one in found.specimens.items()
            ],
            "notes": [f"{name} is not used: {why}" for name, why in found.excluded.items()],
        }


POPULATION = _PopulationSection()
