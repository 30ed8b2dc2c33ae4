"""Numbers that decide how methods are compared."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FewestLinesSettings:
    """Numbers of the search for the fewest lines."""

    #: [lines] Numbers of lines that are tried before all lines. Why: a rule of thumb; every number
    #: up to 6, then ratios of 1.25 to 1.5.
    counts: tuple[int, ...] = (
        *(1, 2, 3, 4, 5, 6, 8, 10, 15, 20, 30, 40, 60, 80),
        *(100, 150, 200, 300, 400, 600, 800, 1000),
    )
    #: [std] Distance from the estimate with all lines within which an unknown is recovered. Why:
    #: 0.3 % of normal errors are larger.
    most_stds: float = 3.0


FEWEST_LINES = FewestLinesSettings()
