"""Public names of `updyn.report`, for type checkers and for the loader in `__init__.py`."""

from .acceptance import write_acceptance as write_acceptance
from .before import write_start as write_start
from .candidates import write_candidates as write_candidates
from .comparison import write_comparison as write_comparison
from .location import write_location as write_location
from .page import write_report as write_report
from .planning import write_plan as write_plan
from .start import Start as Start
