"""The uncertainty of fits, whatever the causes of their residual."""

from cause_search import no_causes_in_folder

__all__ = ["no_causes_in_folder"]
