"""A section of the report about what ``[toy]`` gave."""

from updyn.report.section import ReportSection


class Energy(ReportSection):
    """Names and values in a list."""

    anchor = "toy"
    name = heading = "Toy values"
    place = 450.0
    template = "toy_updyn/energy.html"

    def context(self, content):
        """Return the values."""
        return {"values": content.further["toy"]}


ENERGY = Energy()
