"""FRFs from the poles of modes, the mode indicator function, and modes of the same shape."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import updyn
from updyn.correlation import frac
from updyn.errors import DataError
from updyn.modal import cmif, synthesise
from updyn.modal.alike import find_alike_pairs
from updyn.modal.synthesis import band_of_modes, line_weights

MASS, STIFFNESS = np.diag([1.0, 2.0, 1.5]), 1e4 * np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 2]])
ETA = 0.01
LABELS = ["1:X", "2:X", "3:X"]


def solved(freq: np.ndarray, quantity: str = "accelerance", decay: float = 0.0) -> updyn.FRF:
    """FRFs of three masses by inversion of the dynamic stiffness, line by line."""
    s = 2j * np.pi * freq + decay
    power = {"receptance": 0, "mobility": 1, "accelerance": 2}[quantity]
    Z = STIFFNESS * (1 + 1j * ETA) + s[:, None, None] ** 2 * MASS
    H = np.linalg.solve(Z, np.broadcast_to(np.eye(3), Z.shape)) * s[:, None, None] ** power
    return updyn.FRF(freq, H[:, :, :2], LABELS, LABELS[:2], quantity, decay=decay)


def exact() -> updyn.ModeSet:
    values, shapes = np.linalg.eigh(STIFFNESS / np.sqrt(np.outer(np.diag(MASS), np.diag(MASS))))
    f = np.sqrt(values) / (2 * np.pi)
    return updyn.ModeSet(f, shapes / np.sqrt(np.diag(MASS))[:, None], LABELS, [ETA] * 3)


@pytest.mark.parametrize("quantity", ["receptance", "mobility", "accelerance"])
@pytest.mark.parametrize("decay", [0.0, 1.5])
def test_exact_poles_give_the_exact_frfs(quantity: str, decay: float) -> None:
    measured = solved(np.linspace(0.5, 40.0, 200), quantity, decay)
    found = synthesise(exact(), measured)
    assert found.quantity == quantity
    assert found.values == pytest.approx(measured.values, rel=1e-6)


def test_a_line_at_0_hz_stays() -> None:
    measured = solved(np.linspace(0.0, 40.0, 200), "receptance")
    found = synthesise(exact(), measured)
    assert found.values[1:] == pytest.approx(measured.values[1:], rel=1e-6)
    assert np.isfinite(found.values[0]).all()


def test_residual_terms_stand_for_modes_outside_the_band() -> None:
    """Of the second mode only: the lowest and the highest one are below and above the lines."""
    f = exact().frequency
    measured = solved(np.linspace(f[1] - 1.5, f[1] + 1.5, 300), "receptance")
    found = synthesise(exact().select([1]), measured)
    assert frac(measured.values, found.values).min() > 0.999
    share = np.abs(found.values / measured.values - 1.0)
    assert np.median(share) < 0.02


def test_a_mode_that_is_missing_shows() -> None:
    measured = solved(np.linspace(1.0, 40.0, 400))
    found = synthesise(exact().select([0, 2]), measured)
    assert frac(measured.values, found.values).min() < 0.5


def test_too_few_lines_and_unknown_damping_are_refused() -> None:
    five = solved(np.linspace(5.0, 30.0, 5))
    with pytest.raises(DataError, match="5 lines for 3 modes and two residual terms"):
        synthesise(exact(), five)
    modes = dataclasses.replace(exact(), loss_factor=[0.01, np.nan, 0.01])
    with pytest.raises(DataError, match=r"loss factor of the mode at 19\.\d+ Hz is unknown"):
        synthesise(modes, solved(np.linspace(5.0, 30.0, 50)))


def test_weights_level_the_band_and_do_not_depend_on_units() -> None:
    freq = np.linspace(1.0, 100.0, 600)
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((600, 8, 1, 2)) @ (1, 1j)
    slope = 10.0 ** (freq / 25.0)  # 80 dB over the band
    frf = updyn.FRF(
        freq, noise * slope[:, None, None], [f"{k}:X" for k in range(8)], ["9:X"], "mobility"
    )
    weighted = np.abs(frf.values[20:-20, :, 0]).mean(axis=1) * line_weights(frf)[20:-20]
    assert weighted.max() / weighted.min() < 4.0
    loud = dataclasses.replace(frf, values=frf.values * np.geomspace(1, 1e6, 8)[:, None])
    assert line_weights(loud) == pytest.approx(line_weights(frf))
    freq = np.linspace(0.0, 100.0, 600)
    assert line_weights(dataclasses.replace(frf, freq=freq))[0] == 0.0


def test_the_band_of_modes_ends_where_a_resonance_has_fallen_to_a_tenth() -> None:
    f, eta = 50.0, 0.02
    freq = np.linspace(40.0, 60.0, 20_001)
    size = np.abs(1.0 / (f**2 * (1 + 1j * eta) - freq**2))
    frf = updyn.FRF(freq, size[:, None, None], ["1:X"], ["1:X"], "receptance")
    inside = band_of_modes(updyn.ModeSet([f], [[1.0]], ["1:X"], [eta]), frf)
    assert size[inside][[0, -1]] / size.max() == pytest.approx([0.1, 0.1], rel=0.1)


def test_the_indicator_is_the_root_of_the_eigenvalues_of_the_normal_matrix() -> None:
    measured = solved(np.linspace(0.0, 40.0, 60), "receptance")
    found = cmif(measured)
    assert found.freq == pytest.approx(measured.freq[1:])
    H = measured.values[1:] * -((2 * np.pi * found.freq) ** 2)[:, None, None]
    eigenvalues = np.linalg.eigvalsh(H.conj().swapaxes(1, 2) @ H)[:, ::-1]
    assert found.values**2 == pytest.approx(eigenvalues, rel=1e-6)
    assert found.unit == "(m/s²)/N"


def test_the_indicator_does_not_depend_on_the_unit_of_rotations() -> None:
    measured = dataclasses.replace(
        solved(np.linspace(1.0, 40.0, 60)), responses=["1:X", "2:X", "2:RZ"]
    )
    other = dataclasses.replace(measured, values=measured.values * np.array([1, 1, 1e3])[:, None])
    assert cmif(other).values == pytest.approx(cmif(measured).values)
    assert cmif(other).unit == "(m/s²)/N"
    rotations = measured.select(responses=["2:RZ"])
    assert cmif(rotations).unit == "(rad/s²)/N"
    assert cmif(rotations).values[:, 0] == pytest.approx(
        np.linalg.norm(rotations.values[:, 0], axis=1)
    )


@pytest.mark.parametrize(("angle", "apart", "listed"), [
    (18.0, 0.019, [True]),  # MAC = cos(angle)^2 = 0.905
    (18.0, 0.021, [False]),  # farther apart than the sum of both bandwidths of 1 %
    (19.0, 0.001, []),  # MAC 0.894
])  # fmt: skip
def test_modes_of_one_shape_are_listed(angle: float, apart: float, listed: list[bool]) -> None:
    turn = np.radians([0.0, angle, 90.0])
    shapes = np.array([np.cos(turn), np.sin(turn)])
    modes = updyn.ModeSet(
        [100.0, 100.0 * (1 + apart), 300.0], shapes, ["1:X", "2:X"], [0.01, 0.01, 0.01]
    )
    pairs = find_alike_pairs(modes)
    assert [pair.overlap for pair in pairs] == listed
    for pair in pairs:
        assert (pair.first, pair.second) == pytest.approx((100.0, 100.0 * (1 + apart)))
        assert pair.mac == pytest.approx(np.cos(np.radians(angle)) ** 2)
