"""Sizes from which candidates are screened, sampled and refused."""

from types import SimpleNamespace

import numpy as np
import pytest

from updyn.dofs import DofSet
from updyn.errors import OptionError
from updyn.planning.information import check_size
from updyn.planning.screening import _sample_dofs, is_many


def candidates(n_responses, n_references):
    return SimpleNamespace(
        part=SimpleNamespace(n=1), responses=range(n_responses), references=range(n_references)
    )


def test_more_than_forty_thousand_pairs_are_screened():
    assert not is_many(candidates(200, 200))
    assert is_many(candidates(200, 201))


def test_the_information_of_all_pairs_takes_at_most_a_gibibyte():
    check_size(candidates(2**14, 2**13), 1)  # 8 bytes for each pair and start
    with pytest.raises(OptionError, match="expected at most 1; name fewer candidates"):
        check_size(candidates(2**14, 2**13 + 1), 1)


def test_samples_have_forty_translations_and_forty_rotations():
    dofs = DofSet([f"{i}:{axis}" for i in range(1, 61) for axis in ("X", "RX")])
    sampled = _sample_dofs(dofs)
    assert np.count_nonzero(dofs.axes[sampled] < 3) == 40
    assert np.count_nonzero(dofs.axes[sampled] >= 3) == 40
    assert _sample_dofs(DofSet(["1:X", "2:X"])).tolist() == [0, 1]
