"""Numbers as text."""

from __future__ import annotations

import pytest

from updyn.text_table import format_change


@pytest.mark.parametrize(
    ("factor", "digits", "text"),
    [
        (1.0, 3, "0 %"),
        (1.000004, 3, "0 %"),
        (1.00001, 3, "+0.001 %"),
        (1.2345, 3, "+23.4 %"),
        (0.5, 3, "−50 %"),
        (3.4567, 2, "+246 %"),
        (10.0, 3, "×10"),
        (1234.0, 3, "×1234"),
    ],
)
def test_changes_by_a_factor(factor, digits, text):
    assert format_change(factor, digits) == text
