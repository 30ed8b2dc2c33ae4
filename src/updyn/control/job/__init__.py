"""Control tables of a job: their checks, the plant that they ask for, and its record."""

import updyn.job  # noqa: F401  # its schema holds tables of this package: it has to be loaded first
