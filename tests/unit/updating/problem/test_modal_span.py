"""Close measured modes are compared by the span of their shapes, whose basis is arbitrary."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

import updyn
from updyn.modal import ModeSet
from updyn.model import Group, Model
from updyn.updating.problem.modal import ModalPart
from updyn.updating.problem.modal_rows import KINDS
from updyn.updating.problem.modal_span import SpanProjection
from updyn.updating.problem.noise.modes import ModalNoise

N = 3
LABELS = [f"{i + 1}:{axis}" for axis in "XY" for i in range(N)]


def storeys(factors: np.ndarray) -> np.ndarray:
    """Stiffness of a mast of unit masses in one plane."""
    K = np.zeros((N, N))
    for i, k in enumerate(2e4 * factors):
        K[i, i] += k
        if i:
            K[i - 1 : i + 1, i - 1 : i + 1] += k * np.array([[1, -1], [-1, 0]])
    return K


def mast(x: np.ndarray, y: np.ndarray) -> Model:
    """A mast whose storeys have a stiffness in X and one in Y, each a group."""
    groups = {"mass": Group(mass=np.eye(2 * N))}
    for i in range(N):
        alone = np.eye(N)[i]
        groups[f"X {i + 1}"] = Group(scipy.linalg.block_diag(storeys(alone * x), np.zeros((N, N))))
        groups[f"Y {i + 1}"] = Group(scipy.linalg.block_diag(np.zeros((N, N)), storeys(alone * y)))
    return Model.from_groups(groups, LABELS)


def measured(factors: np.ndarray, turn: float, gap: float = 1e-5, **known: object) -> ModeSet:
    """The modes of a symmetric mast, each twice; the shapes of a pair are turned in their plane."""
    value, phi = np.linalg.eigh(storeys(factors))
    c, s = np.cos(np.deg2rad(turn)), np.sin(np.deg2rad(turn))
    pairs = [np.array([[c * p, s * p], [-s * p, c * p]]).reshape(2, -1).T for p in phi.T]
    f = np.repeat(np.sqrt(value) / (2.0 * np.pi), 2) * np.tile([1.0, 1.0 + gap], N)
    return ModeSet(f, np.hstack(pairs), LABELS, **known)


def part_of(model: Model, modes: ModeSet) -> ModalPart:
    return ModalPart.build(model, modes, updyn.parameters(model, stiffness="?*"), ModalNoise())


TRUE = np.array([1.3, 1.0, 0.8])


@pytest.mark.parametrize("split", [1e-5, 0.05])
def test_the_basis_of_a_repeated_pair_does_not_change_the_update(split: float) -> None:
    """The model is stiffer in Y, so that its own modes lie in X and in Y."""
    start = mast(np.ones(N), np.full(N, 1.0 + split))
    found = []
    for turn in (0.0, 30.0, 45.0):
        unknowns = updyn.parameters(start, stiffness=["X *", "Y *"])
        result = updyn.update(start, measured(TRUE, turn), unknowns, starts=0)
        assert result.status == "converged"
        found.append([result.values[f"{axis} {i}.stiffness"] for axis in "XY" for i in (1, 2, 3)])
    expected = [*TRUE, *(TRUE / (1.0 + split))]
    for values in found:
        assert values == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("turn", [0.0, 20.0, 45.0])
def test_residuals_of_a_pair_do_not_depend_on_its_basis(turn: float) -> None:
    modes = measured(TRUE, turn, scaled=True)
    part = part_of(mast(np.ones(N), np.full(N, 1.02)), modes)
    rows = part.rows(part.coordinates.start)
    aligned = part_of(mast(np.ones(N), np.full(N, 1.02)), measured(TRUE, 0.0, scaled=True))
    expected = aligned.rows(aligned.coordinates.start)
    assert not len(rows.unpaired_modes(part.least_mac))
    for kind in ("frequency", "mac", "scale"):
        assert rows.r[rows.of(kind)] == pytest.approx(expected.r[expected.of(kind)], abs=1e-9)
    size = [float(np.sum(one.r[one.of("shape")] ** 2)) for one in (rows, expected)]
    assert size[0] == pytest.approx(size[1], rel=1e-9)


@pytest.mark.parametrize("split", [1e-4, 0.03])
def test_derivatives_are_those_of_central_differences(split: float) -> None:
    """Also where the modes of the model are close, whose own shapes turn fast."""
    modes = measured(TRUE, 35.0, scaled=True)
    part = part_of(mast(np.ones(N), np.full(N, 1.0 + split)), modes)
    x = part.coordinates.start + 0.05 * np.tile(np.sin(np.arange(N)), 2)
    rows, step = part.rows(x), 1e-6
    assert set(rows.kind) == {KINDS.index(kind) for kind in ("frequency", "shape", "mac", "scale")}
    for i in range(part.n):
        moved = [part.rows(x + sign * step * np.eye(part.n)[i]).r for sign in (1.0, -1.0)]
        difference = (moved[0] - moved[1]) / (2.0 * step)
        np.testing.assert_allclose(rows.J[:, i], difference, rtol=1e-5, atol=1e-7)


def test_projection_is_that_of_least_squares() -> None:
    rng = np.random.default_rng(1)
    psi = rng.standard_normal(7)
    psi /= np.linalg.norm(psi)
    span, moved = rng.standard_normal((7, 2)), rng.standard_normal((2, 7, 3))
    found = SpanProjection.of(psi, span, moved)
    share = np.linalg.lstsq(span, psi, rcond=None)[0]
    assert found.within == pytest.approx(span @ share)
    nearest = span @ share / np.linalg.norm(share)
    assert found.size == pytest.approx(psi @ nearest)
    for i in range(3):
        ends = [SpanProjection.of(psi, span + t * moved[:, :, i].T, moved) for t in (1e-6, -1e-6)]
        by_x = (ends[0].within - ends[1].within) / 2e-6
        np.testing.assert_allclose(found.within_by_x[:, i], by_x, rtol=1e-6, atol=1e-8)
        assert found.size_by_x[i] == pytest.approx((ends[0].size - ends[1].size) / 2e-6, rel=1e-6)


def test_a_plane_of_which_the_model_has_one_direction_is_compared_one_by_one() -> None:
    """A model of bending in X finds the mode in X, and none in Y, of the same frequency."""
    both = measured(TRUE, 0.0)
    planar = Model.from_groups(
        {
            "X": Group(scipy.linalg.block_diag(storeys(TRUE), np.diag([1e9, 2e9, 4e9]))),
            "mass": Group(mass=np.eye(2 * N)),
        },
        LABELS,
    )
    modes = ModeSet(both.frequency[:4], both.shapes[:, :4], LABELS)
    part = ModalPart.build(planar, modes, updyn.parameters(planar, stiffness="X"), ModalNoise())
    rows = part.rows(part.coordinates.start)
    assert rows.unpaired_modes(part.least_mac).tolist() == [1, 3]
    np.testing.assert_allclose(rows.r, 0.0, atol=1e-9)


def test_one_mode_that_was_identified_twice_is_no_pair() -> None:
    """Its shapes differ by errors: they span one direction, not two."""
    modes = measured(TRUE, 0.0)
    twice = modes.shapes[:, [0, 0]] + 0.01 * np.random.default_rng(2).standard_normal((2 * N, 2))
    model = mast(np.ones(N), np.full(N, 1.5))
    part = part_of(model, ModeSet(modes.frequency[:2], twice, LABELS))
    assert part.target.clusters == []
    assert len(part_of(model, modes).target.clusters) == N
    apart = ModeSet(modes.frequency * np.tile([1.0, 1.007], N), modes.shapes, LABELS)
    assert part_of(model, apart).target.clusters == []  # by more than 0.6 %
