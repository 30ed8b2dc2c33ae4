"""Limits of accepted solutions and of the message on a singular matrix, by value."""

from __future__ import annotations

import numpy as np
import pytest

from updyn.linalg.solver import _BackendChoice, singular_message


def test_backward_errors_that_are_accepted() -> None:
    assert _BackendChoice("superlu").residual == 1e-8
    assert _BackendChoice("pardiso", single=True).residual == 1e-4


@pytest.mark.parametrize(("ratio", "is_named"), [(0.9e9, False), (1.1e9, True)])
def test_stiffnesses_too_far_apart_are_named(ratio: float, is_named: bool) -> None:
    message = singular_message(5.0, scale=np.sqrt([1.0, ratio]))
    assert ("too far apart" in message) is is_named
