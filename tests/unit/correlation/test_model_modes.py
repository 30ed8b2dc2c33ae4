"""The modes of a model: computed once, with the values and warnings of separate computations."""

import warnings

import numpy as np
import pytest

import updyn
from updyn.correlation import model_modes
from updyn.correlation.model_modes import ModelModes
from updyn.errors import DataError, UpdynWarning

N = 6
LABELS = [f"{i + 1}:Z" for i in range(N)]


def chain(lowest=1.0):
    """A chain of unit masses; `lowest` scales the spring to ground."""
    K = 1e4 * (2.0 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1))
    K[0, 0] = 1e4 * (1.0 + lowest)
    return updyn.Model.from_groups({"all": updyn.Group(K, np.eye(N), loss_factor=0.02)}, LABELS)


@pytest.fixture
def solved(monkeypatch):
    """Highest frequencies of the eigenvalue problems that are solved."""
    found = []

    def modes_up_to(model, highest, most):
        found.append(highest)
        return updyn.dynamics.modes.modes_up_to(model, highest, most)

    monkeypatch.setattr(model_modes, "modes_up_to", modes_up_to)
    return found


def test_a_lower_range_is_selected_and_a_higher_one_computed(solved):
    frequency = updyn.modes(chain(), N).frequency
    modes = ModelModes(chain())
    middle = 0.5 * (frequency[3] + frequency[4])
    np.testing.assert_allclose(modes.undamped(middle).frequency, frequency[:4], rtol=1e-9)
    np.testing.assert_allclose(modes.up_to(middle).frequency, frequency[:5], rtol=1e-9)
    lower = 0.5 * (frequency[1] + frequency[2])
    np.testing.assert_allclose(modes.undamped(lower).frequency, frequency[:2], rtol=1e-9)
    np.testing.assert_allclose(modes.up_to(lower).frequency, frequency[:3], rtol=1e-9)
    assert solved == [middle]
    highest = 2.0 * frequency[-1]
    np.testing.assert_allclose(modes.up_to(highest).frequency, frequency, rtol=1e-9)
    assert solved == [middle, highest]
    with pytest.raises(DataError, match=r"no mode above 0 and up to 1 Hz"):
        modes.undamped(1.0)


def test_complex_modes_are_those_of_the_model(solved, monkeypatch):
    calls = []
    monkeypatch.setattr(
        model_modes,
        "complex_modes_of",
        lambda *given: calls.append(given) or updyn.dynamics.modes.complex_modes_of(*given),
    )
    expected = updyn.modes(chain(), N, complex=True)
    modes = ModelModes(chain())
    for number in (4, 2):
        highest = 0.5 * (expected.frequency[number - 1] + expected.frequency[number])
        found = modes.damped(highest)
        np.testing.assert_allclose(found.frequency, expected.frequency[:number], rtol=1e-9)
        np.testing.assert_allclose(found.loss_factor, expected.loss_factor[:number], rtol=1e-6)
    assert len(solved) == len(calls) == 1


def test_a_warning_is_repeated(solved):
    with pytest.warns(UpdynWarning, match="stiffness is indefinite"):
        unstable = chain(lowest=-0.9)
    modes = ModelModes(unstable)
    for _ in range(2):
        with pytest.warns(UpdynWarning, match="negative omega"):
            modes.undamped(30.0)
    assert len(solved) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ModelModes(chain()).undamped(30.0)


def test_a_fixed_base_is_another_model():
    freq = np.linspace(5.0, 30.0, 20)
    modes = ModelModes(chain())
    forced = updyn.response(modes.model, freq, LABELS[1:], LABELS[:1])
    assert modes.hold_base(forced)[0] is modes
    moved = updyn.response(modes.model, freq, LABELS[1:], LABELS[:1], "transmissibility", base=LABELS[:1])  # fmt: skip
    held, data = modes.hold_base(moved)
    assert held is not modes
    assert held.model.n_dofs == N - 1
    assert data.responses.labels == LABELS[1:]
