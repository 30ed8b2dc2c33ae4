"""Modes whose stiffness depends on the level: a leaning peak is one mode, of its small motion."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import updyn
from updyn.cli.describe import describe_modes
from updyn.modal.backbone import _LeaningWindow, motion
from updyn.modal.level import describe_leaning
from updyn.modal.vector_fitting import RationalBasis
from updyn.report.identified import render

FREQ = np.linspace(20.0, 40.0, 400)
LOSS = 0.02
SHAPE = np.array([1.0, 0.8, -0.6, 0.3, -0.9, 0.5])


def linear_motion(natural: float) -> np.ndarray:
    """X = (omega_r^2 (1 + i eta) - omega^2) / (omega_r^2 eta)."""
    return (natural**2 * (1 + 1j * LOSS) - FREQ**2) / (natural**2 * LOSS)


def accelerance(
    natural: float, shift: float, law: int = 2, shape: np.ndarray = SHAPE
) -> np.ndarray:
    """Accelerances of a mode whose squared frequency falls by shift * eta * |u|^law.

    The squared motion a solves a |X - shift a^(law / 2)|^2 = 1: here the real roots v of the
    polynomial in v = sqrt(a).
    """
    X = linear_motion(natural)
    v = np.empty(len(FREQ))
    for line, value in enumerate(X):
        powers = np.zeros(2 * law + 3)
        powers[2 * law + 2] += shift**2
        powers[law + 2] -= 2 * shift * value.real
        powers[2] += abs(value) ** 2
        powers[0] = -1.0
        roots = np.roots(powers[::-1])
        real = roots.real[(np.abs(roots.imag) < 1e-6 * np.abs(roots)) & (roots.real > 0)]
        v[line] = real.min()
    u = 1.0 / (X - shift * v**law)
    return (-(FREQ**2) / (natural**2 * LOSS) * u)[:, None] * shape


def measured(values: np.ndarray, seed: int = 0, noise: float = 0.005) -> updyn.FRF:
    """FRFs with proportional noise; values of shape (n_f, n_i) or (n_f, n_i, n_j)."""
    rng = np.random.default_rng(seed)
    values = values * (1 + noise * (rng.standard_normal((*values.shape, 2)) @ (1, 1j)))
    values = values.reshape(len(FREQ), len(SHAPE), -1)
    responses = [f"{k}:Z" for k in range(1, 7)]
    references = [f"{k}:Z" for k in range(11, 11 + values.shape[2])]
    return updyn.FRF(FREQ, values, responses, references, "accelerance")


@pytest.mark.parametrize("C", [0.0, -0.3, 0.3 - 0.8j, 1.4, -2.5, 0.5j])
def test_the_motion_is_the_smallest_root_of_its_cubic(C: complex) -> None:
    x = np.linspace(-30.0, 30.0, 601) + 0j
    a = motion(x, 1j, C, 1.0)
    X = x - 1j
    for k in range(len(x)):
        roots = np.roots([abs(C) ** 2, -2 * (X[k].conj() * C).real, abs(X[k]) ** 2, -1.0])
        real = roots.real[(np.abs(roots.imag) < 1e-7 * np.abs(roots)) & (roots.real > 0)]
        assert a[k] == pytest.approx(real.min(), rel=1e-6)


@pytest.mark.parametrize("mirrored", [False, True])
def test_slopes_are_those_of_finite_differences(mirrored: bool) -> None:
    x = np.linspace(0.8, 1.2, 50) * (1j if mirrored else 1.0 + 0j)
    pole, shift = (-0.01 + 1j, 0.003 - 0.008j) if mirrored else (1 + 0.02j, -0.01 + 0.002j)
    basis, none = RationalBasis(3, mirrored), np.zeros(0, dtype=complex)
    width, step = (0.01 if mirrored else 0.02), 1e-6

    def functions(pole: complex, shift: complex) -> np.ndarray:
        window = _LeaningWindow(basis, x, np.zeros((1, 50), complex), none, shift=shift)
        return window.fractions(np.array([pole]))

    slopes = _LeaningWindow(basis, x, np.zeros((1, 50), complex), none, shift=shift).slopes(pole)
    changes = [(1, 0), (1j, 0), (0, 1), (0, 1j)]
    for k, (by_pole, by_shift) in enumerate(changes):
        d = step * width
        upper = functions(pole + by_pole * d, shift + by_shift * d)
        lower = functions(pole - by_pole * d, shift - by_shift * d)
        for m in range(upper.shape[1]):
            expected = basis.parts((upper - lower)[:, [m]] / (2 * step))[:, 0]
            assert slopes[:, m, k] == pytest.approx(
                expected, rel=1e-5, abs=1e-5 * abs(expected).max()
            )


@pytest.mark.parametrize("damping", ["structural", "viscous"])
@pytest.mark.parametrize("shift", [-0.3, 0.1, 0.3, 1.0])
def test_a_leaning_peak_is_one_mode_of_small_motion(shift: float, damping: str) -> None:
    natural, lean = 30.0, -0.5 * shift * LOSS * 30.0
    found = updyn.identify_modes(measured(accelerance(natural, shift)), damping=damping)
    assert len(found) == 1
    assert found.frequency[0] == pytest.approx(
        natural, abs=0.05 * abs(lean) + 0.5 * LOSS**2 * natural
    )
    assert found.loss_factor[0] == pytest.approx(LOSS, rel=0.02)
    assert found.lean[0] == pytest.approx(lean, rel=0.05)
    assert 0.5 * abs(lean) < found.std_frequency[0] < 0.75 * abs(lean)
    scaled = found.real_shapes[:, 0] / np.linalg.norm(found.real_shapes[:, 0])
    assert abs(scaled @ SHAPE) == pytest.approx(np.linalg.norm(SHAPE), rel=1e-5)


@pytest.mark.parametrize("law", [1, 3])
@pytest.mark.parametrize("shift", [0.1, 0.3])
def test_the_deviation_covers_other_laws_of_the_shift(law: int, shift: float) -> None:
    """Friction at small slip shifts the frequency by |u|, a quintic spring by |u|^4."""
    found = updyn.identify_modes(measured(accelerance(30.0, shift, law)))
    assert len(found) == 1
    assert abs(found.frequency[0] - 30.0) < 1.96 * found.std_frequency[0]
    assert found.lean[0] < 0.0


def test_references_at_which_a_mode_moves_less_lean_less() -> None:
    """Forces of the same size: the shift is in proportion to the squared shape at the reference."""
    driven = np.array([1.0, 0.5])
    columns = [d * accelerance(30.0, 0.4 * d**2) for d in driven]
    found = updyn.identify_modes(measured(np.stack(columns, axis=2)))
    assert len(found) == 1
    assert found.frequency[0] == pytest.approx(30.0, abs=2e-3)
    assert found.lean[0] == pytest.approx(-0.5 * 0.4 * LOSS * 30.0, rel=0.05)


def test_leaning_neighbours_are_two_modes() -> None:
    other = np.array([0.4, -0.7, 0.9, 1.0, 0.2, -0.5])
    values = accelerance(28.0, 0.3) + accelerance(31.0, 0.2, shape=other)
    found = updyn.identify_modes(measured(values))
    assert found.frequency == pytest.approx([28.0, 31.0], abs=5e-3)
    assert found.lean == pytest.approx([-0.5 * 0.3 * 0.56, -0.5 * 0.2 * 0.62], rel=0.1)


def test_peaks_of_a_linear_structure_do_not_lean() -> None:
    other = np.array([0.4, -0.7, 0.9, 1.0, 0.2, -0.5])
    values = accelerance(29.0, 0.0) + accelerance(29.4, 0.0, shape=other)
    for seed in range(5):
        found = updyn.identify_modes(measured(values, seed))
        assert len(found) == 2
        assert np.isnan(found.lean).all()
    assert describe_leaning(found) == ""


def test_terminal_and_page_name_a_leaning_peak() -> None:
    frf = measured(accelerance(30.0, 0.3))
    found = updyn.identify_modes(frf)
    text = describe_leaning(found)
    assert text.startswith(
        f"The peak at {found.frequency[0]:.6g} Hz ({found.lean[0]:+.2g} Hz) leans"
    )
    assert "the stiffness depends on the level" in text
    assert text in describe_modes(found)
    assert text in render(found, frf)


def test_the_lean_stays_with_its_mode() -> None:
    modes = updyn.ModeSet([3.0, 1.0, 2.0], lean=[-0.3, np.nan, -0.2])
    assert modes.lean == pytest.approx([np.nan, -0.2, -0.3], nan_ok=True)
    assert modes.select(band=(1.5, 2.5)).lean == pytest.approx([-0.2])
    for same in (pickle.loads(pickle.dumps(modes)), copy.copy(modes), modes.renamed([])):  # noqa: S301
        assert same.lean == pytest.approx(modes.lean, nan_ok=True)
    assert describe_leaning(modes).startswith("The peaks at 2 Hz (-0.2 Hz), 3 Hz (-0.3 Hz) lean:")
