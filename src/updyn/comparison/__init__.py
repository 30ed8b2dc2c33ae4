"""Every method on one bench: the same model, data, lines and unknowns, one row for each method."""

from updyn.comparison.fewest import Fewest
from updyn.comparison.rows import Comparison, Row
from updyn.comparison.verbs import compare, compare_jointly

__all__ = ["Comparison", "Fewest", "Row", "compare", "compare_jointly"]
