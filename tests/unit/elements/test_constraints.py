"""Constraints: against elimination by hand, rigid-body motion, and a pair of springs in line."""

import numpy as np
import pytest

import updyn
from updyn.dofs import DIRECTIONS
from updyn.elements.constraints import Equation, about_axis, along_axis, constrain, join, rigid_link
from updyn.errors import ModelError
from updyn.geometry import Geometry

RNG = np.random.default_rng(0)


def spring(k: float) -> np.ndarray:
    return k * np.array([[1.0, -1.0], [-1.0, 1.0]])


def full(n: int) -> np.ndarray:
    A = RNG.standard_normal((n, n))
    return A @ A.T + n * np.eye(n)


def model(n: int, labels: list[str], names: tuple[str, ...] = ("a", "b")) -> updyn.Model:
    return updyn.Model.from_groups(
        {x: updyn.Group(full(n), full(n), 0.1, full(n)) for x in names}, labels
    )


def test_grounding_leaves_out_rows_and_columns() -> None:
    free = model(4, ["1:X", "2:X", "3:X", "4:X"])
    held = constrain(free, grounded=["2:X"])
    keep = [0, 2, 3]
    assert held.dofs.labels == ["1:X", "3:X", "4:X"]
    for name in ("stiffness", "mass", "viscous"):
        np.testing.assert_allclose(
            getattr(held, name).toarray(),
            getattr(free, name).toarray()[np.ix_(keep, keep)],
            rtol=1e-14,
        )
    assert held.group("a").loss_factor == 0.1


def test_a_chain_of_equations_is_resolved() -> None:
    """u4 = 2 u3 and u3 = -u1 + 0.5 u2, so u4 = -2 u1 + u2."""
    free = model(4, ["1:X", "2:X", "3:X", "4:X"])
    tied = constrain(
        free, [Equation("4:X", {"3:X": 2.0}), Equation("3:X", {"1:X": -1.0, "2:X": 0.5})]
    )
    T = np.array([[1, 0], [0, 1], [-1, 0.5], [-2, 1]])
    np.testing.assert_allclose(
        tied.stiffness.toarray(), T.T @ free.stiffness.toarray() @ T, rtol=1e-13
    )


def test_signs_of_labels_count() -> None:
    assert str(Equation("2:-X", {"1:-Y": 3.0, "3:Z": 1.0})) == "2:X = +3 1:Y -1 3:Z"


def test_a_gear_ratio_gives_the_reflected_inertia() -> None:
    """Two free inertias of 2 and 3 kg m2, the second 4 times as fast: 2 + 16 * 3, seen from the first."""
    train = updyn.Model.from_groups(
        {"J1": updyn.Group(mass=np.diag([2.0, 0.0])), "J2": updyn.Group(mass=np.diag([0.0, 3.0]))},
        ["1:RZ", "2:RZ"],
    )
    tied = constrain(train, [Equation("2:RZ", {"1:RZ": -4.0})])
    np.testing.assert_allclose(tied.mass.toarray(), [[50.0]], rtol=1e-14)


def test_a_rigid_link_moves_as_a_rigid_body() -> None:
    """Small rotation about a fixed axis through the master: u = theta x r (any text on rigid-body kinematics)."""
    xyz = RNG.standard_normal((3, 3))
    geometry = Geometry([1, 2, 7], xyz)
    move, turn = RNG.standard_normal(3), RNG.standard_normal(3)
    at = dict(zip(("1:X", "1:Y", "1:Z", "1:RX", "1:RY", "1:RZ"), [*move, *turn], strict=True))
    for link in rigid_link(geometry, 1, [2, 7]):
        r = xyz[[1, 2][link.dof.node == 7]] - xyz[0]
        wanted = np.r_[move + np.cross(turn, r), turn][DIRECTIONS.index(link.dof.direction)]
        assert sum(c * at[str(d)] for d, c in link.terms.items()) == pytest.approx(
            wanted, rel=1e-13
        )


def test_axes_are_made_of_length_one() -> None:
    assert (
        along_axis("9:X", 3, [0.0, 3.0, 4.0]).terms
        == Equation("9:X", {"3:Y": 0.6, "3:Z": 0.8}).terms
    )
    assert about_axis("9:RZ", 3, [-2.0, 0, 0]).terms == Equation("9:RZ", {"3:RX": -1.0}).terms
    for bad in ([0, 0, 0], [1, 2], [np.nan, 0, 1], "x", ["1", "0", "0"], [True, False, False]):
        with pytest.raises(ModelError, match="equation of 9:RZ: axis"):
            about_axis("9:RZ", 3, bad)


def test_joined_models_share_dofs_of_one_label() -> None:
    left = updyn.Model.from_groups(
        {"k1": updyn.Group(spring(2.0))},
        ["1:X", "2:X"],
        geometry=Geometry([1, 2], [[0, 0, 0], [1, 0, 0]], [[1, 2]]),
    )
    right = updyn.Model.from_groups(
        {"k2": updyn.Group(spring(3.0), loss_factor=0.2)},
        ["3:X", "2:X"],
        geometry=Geometry([3, 2], [[2, 0, 0], [1, 0, 0]], [[3, 2]]),
    )
    both = join([left, right])
    assert both.dofs.labels == ["1:X", "2:X", "3:X"]
    np.testing.assert_allclose(both.stiffness.toarray(), [[2, -2, 0], [-2, 5, -3], [0, -3, 3]])
    assert both.geometry is not None
    assert both.geometry.nodes.tolist() == [1, 2, 3]
    assert both.geometry.lines.tolist() == [[1, 2], [2, 3]]
    assert both.group("k2").loss_factor == 0.2


def test_what_cannot_be_tied_is_refused_by_name() -> None:
    free = model(3, ["1:X", "2:X", "3:X"])
    one = Equation("1:X", {"2:X": 1.0})
    with pytest.raises(ModelError, match=r"tied twice: 1:X = \+1 2:X; 1:X = \+1 3:X"):
        constrain(free, [one, Equation("1:X", {"3:X": 1.0})])
    with pytest.raises(ModelError, match=r"held and tied"):
        constrain(free, [one], ["1:-X"])
    with pytest.raises(ModelError, match=r"loop: 1:X = \+0.5 2:X; 2:X = \+0.5 1:X"):
        constrain(
            free,
            [
                Equation("1:X", {"2:X": 0.5}),
                Equation("2:X", {"1:X": 0.5}),
                Equation("3:X", {"1:X": 1.0}),
            ],
        )
    with pytest.raises(ModelError, match="has no free DOF"):
        constrain(free, [], ["1:X", "2:X", "3:X"])
    with pytest.raises(updyn.UpdynError, match=r"4:X.*3:X"):
        constrain(free, [Equation("1:X", {"4:X": 1.0})])
    with pytest.raises(ModelError, match="occurs twice"):
        Equation("1:X", {"1:-X": 1.0})
    with pytest.raises(ModelError, match="not finite"):
        Equation("1:X", {"2:X": np.inf})
    with pytest.raises(ModelError, match="not finite"):
        Equation("1:X", {"2:X": 10**400})
    with pytest.raises(ModelError, match="both have a group 'a'"):
        join([free, free])


def test_joined_geometries_must_agree() -> None:
    def at(x: float, name: str) -> updyn.Model:
        return updyn.Model.from_groups(
            {name: updyn.Group(spring(1.0))},
            ["1:X", "2:X"],
            geometry=Geometry([1, 2], [[x, 0, 0], [1, 0, 0]]),
        )

    with pytest.raises(ModelError, match="node 1 is at"):
        join([at(0.0, "a"), at(0.1, "b")])


def test_a_loop_names_six_equations() -> None:
    labels = [f"{i + 1}:X" for i in range(8)]
    ties = [Equation(label, {labels[i - 1]: 0.5}) for i, label in enumerate(labels)]
    with pytest.raises(ModelError) as refused:
        constrain(model(8, labels), ties)
    assert str(refused.value).count("=") == 6
