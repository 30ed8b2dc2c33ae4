"""Report sections, figures and page of a plant, its servo loops and non-linear elements."""

import updyn.job
import updyn.report  # noqa: F401  # its page imports sections of this package: loaded first
