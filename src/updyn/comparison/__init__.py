"""Comparison of methods on the same model, data, lines and unknowns, with one row per method."""

from updyn.comparison.bench import compare, compare_jointly
from updyn.comparison.fewest import Fewest
from updyn.comparison.table import Comparison, Row

__all__ = ["Comparison", "Fewest", "Row", "compare", "compare_jointly"]
