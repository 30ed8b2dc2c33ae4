"""Derivatives of modes against closed forms and central differences, of small, free, mixed and large models."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import scipy.sparse as sp

import updyn
from updyn.dynamics.affine import AffineSystem
from updyn.elements.beam import Segment, beam
from updyn.errors import SolverError
from updyn.modal.sensitivity import RealModes, differentiate_modes, separate_repeated_modes
from updyn.modal.sensitivity import differentiate_mode as slopes_of_one
from updyn.modal.settings import MODE_DERIVATIVE
from updyn.model import Model
from updyn.sensitivity import Unknowns
from updyn.updating.problem.parameters import ParameterSet


def springs(n: int, m: float = 2.0, k: float = 5e3) -> Model:
    """Equal masses on equal springs, held at one end; each spring and each mass a group."""
    groups = {}
    for i in range(n):
        K, M = np.zeros((n, n)), np.zeros((n, n))
        K[i, i], M[i, i] = k, m
        if i:
            K[i - 1, i - 1], K[i, i - 1], K[i - 1, i] = k, -k, -k
        groups[f"spring {i + 1}"] = updyn.Group(K)
        groups[f"mass {i + 1}"] = updyn.Group(mass=M)
    return updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])


def differentiate_mode(
    modes: RealModes,
    which: int,
    system: AffineSystem,
    unknowns: Unknowns,
    values: np.ndarray,
    rows: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of one mode by Nelson's method, equal to those of the sum over all modes."""
    about = (system, unknowns, values, rows)
    along = np.cos(np.arange(system.n))[:, None]
    value, shape = slopes_of_one(modes, which, *about, along)
    assert (modes.whole is not None) == (system.n <= MODE_DERIVATIVE.most_decomposed_dofs)
    by_value, by_shape = differentiate_modes(modes, np.array([which]), *about, along)
    level = np.abs(shape).max() + np.abs(modes.shapes[rows, which]).max()
    assert by_value[0] == pytest.approx(value, rel=1e-8, abs=1e-9 * modes.value[which])
    assert by_shape[0] == pytest.approx(shape, rel=1e-6, abs=1e-7 * level)
    return value, shape[:, :-1]


class Moved:
    """Modes of a model at values of its unknowns."""

    def __init__(self, model: Model, parameters: ParameterSet, n: int) -> None:
        self.system = AffineSystem.compile(model)
        self.unknowns = Unknowns.find(self.system, parameters)
        self.n = n

    def at(self, values: np.ndarray) -> RealModes:
        return RealModes.lowest(self.system, self.unknowns.state(self.system, values), self.n, 0.0)


def compare(
    model: Model, parameters: ParameterSet, values: np.ndarray, n: int, rel: float = 1e-6
) -> None:
    """Every eigenvalue and shape, by every unknown, against central differences."""
    moved = Moved(model, parameters, n)
    modes, rows = moved.at(values), np.arange(moved.system.n)
    for which in range(n):
        value, shape = differentiate_mode(modes, which, moved.system, moved.unknowns, values, rows)
        for j in range(len(values)):
            step = np.zeros(len(values))
            step[j] = 1e-4 * values[j]
            # Five points: the error of a step h is of the order of h^4.
            points = [moved.at(values + s * step) for s in (-2, -1, 1, 2)]
            weights = np.array([1.0, -8.0, 8.0, -1.0]) / (12.0 * step[j])
            by_value = sum(w * p.value[which] for w, p in zip(weights, points, strict=True))
            own = modes.shapes[:, which]
            turned = [
                p.shapes[:, which] * np.sign(own @ modes.M @ p.shapes[:, which]) for p in points
            ]
            by_shape = sum(w * t for w, t in zip(weights, turned, strict=True))
            assert value[j] == pytest.approx(by_value, rel=rel, abs=rel * modes.value[which])
            assert shape[j] == pytest.approx(by_shape, rel=rel, abs=10 * rel * np.abs(own).max())


def test_modes_of_a_chain_are_those_of_the_closed_form() -> None:
    """omega_r = 2 sqrt(k / m) sin((2 r - 1) pi / (2 (2 n + 1))), a chain held at one end."""
    n, m, k = 7, 2.0, 5e3
    modes = RealModes.lowest(
        AffineSystem.compile(springs(n)), AffineSystem.compile(springs(n)).start, n, 0.0
    )
    r = np.arange(1, n + 1)
    assert modes.value == pytest.approx(
        4.0 * k / m * np.sin((2 * r - 1) * np.pi / (2 * (2 * n + 1))) ** 2, rel=1e-12
    )
    assert modes.complete
    assert modes.rigid.shape[1] == 0


def test_all_stiffness_raises_an_eigenvalue_by_its_own_share() -> None:
    """One factor on all K: the eigenvalue grows by that share, no shape changes. On all M: it falls."""
    model = springs(5)
    for quantity, share, shrink in (("stiffness", 1.0, 0.0), ("mass", -1.0, -0.5)):
        of = [
            f"{'spring' if quantity == 'stiffness' else 'mass'} {i + 1}.{quantity}"
            for i in range(5)
        ]
        moved = Moved(model, ParameterSet((updyn.link(model, "all.it", of)[0],)), 5)
        modes = moved.at(np.ones(1))
        for which in range(5):
            value, shape = differentiate_mode(
                modes, which, moved.system, moved.unknowns, np.ones(1), np.arange(5)
            )
            assert value == pytest.approx([share * modes.value[which]], rel=1e-12)
            expected = shrink * modes.shapes[:, which]
            assert shape[0] == pytest.approx(
                expected, abs=1e-11 * np.abs(modes.shapes[:, which]).max()
            )


def test_chain(chain12: Model) -> None:
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all")
    compare(chain12, unknowns, np.linspace(0.8, 1.2, len(unknowns)), 5)


def test_translations_beside_rotations(mixed_model: Callable[[float], Model]) -> None:
    for length in (1.0, 1e-3):
        model = mixed_model(length)
        compare(
            model,
            updyn.parameters(model, stiffness="all", mass="all"),
            np.array([0.9, 1.1, 1.0, 0.8]),
            4,
        )


def test_powers_of_linked_unknowns(chain12: Model) -> None:
    first = updyn.link(
        chain12,
        "wall.thickness",
        {"part1.stiffness": 3.0, "part1.mass": 1.0, "part2.stiffness": 1.0},
    )
    unknowns = ParameterSet((*first, *updyn.parameters(chain12, stiffness=["part2"])))
    compare(chain12, unknowns, np.array([1.1, 0.9]), 3)


def test_free_free_beam() -> None:
    """Rigid-body motions, of which K is singular, are left out and do not disturb the others."""
    halves = [Segment("left", 0.0, 0.2), Segment("right", 0.2, 0.5)]
    model = beam(
        length=0.5, E=2e11, rho=7850.0, width=0.03, height=0.01, n_elements=10, segments=halves
    )
    unknowns = updyn.parameters(model, stiffness="all", mass="all")
    moved = Moved(model, unknowns, 4)
    assert moved.at(np.ones(4)).rigid.shape[1] == 2
    assert moved.at(np.ones(4)).frequency[0] > 100.0
    compare(model, unknowns, np.array([0.9, 1.1, 1.0, 0.95]), 3, rel=3e-6)


def test_large_sparse_model() -> None:
    """1200 DOFs, of which every seventh has no mass; the shape is wanted at three of them."""
    n = 1200

    def chain(first: int, last: int) -> sp.csr_array:
        """Springs from DOF i - 1, or the ground, to i."""
        B = sp.diags_array([np.ones(n), -np.ones(n - 1)], offsets=[0, -1]).tocsr()[first:last]
        return sp.csr_array(1e6 * B.T @ B)

    mass = sp.diags_array(np.where(np.arange(n) % 7, 0.01, 0.0)).tocsr()
    groups = {"a": updyn.Group(chain(0, n // 3)), "b": updyn.Group(chain(n // 3, n), mass)}
    model = updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])
    unknowns = updyn.parameters(model, stiffness="all")
    moved, rows, values = (
        Moved(model, unknowns, 3),
        np.array([100, 500, 1100]),
        np.array([1.1, 0.9]),
    )
    modes = moved.at(values)
    for which in range(3):
        value, shape = differentiate_mode(modes, which, moved.system, moved.unknowns, values, rows)
        for j in range(2):
            step = np.zeros(2)
            step[j] = 1e-4
            low, high = moved.at(values - step), moved.at(values + step)
            assert value[j] == pytest.approx(
                (high.value[which] - low.value[which]) / 2e-4, rel=1e-5
            )
            own = modes.shapes[:, which]
            a, b = (
                p.shapes[rows, which] * np.sign(own @ modes.M @ p.shapes[:, which])
                for p in (low, high)
            )
            assert shape[j] == pytest.approx((b - a) / 2e-4, abs=1e-5 * np.abs(own).max())


def test_compiled_model_is_not_touched(chain12: Model) -> None:
    system = AffineSystem.compile(chain12)
    before = system.indices.copy(), system.indptr.copy()
    RealModes.lowest(system, system.start, 4, 1e9)
    assert (system.indices == before[0]).all()
    assert (system.indptr == before[1]).all()


# -- modes of one eigenvalue -----------------------------------------------------------------------------------------
CHAIN = np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
FIRST = np.diag([1.0, 0.0, 0.0])


def two_planes(turn: float = 0.0, **more: np.ndarray) -> Model:
    """A chain in X and the same in Y, the spring at its foot a group of its own in each; turned by an angle."""
    c, s = np.cos(turn), np.sin(turn)
    R = np.kron(np.array([[c, -s], [s, c]]), np.eye(3))
    none = np.zeros((3, 3))
    parts = {
        "foot x": np.block([[FIRST, none], [none, none]]),
        "foot y": np.block([[none, none], [none, FIRST]]),
        "rest": np.kron(np.eye(2), CHAIN - FIRST),
        **more,
    }
    groups = {name: updyn.Group(1e4 * R @ K @ R.T) for name, K in parts.items()}
    groups["masses"] = updyn.Group(mass=np.eye(6))
    return updyn.Model.from_groups(groups, [f"{i}:{d}" for d in "XY" for i in (1, 2, 3)])


def turned(
    model: Model, parameters: ParameterSet, measured: np.ndarray
) -> tuple[Moved, RealModes, np.ndarray]:
    moved, values = Moved(model, parameters, 6), np.ones(len(parameters))
    modes = separate_repeated_modes(
        moved.at(values), moved.system, moved.unknowns, values, lambda shapes: shapes, measured
    )
    return moved, modes, values


def test_modes_that_no_unknown_couples_have_their_own_derivatives() -> None:
    """Those of the chain in one plane by itself, whatever basis the solver gives; by central differences there."""
    for turn in (0.0, 0.5):
        model = two_planes(turn)
        unknowns = updyn.parameters(model, stiffness=["foot x", "foot y"])
        moved, modes, values = turned(model, unknowns, np.eye(6))
        alone = {
            "foot": updyn.Group(1e4 * FIRST),
            "rest": updyn.Group(1e4 * (CHAIN - FIRST), np.eye(3)),
        }
        plane = updyn.Model.from_groups(alone, ["1:X", "2:X", "3:X"])
        single = Moved(plane, updyn.parameters(plane, stiffness=["foot"]), 3)
        along = (
            np.kron(np.array([np.cos(turn), np.sin(turn)]), np.eye(3)),
            np.kron([-np.sin(turn), np.cos(turn)], np.eye(3)),
        )
        for which in range(6):
            assert len(modes.find_repeated(which)) == 2
            value, shape = differentiate_mode(
                modes, which, moved.system, moved.unknowns, values, np.arange(6)
            )
            in_plane = [np.linalg.norm(a @ modes.shapes[:, which]) for a in along]
            own = int(np.argmax(in_plane))
            assert min(in_plane) < 1e-9
            expected_value, expected_shape = differentiate_mode(
                single.at(np.ones(1)),
                which // 2,
                single.system,
                single.unknowns,
                np.ones(1),
                np.arange(3),
            )
            sign = np.sign(
                (along[own] @ modes.shapes[:, which]) @ single.at(np.ones(1)).shapes[:, which // 2]
            )
            assert value[own] == pytest.approx(expected_value[0], rel=1e-9)
            assert value[1 - own] == pytest.approx(0.0, abs=1e-9 * modes.value[which])
            assert along[own] @ shape[own] == pytest.approx(sign * expected_shape[0], abs=1e-9)
            assert along[1 - own] @ shape[own] == pytest.approx(np.zeros(3), abs=1e-9)
            assert shape[1 - own] == pytest.approx(np.zeros(6), abs=1e-9)


def test_what_the_unknowns_leave_undecided_follows_the_measured_shapes() -> None:
    """One unknown for both planes: every basis will do, and that of the test is taken."""
    model = two_planes()
    (both,) = updyn.link(model, "foot.both", {"foot x.stiffness": 1.0, "foot y.stiffness": 1.0})
    angle, first = 0.3, Moved(two_planes(), ParameterSet((both,)), 6).at(np.ones(1)).shapes[:3]
    chain = first[:, [int(np.argmax(np.linalg.norm(first, axis=0)))]]
    measured = np.vstack([np.cos(angle) * chain, np.sin(angle) * chain])
    moved, modes, values = turned(model, ParameterSet((both,)), measured / np.linalg.norm(measured))
    alike = np.abs(measured.T @ modes.shapes)[0] / np.linalg.norm(measured)
    assert alike.max() == pytest.approx(1.0, abs=1e-9)
    best = int(np.argmax(alike))
    value, shape = differentiate_mode(
        modes, best, moved.system, moved.unknowns, values, np.arange(6)
    )
    assert value[0] > 0
    # The shape changes within its own plane.
    across = np.array([-np.sin(angle), np.cos(angle)])
    assert np.kron(across, np.eye(3)) @ shape[0] == pytest.approx(np.zeros(3), abs=1e-9)


def test_modes_that_unknowns_couple_have_no_derivatives() -> None:
    """A spring in X, and one at 45 degrees: no basis suits both."""
    slant = np.kron(0.5 * np.ones((2, 2)), FIRST)
    other = np.kron(0.5 * np.array([[1.0, -1.0], [-1.0, 1.0]]), FIRST)
    model = two_planes(0.0, slant=slant, other=other)
    unknowns = updyn.parameters(model, stiffness=["foot x", "slant"])
    moved, modes, values = turned(model, unknowns, np.eye(6))
    with pytest.raises(
        SolverError, match=r"2 modes of the model coincide at .* Hz, and the unknowns couple them"
    ):
        slopes_of_one(modes, 0, moved.system, moved.unknowns, values, np.arange(6))
    with pytest.raises(SolverError, match="2 modes of the model coincide"):
        differentiate_modes(modes, np.arange(1), moved.system, moved.unknowns, values, np.arange(6))
    either = updyn.parameters(model, stiffness=["slant"])
    moved, modes, values = turned(model, either, np.eye(6))
    value, _ = differentiate_mode(modes, 0, moved.system, moved.unknowns, values, np.arange(6))
    assert np.isfinite(value).all()
