"""Which numbers of lines are tried for the fewest lines, and which answers count as recovered."""

from __future__ import annotations

from updyn.comparison.fewest import describe_rule


def test_the_rule_states_lines_and_standard_deviations():
    text = describe_rule(0.01, "even", truth=False)
    assert "Fewest lines: 1, 2, 3, 4, 5, 6, 8, 10, ... lines" in text
    assert "within 3 standard deviations" in text
