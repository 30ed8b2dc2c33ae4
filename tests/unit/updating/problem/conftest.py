"""The problem of a fit, whatever the causes of its residual."""

from cause_search import no_causes_in_folder

__all__ = ["no_causes_in_folder"]
