"""Numbers of the fits of poles: when steps, sweeps and further poles end."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import updyn
from updyn.modal import continuation, identify, refine, runs, vector_fitting
from updyn.modal.axis import Axis
from updyn.modal.envelope import Envelope
from updyn.modal.refine import WindowFit

WINDOW = SimpleNamespace(width=lambda poles: np.full(len(poles), 0.1))


class Fit:
    """A fit whose steps have this length in widths and this expected decrease."""

    def __init__(self, length: float, decrease: float) -> None:
        self.poles, self.cost = np.array([1.0 + 0.1j]), 1.0
        self._length, self._decrease = length, decrease

    def compute_damped_step(self, damping: float):
        return np.array([0.1 * self._length + 0j]), self._decrease


def count_fits(monkeypatch, length: float = 1.0, decrease: float = 1.0) -> int:
    """Return the number of fits of given poles in a search for the best."""
    made = []

    def fit(window, poles, weights):
        made.append(poles)
        return Fit(length, decrease)

    monkeypatch.setattr(refine, "fit_residues", fit)
    refine.fit_poles(WINDOW, np.array([1.0 + 0.1j]), None)
    return len(made)


def test_steps_of_a_fit_are_limited(monkeypatch):
    assert count_fits(monkeypatch) == 1 + 30


@pytest.mark.parametrize(("length", "ends"), [(0.9e-10, True), (1.1e-10, False)])
def test_a_fit_ends_with_a_small_step(monkeypatch, length, ends):
    assert (count_fits(monkeypatch, length=length) == 1) is ends


@pytest.mark.parametrize(("decrease", "ends"), [(0.9e-3, True), (1.1e-3, False)])
def test_a_fit_ends_with_a_small_decrease(monkeypatch, decrease, ends):
    assert (count_fits(monkeypatch, decrease=decrease) == 1) is ends


def test_weights_are_estimated_twice(monkeypatch):
    made = []
    monkeypatch.setattr(refine, "fit_poles", lambda *given: made.append(given) or Fit(1.0, 1.0))
    monkeypatch.setattr(refine.Weights, "from_residual", lambda fitted: None)
    refine.fit_with_unknown_noise(WINDOW, np.array([1.0 + 0.1j]), None)
    assert len(made) == 1 + 2


def test_a_residual_contains_a_twentieth_of_the_noise():
    columns = SimpleNamespace(Q=np.ones((2, 1)), leverage=lambda: np.array([[1.0, 0.96, 0.9]]))
    fit = SimpleNamespace(
        error=np.ones((1, 3)), columns=columns, envelope=Envelope.white(), squared_error=1.0
    )
    found = WindowFit.unbiased_squared_error.fget(fit)
    assert found.ravel() == pytest.approx([20.0, 20.0, 10.0])


# -- cross-validation ------------------------------------------------------------------------------
def selected(monkeypatch, errors: list[float]) -> tuple[int, int]:
    """Return the position of the selected fit, and the number of fits made."""
    made = []

    class Poles(int):
        """A number of poles that has a length."""

        def __len__(self) -> int:
            return 1

    def fits(basis, x, Y, first, largest):
        if isinstance(first, Poles):  # the fit of all lines
            yield first
            return
        for number, error in enumerate(errors):
            made.append(number)
            values = np.full((4, 1), 1.0 + error)
            yield SimpleNamespace(at=lambda x, values=values: values, poles=Poles(number))

    monkeypatch.setattr(vector_fitting, "fit_increasing_orders", fits)
    whole, _ = vector_fitting.fit_by_cross_validation(
        None, np.ones(8), np.ones((8, 1)), np.zeros(1), 9
    )
    return int(whole), max(made) + 1


@pytest.mark.parametrize(("least", "made"), [(0.981, 5), (0.979, 10)])
def test_poles_are_added_while_four_improve_the_prediction(monkeypatch, least, made):
    errors = [1.0, 1.0, 1.0, 1.0, least, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3]
    assert selected(monkeypatch, errors)[1] == made


@pytest.mark.parametrize(("factor", "best"), [(1.049, 0), (1.051, 1)])
def test_the_fewest_poles_predict_nearly_as_well(monkeypatch, factor, best):
    assert selected(monkeypatch, [factor, 1.0])[0] == best


@pytest.mark.parametrize(("error", "made"), [(0.9e-10, 1), (1.1e-10, 3)])
def test_an_exact_prediction_ends_the_fits(monkeypatch, error, made):
    assert selected(monkeypatch, [error, error, error])[1] == made


# -- data without noise ----------------------------------------------------------------------------
@pytest.mark.parametrize(("lines", "tried"), [(160, True), (161, False)])
def test_few_lines_are_first_treated_as_free_of_noise(monkeypatch, lines, tried):
    frf = updyn.FRF(
        np.arange(1.0, lines + 1.0), np.ones((lines, 1, 1)), ["1:X"], ["1:X"], "mobility"
    )

    def stop(text):
        def ended(*given):
            raise RuntimeError(text)

        return ended

    monkeypatch.setattr(identify, "_identify_noise_free", stop("exact"))
    monkeypatch.setattr(identify, "find_stable_poles", stop("noisy"))
    with pytest.raises(RuntimeError, match="exact" if tried else "noisy"):
        identify.identify_with_picks(frf, None, "structural", ())


def test_combinations_and_lines_of_an_exact_fit(monkeypatch):
    tried = []

    def find(basis, x, few, begin, most):
        tried.append((few.shape, len(begin)))

    monkeypatch.setattr(identify, "_find_exact_poles", find)
    rng = np.random.default_rng(0)
    freq = np.arange(1.0, 161.0)
    data = SimpleNamespace(
        axis=Axis(False, 1000.0), freq=freq, x=freq + 0j, cube=rng.standard_normal((160, 5, 4)) + 0j
    )
    assert identify._identify_noise_free(data) == []
    assert tried == [((160, 12), 4)]
    assert identify._fit_exactly(data, np.zeros(4), 5) is None
    assert tried[1] == ((40, 12), 4)  # every fourth line, 8 for each of 5 poles


# -- decay -----------------------------------------------------------------------------------------
@pytest.mark.parametrize(("lines", "most"), [(80, 20), (400, 40)])
def test_poles_for_the_removal_of_a_decay(monkeypatch, lines, most):
    given = {}

    def fit(basis, x, flat, begin, largest):
        given.update(flat=flat, begin=begin, largest=largest)
        raise RuntimeError

    monkeypatch.setattr(continuation, "fit_by_cross_validation", fit)
    values = np.ones((lines, 3, 1)) * np.array([1.0, 0.11, 0.05])[None, :, None]
    freq = np.arange(1.0, lines + 1.0)
    frf = updyn.FRF(freq, values, ["1:X", "2:X", "3:X"], ["1:X"], "accelerance", decay=0.5)
    with pytest.raises(RuntimeError):
        continuation.remove_decay(frf)
    assert given["largest"] == most
    assert len(given["begin"]) == 4
    assert given["begin"].imag / given["begin"].real == pytest.approx(0.01)
    # The rms of each channel is one, unless it is below a tenth of the largest.
    assert np.sqrt(np.mean(np.abs(given["flat"]) ** 2, axis=0)) == pytest.approx([1.0, 1.0, 0.5])


def test_three_modes_have_poles_for_each_run():
    criterion = runs._Criterion(None, list(range(6)), 5, 1.0)
    assert criterion.most == 3


# -- noise of channels ---------------------------------------------------------------------------
@pytest.mark.parametrize("unit", [1e-120, 1.0, 1e120])
def test_noise_does_not_depend_on_the_unit_of_a_channel(unit):
    rng = np.random.default_rng(0)
    size = np.abs(rng.standard_normal((3, 400))) * np.array([[1.0], [1e-20], [0.0]])
    squares = rng.exponential(size=size.shape) * (1e-4 * size + 1e-6 * size.mean(axis=1)[:, None])
    plain = refine.ChannelNoise.of(squares, size)
    found = refine.ChannelNoise.of(unit * squares, unit * size)
    assert found.share[:2] == pytest.approx(plain.share[:2], rel=1e-5)
    assert found.floor[:2] == pytest.approx(unit * plain.floor[:2], rel=1e-5)
    assert plain.share[:2] == pytest.approx([1e-4, 1e-4], rel=0.2)
    assert found.floor[2] > 0.0  # a channel without signal


def test_noise_of_exact_data_is_rounding():
    size = np.linspace(0.5, 1.0, 50)[None]
    found = refine.ChannelNoise.of(np.zeros((1, 50)), size)
    assert found.deviation(size) == pytest.approx(np.full((1, 50), 1e-12), rel=0.1)
