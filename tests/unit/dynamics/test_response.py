"""Receptances of the gear train against 60 digits, of one mass against its formula; quantities, signs, refusals."""

import numpy as np
import pytest

import updyn
from updyn.demos import chain
from updyn.errors import DataError, DofError

ALL = [f"{i}:RZ" for i in range(1, 8)]


@pytest.mark.parametrize("tier", ["dense", "sparse"])
def test_gear_train_against_sixty_digits(gear_train, gear_train_reference, tier):
    """Column of DOF 2, to 1e-12 of its largest entry."""
    for omega, column in gear_train_reference["receptance"].items():
        exact = np.array([complex(*c) for c in column])
        H = updyn.response(
            gear_train, [float(omega) / (2 * np.pi)], ALL, ["2:RZ"], tier=tier
        ).values[0, :, 0]
        assert np.abs(H - exact).max() < 1e-12 * np.abs(exact).max()
        # Entry by entry, too; 1e-11, as the model's 1e9 of stiffness to inertia costs digits of the
        # smallest.
        assert pytest.approx(exact, rel=1e-11) == H


@pytest.fixture(scope="module")
def oscillator():
    """m = 2 kg, k = 800 N/m, loss factor 0.05, c = 3 N s/m."""
    group = updyn.Group([[800.0]], [[2.0]], loss_factor=0.05, viscous=[[3.0]])
    return updyn.Model.from_groups({"it": group}, ["1:Z"])


def test_single_oscillator_in_all_quantities(oscillator):
    """H = 1 / (k (1 + i gamma) - omega^2 m + i omega c) (Ewins, Modal Testing, 2nd ed. 2000, section 2.4)."""
    freq = np.array([0.0, 1.0, np.sqrt(400.0) / (2 * np.pi), 30.0])
    w = 2 * np.pi * freq
    H = 1.0 / (800.0 * (1 + 0.05j) - 2.0 * w**2 + 3.0j * w)
    for quantity, factor in (("receptance", 1.0), ("mobility", 1j * w), ("accelerance", -(w**2))):
        frf = updyn.response(oscillator, freq, ["1:Z"], ["1:Z"], quantity)
        assert frf.quantity == quantity
        assert frf.values[:, 0, 0] == pytest.approx(factor * H, rel=1e-13)


def test_signs_of_sensor_and_hammer(oscillator):
    def value(response, reference):
        return updyn.response(oscillator, [3.0], [response], [reference]).values[0, 0, 0]

    plus = value("1:Z", "1:Z")
    assert value("1:-Z", "1:Z") == value("1:Z", "1:-Z") == -plus
    assert value("1:-Z", "1:-Z") == plus


def test_sides_keep_their_order_whichever_is_loaded(gear_train):
    """Forces are put on the side with fewer DOFs; the answer must not show it."""
    rows, columns, freq = ["3:RZ", "1:RZ"], ["7:RZ", "2:-RZ", "4:RZ"], [1.0, 2.5]
    wide = updyn.response(gear_train, freq, rows, columns).values
    tall = updyn.response(gear_train, freq, columns, rows).values
    one = [
        [updyn.response(gear_train, freq, [r], [c]).values[:, 0, 0] for c in columns] for r in rows
    ]
    assert wide == pytest.approx(np.moveaxis(np.array(one), 2, 0), rel=1e-12)
    assert tall == pytest.approx(wide.transpose(0, 2, 1), rel=1e-12)


def test_refusals(oscillator):
    with pytest.raises(DofError, match="response 2:Z is not among"):
        updyn.response(oscillator, [1.0], ["2:Z"], ["1:Z"])
    with pytest.raises(DofError, match="reference 1:X is not among"):
        updyn.response(oscillator, [1.0], ["1:Z"], ["1:X"])
    with pytest.raises(DataError, match="line 2 is not finite"):
        updyn.response(oscillator, [1.0, np.nan], ["1:Z"], ["1:Z"])
    with pytest.raises(DataError, match="the first line is -1 Hz"):
        updyn.response(oscillator, [-1.0], ["1:Z"], ["1:Z"])
    with pytest.raises(DataError, match="lines must increase; line 2"):
        updyn.response(oscillator, [2.0, 1.0], ["1:Z"], ["1:Z"])
    with pytest.raises(DataError, match=r"quantity 'acelerance'.*accelerance"):
        updyn.response(oscillator, [1.0], ["1:Z"], ["1:Z"], "acelerance")


def test_one_line_may_be_a_number(oscillator):
    one, many = (updyn.response(oscillator, f, ["1:Z"], ["1:Z"]).values for f in (4.0, [4.0]))
    assert one == pytest.approx(many, rel=0)


def test_a_weak_channel_is_as_exact_as_a_strong_one():
    """Far above its resonances a chain passes on next to nothing: 1e-5 of the driven mass's motion."""
    model = chain.build()
    freq = np.linspace(1.0, 40.0, 80)
    found = updyn.response(model, freq, ["1:X", "12:X"], ["1:X"])
    Z, M = (model.stiffness + 1j * model.structural).toarray(), model.mass.toarray()
    force = np.eye(12)[:, 0]
    expected = [np.linalg.solve(Z - (2 * np.pi * f) ** 2 * M, force)[[0, 11]] for f in freq]
    assert abs(expected[-1][1] / expected[-1][0]) < 1e-5
    np.testing.assert_allclose(found.values[:, :, 0], expected, rtol=1e-11)
