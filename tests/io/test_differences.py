"""Groups by difference: parts that are known come back, and what does not add up is refused."""

import numpy as np
import pytest
import scipy.sparse as sp

from updyn.dofs import DofSet
from updyn.errors import FormatError
from updyn.io.differences import Matrices, groups_by_difference
from updyn.io.settings import MATRIX_FILE

DOFS = DofSet(["1:X", "2:X", "3:X"])
SOFT = np.array([[2.0, -2.0, 0.0], [-2.0, 2.0, 0.0], [0.0, 0.0, 0.0]])
STIFF = 1e9 * np.array([[0.0, 0.0, 0.0], [0.0, 1.0, -1.0], [0.0, -1.0, 1.0]])
MASS = np.diag([0.0, 0.0, 7.3])


def deck(factor: dict[str, float], rest: float = 0.0) -> Matrices:
    K = factor.get("soft", 1.0) * SOFT + factor.get("stiff", 1.0) * STIFF + rest * np.eye(3)
    return sp.csr_array(K), sp.csr_array(factor.get("stiff", 1.0) * MASS)


def test_parts_come_back() -> None:
    groups = groups_by_difference(
        ["soft", "stiff"], deck({}), lambda name: deck({name: 2.0}), DOFS, "deck.inp"
    )
    K, M = groups["stiff"]
    np.testing.assert_allclose(K.toarray(), STIFF, rtol=1e-12)
    np.testing.assert_allclose(M.toarray(), MASS, rtol=1e-12)
    K, M = groups["soft"]
    np.testing.assert_allclose(K.toarray()[0], SOFT[0], rtol=1e-12)
    assert M is None
    # Where both meet, the soft spring is known no better than the stiff one is rounded.
    np.testing.assert_allclose(K.toarray()[1, 1], 2.0, atol=1e-13 * 1e9)


def test_a_part_of_no_group_is_refused() -> None:
    with pytest.raises(
        FormatError,
        match=r"deck.inp: the groups do not add up to K: at 1:X, 1:X the difference is 5",
    ):
        groups_by_difference(
            ["soft", "stiff"], deck({}, 5.0), lambda name: deck({name: 2.0}, 5.0), DOFS, "deck.inp"
        )
    with pytest.raises(FormatError, match="do not add up to M: at 3:X, 3:X"):
        groups_by_difference(
            ["soft", "stiff"],
            deck({}),
            lambda name: (deck({name: 2.0})[0], deck({})[1]),
            DOFS,
            "deck.inp",
        )


def test_a_rest_of_a_printed_digit_is_accepted() -> None:
    level = 2.0 * MATRIX_FILE.sum_tolerance

    def split(rest: float) -> None:
        groups_by_difference(
            ["soft", "stiff"],
            deck({}, rest),
            lambda name: deck({name: 2.0}, rest),
            DOFS,
            "deck.inp",
        )

    split(0.9 * level)
    with pytest.raises(FormatError, match="at 1:X, 1:X"):
        split(1.1 * level)


def test_another_size_is_refused() -> None:
    with pytest.raises(FormatError, match="'soft': K has 2 DOFs"):
        groups_by_difference(
            ["soft"], deck({}), lambda _: (sp.csr_array(np.eye(2)), None), DOFS, "deck.inp"
        )
