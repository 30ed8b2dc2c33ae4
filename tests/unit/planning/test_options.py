"""Options of a plan: their limits."""

import numpy as np
import pytest

from updyn.errors import OptionError
from updyn.planning.options import StartDraws, find_lines


def test_a_plan_has_at_most_a_hundred_thousand_lines():
    assert len(find_lines(100_000, (1.0, 2.0))) == 100_000
    with pytest.raises(OptionError, match="expected 2 to 100,000 lines"):
        find_lines(100_001, (1.0, 2.0))


def test_a_plan_has_at_most_a_thousand_starts():
    assert StartDraws(1_000, 0.2, 0).robust == 1_000
    with pytest.raises(OptionError, match="expected at most 1,000 starts"):
        StartDraws(1_001, 0.2, 0)


def test_lines_include_both_ends():
    assert find_lines(3, (1.0, 2.0)) == pytest.approx(np.array([1.0, 1.5, 2.0]))
