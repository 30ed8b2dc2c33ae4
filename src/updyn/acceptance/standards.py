"""Limits of standards for the agreement of a spacecraft's model with its modal survey."""

from __future__ import annotations

from updyn.acceptance.limits import AcceptanceLimits
from updyn.errors import OptionError, suggest

__all__ = ["STANDARDS", "find_limits"]

_SECONDARY = (
    "From secondary sources: the text of the standard was not at hand when the limits were entered,"
    " and no clause is cited. Compare them with the issue that the contract names, and state those"
    " that differ."
)

#: Limits by standard. NASA-STD-5002: 5 % and 0.9 / 0.1 as quoted in the literature on modal
#: surveys of spacecraft, such as J. C. Akers & J. Sills, Topics in Modal Analysis & Parameter
#: Identification (0.90 and 0.10 as the least acceptable values of cross-orthogonality).
#: ECSS-E-ST-32-11C: criteria of correlation by class of modes; no publication that quotes them was
#: compared.
STANDARDS: dict[str, AcceptanceLimits] = {
    "NASA-STD-5002": AcceptanceLimits(
        "NASA-STD-5002", frequency=0.05, cross=0.9, cross_off=0.1, source=_SECONDARY
    ),
    "ECSS-E-ST-32-11C": AcceptanceLimits(
        "ECSS-E-ST-32-11C",
        frequency=0.10,
        mac=0.8,
        frequency_major=0.05,
        mac_major=0.85,
        frequency_fundamental=0.03,
        mac_fundamental=0.9,
        cross=0.9,
        cross_off=0.1,
        effective_mass=0.1,
        source=_SECONDARY,
    ),
}


def find_limits(standard: str | AcceptanceLimits) -> AcceptanceLimits:
    """Return the limits of a standard; OptionError names the nearest standard."""
    if isinstance(standard, AcceptanceLimits):
        return standard
    if standard not in STANDARDS:
        raise OptionError(
            f"standard {standard!r}: {suggest(str(standard), STANDARDS)}", key=("standard",)
        )
    return STANDARDS[standard]
