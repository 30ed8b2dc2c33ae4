"""Control tables of a job: their checks, the requested plant and its record."""

import updyn.job  # noqa: F401  # first, as its schema uses tables of this package
