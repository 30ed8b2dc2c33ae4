"""Recovered strains and stresses: closed forms, differences, and how often their bands are right."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

import updyn
from uncertain_cases import LINES, fit_lower, in_series, noisy, ungrounded_chain
from updyn.errors import DofError, OptionError

STRETCH = updyn.Recovery(["upper", "sum"], ["1:X", "2:X"], [[-1.0, 1.0], [1.0, 1.0]], "m")


@pytest.fixture(scope="module")
def result() -> updyn.UpdateResult:
    return fit_lower(0)


def test_values_are_the_matrix_times_the_receptances(result) -> None:
    band = updyn.predict_recovered(result, LINES, STRETCH, ["1:X"])
    H = updyn.response(result.model, LINES, ["1:X", "2:X"], ["1:X"]).values
    np.testing.assert_allclose(band.values[:, 0], H[:, 1] - H[:, 0], rtol=1e-9)
    np.testing.assert_allclose(band.values[:, 1], H[:, 1] + H[:, 0], rtol=1e-9)
    assert band.names == ("upper", "sum")
    assert (band.unit, band.level) == ("m", 0.95)


def test_deviations_are_those_of_differences(result) -> None:
    """Each independent combination of the unknowns, moved by a thousandth of its deviation."""
    band = updyn.predict_recovered(result, LINES, STRETCH, ["1:X"])
    root = np.linalg.cholesky(result.covariance)
    here = np.array([result.values[name] for name in result.parameters.names])
    slopes, step = [], 1e-3
    for column in root.T:
        ends = []
        for side in (step, -step):
            model = result.parameters.apply(result.start, here + side * column)
            H = updyn.response(model, LINES, ["1:X", "2:X"], ["1:X"]).values
            ends.append(H[:, 1] - H[:, 0])
        slopes.append((ends[0] - ends[1]) / (2.0 * step))
    std = np.sqrt(np.sum(np.real(slopes) ** 2, axis=0))
    np.testing.assert_allclose(band.std_real[:, 0], std, rtol=1e-4)


def test_a_row_of_one_dof_has_the_band_of_its_receptance(result) -> None:
    one = updyn.Recovery(["tip"], ["2:X"], sp.csr_array([[1.0]]), "m")
    band = updyn.predict_recovered(result, LINES, one, ["1:X"], level=0.9)
    same = updyn.predict(result, LINES, ["2:X"], ["1:X"], level=0.9)
    for name in ("lower", "upper", "std_real", "std_imag"):
        np.testing.assert_allclose(getattr(band, name), getattr(same, name), rtol=1e-9)


def test_signs_of_dofs_and_unused_columns_do_not_matter(result) -> None:
    turned = updyn.Recovery(["upper"], ["9:X", "2:X", "1:-X"], [[0.0, 1.0, 1.0]], "m")
    band = updyn.predict_recovered(result, LINES, turned, ["1:X"])
    same = updyn.predict_recovered(result, LINES, STRETCH, ["1:X"])
    np.testing.assert_allclose(band.upper[:, 0], same.upper[:, 0], rtol=1e-9)


def test_an_undetermined_combination_opens_only_what_it_changes() -> None:
    """Two springs in a row: their sum is known, the point between them is anywhere."""
    ask = updyn.Recovery(["end", "between"], ["2:X", "1:X"], [[1.0, 0.0], [0.0, 1.0]])
    band = updyn.predict_recovered(in_series(), LINES, ask, ["2:X"])
    assert np.isfinite(band.upper[:, 0]).all()
    assert np.isinf(band.upper[:, 1]).all()


@pytest.mark.usefixtures("no_causes")
def test_a_band_covers_an_error_of_the_model() -> None:
    """The stretch of a spring between two masses without a sensor, of a chain that lacks a spring."""
    model, clean, unknowns = ungrounded_chain()
    stretch = updyn.Recovery(["stretch"], ["4:X", "5:X"], [[-1.0, 1.0]])
    H = clean.select(responses=["4:X", "5:X"]).values
    truth, shares = H[:, 1] - H[:, 0], []
    for seed in range(6):
        frf = noisy(clean, seed, 0.01).select(responses=["1:X", "2:X", "3:X", "6:X"])
        result = updyn.update(model, frf, unknowns, noise={"relative": 0.01}, starts=0)
        band = updyn.predict_recovered(result, clean.freq, stretch, ["6:X"])
        size = np.abs(truth)[:, None]
        shares.append(np.mean((band.lower <= size) & (size <= band.upper)))
    assert np.mean(shares) > 0.85


def test_modal_values_give_the_matrix_back(result) -> None:
    """All modes of a model span its displacements; half of them leave out the rest."""
    model = result.model
    modes = updyn.modes(model, 2)
    shapes = 3.0 * modes.shapes.real
    scaled = updyn.ModeSet(modes.frequency, shapes, modes.dofs)
    stretch = shapes[1:2] - shapes[:1]
    found = updyn.Recovery.from_modes(["upper"], stretch, scaled, model, "m")
    np.testing.assert_allclose(found.matrix, [[-1.0, 1.0]], atol=1e-9)
    first = updyn.Recovery.from_modes(["upper"], stretch[:, :1], scaled.select([0]), model, "m")
    np.testing.assert_allclose(first.matrix @ shapes[:, :1], stretch[:, :1], rtol=1e-9)
    assert abs((first.matrix @ shapes[:, 1:])[0, 0]) < 1e-9 * abs(stretch[0, 1])


def test_what_does_not_fit_is_refused(result) -> None:
    with pytest.raises(OptionError, match=r"expected \(1, 2\), a row for each name"):
        updyn.Recovery(["a"], ["1:X", "2:X"], [[1.0]])
    with pytest.raises(OptionError, match="'a' occurs twice"):
        updyn.Recovery(["a", "a"], ["1:X"], [[1.0], [2.0]])
    with pytest.raises(OptionError, match="finite"):
        updyn.Recovery(["a"], ["1:X"], [[np.nan]])
    zero = updyn.Recovery(["a"], ["1:X"], [[0.0]])
    with pytest.raises(OptionError, match="the matrix is zero"):
        updyn.predict_recovered(result, LINES, zero, ["1:X"])
    with pytest.raises(OptionError, match=r"expected updyn.Recovery"):
        updyn.predict_recovered(result, LINES, [[1.0]], ["1:X"])
    lost = updyn.Recovery(["a"], ["7:X"], [[1.0]])
    with pytest.raises(DofError, match="7:X"):
        updyn.predict_recovered(result, LINES, lost, ["1:X"])
    modes = updyn.modes(result.model, 2)
    with pytest.raises(OptionError, match="a column for each mode"):
        updyn.Recovery.from_modes(["a"], [[1.0]], modes, result.model)
    twice = updyn.ModeSet([1.0, 2.0], np.ones((2, 2)), ["1:X", "2:X"])
    with pytest.raises(OptionError, match="dependent"):
        updyn.Recovery.from_modes(["a"], [[1.0, 1.0]], twice, result.model)
    turning = updyn.ModeSet([1.0], [[1.0], [1.0j]], ["1:X", "2:X"])
    with pytest.raises(OptionError, match="real shapes"):
        updyn.Recovery.from_modes(["a"], [[1.0]], turning, result.model)
