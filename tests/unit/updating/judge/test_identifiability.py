"""Rank, undetermined combinations, standard deviations: by hand, and the gear train against 60 digits."""

import numpy as np
import pytest

import updyn
from updyn.updating.fit.null_space import null_space
from updyn.updating.judge.identifiability import analyse_identifiability
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import EquationError, LogError
from updyn.updating.update import identifiability

NAMES = ["a", "b", "c"]


def from_directions(directions, std):
    """A reduced Jacobian whose information leaves `std` along orthonormal directions."""
    V = np.array(directions, dtype=float).T
    V /= np.linalg.norm(V, axis=0)
    return (V / np.array(std)).T


def test_standard_deviations_are_those_of_the_information():
    R = np.array([[100.0, 20.0, 3.0], [0.0, 50.0, -7.0], [0.0, 0.0, 12.0]])
    found = analyse_identifiability(R, NAMES)
    assert found.covariance == pytest.approx(np.linalg.solve(R.T @ R, np.eye(3)), rel=1e-12)
    assert found.report.complete
    assert found.report.rank == found.report.n_parameters == 3
    assert found.report.null_directions == found.report.determined_directions == []
    assert not found.involved.any()
    s = np.linalg.svd(R / np.linalg.norm(R, axis=0), compute_uv=False)
    assert found.report.singular_values == pytest.approx(s, rel=1e-12)
    assert found.report.condition == pytest.approx(s[0] / s[-1], rel=1e-12)
    assert found.report.collinearity == pytest.approx(1 / s[-1], rel=1e-12)
    assert analyse_identifiability(R, NAMES, inflation=2.0).covariance == pytest.approx(
        4 * found.covariance, rel=1e-12
    )


def test_unknown_without_effect():
    found = analyse_identifiability(
        np.array([[10.0, 0.0, 0.0], [3.0, 0.0, 8.0], [0.0, 0.0, 0.0]]), NAMES
    )
    assert found.report.rank == 2
    assert found.report.null_directions == [{"b": 1.0}]
    assert list(found.involved) == [False, True, False]
    assert found.report.condition == np.inf
    assert found.report.determined_directions == []
    assert np.abs(found.null_space[:, 0]) == pytest.approx([0, 1, 0], abs=1e-12)


def test_combination_open_by_arithmetic():
    """Only a + b is seen (rank 2 of 3 with c): a and -b may change together; what is determined is b + a."""
    R = np.array([[30.0, 30.0, 0.0], [0.0, 0.0, 5.0]])
    found = analyse_identifiability(R, NAMES)
    assert found.report.rank == 2
    (direction,) = found.report.null_directions
    assert set(direction) == {"a", "b"}
    assert direction["a"] / direction["b"] == pytest.approx(-1.0)
    assert max(abs(w) for w in direction.values()) == pytest.approx(1.0)
    (determined,) = found.report.determined_directions
    assert determined == pytest.approx({"a": 1.0, "b": 1.0})
    assert found.covariance[2, 2] == pytest.approx(1 / 25.0)


def test_two_open_combinations_read_as_simple_ones():
    """Of four unknowns, pairs trade off: the basis is turned until each direction names one pair."""
    R = np.array([[10.0, 10.0, 0.0, 0.0], [0.0, 0.0, 10.0, -10.0]])
    found = analyse_identifiability(R, ["a", "b", "c", "d"])
    assert found.report.rank == 2
    assert sorted(tuple(sorted(d)) for d in found.report.null_directions) == [
        ("a", "b"),
        ("c", "d"),
    ]
    by_pair = {tuple(sorted(d)): d for d in found.report.null_directions}
    assert by_pair["a", "b"]["a"] == pytest.approx(-by_pair["a", "b"]["b"])
    assert by_pair["c", "d"]["c"] == pytest.approx(by_pair["c", "d"]["d"])
    assert all(
        w == pytest.approx(1.0)
        for d in found.report.determined_directions
        for w in d.values()
        if w > 0
    )


def test_direction_open_by_noise():
    """Standard deviation 3 along a - b: open, though the arithmetic rank is full."""
    found = analyse_identifiability(
        from_directions([[1, -1, 0], [1, 1, 0], [0, 0, 1]], [3.0, 0.01, 0.02]), NAMES
    )
    assert found.report.rank == 2
    assert np.isfinite(found.report.condition)
    (direction,) = found.report.null_directions
    assert direction["a"] == pytest.approx(-direction["b"])
    assert list(found.involved) == [True, True, False]
    assert np.sqrt(found.covariance[2, 2]) == pytest.approx(0.02, rel=1e-9)


def test_unknown_that_hardly_takes_part_in_an_uncertain_direction_keeps_its_standard_deviation():
    """Along (1, 0.02, 0) the data leave 1.5: `a` is open, `b` is known to 0.03 and must not be called unknown."""
    found = analyse_identifiability(
        from_directions([[1, 0.02, 0], [-0.02, 1, 0], [0, 0, 1]], [1.5, 0.005, 0.01]), NAMES
    )
    assert found.report.rank == 2
    assert list(found.involved) == [True, False, False]
    assert np.sqrt(found.covariance[1, 1]) == pytest.approx(np.hypot(0.03, 0.005), rel=1e-3)


@pytest.mark.kernels
@pytest.mark.parametrize("seen", [1e-4, 1e-10, 1e-14, 1e-18, 1e-60])
def test_standard_deviations_beside_an_unknown_that_is_hardly_seen(seen):
    """Of a triangle the inverse is known to the last digits, whatever its columns' sizes."""
    R = np.array([[1e3, 2e2, 0.3 * seen], [0.0, 3e2, 0.5 * seen], [0.0, 0.0, seen]])
    found = analyse_identifiability(R, NAMES)
    last = np.array([-0.3 + 0.5 * 2e2 / 3e2, -0.5, 1.0]) / [1e3, 3e2, 1.0]
    inverse = np.column_stack(
        [[1e-3, 0.0, 0.0], [-2e2 / 3e2 * 1e-3, 1 / 3e2, 0.0], last / [1, 1, seen]]
    )
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx(
        np.linalg.norm(inverse, axis=1), rel=1e-7
    )
    assert found.involved.tolist() == [False, False, True]
    assert [set(d) for d in found.report.null_directions] == [{"c"}]


def test_uncertainty_spread_over_many_unknowns_still_names_the_widest():
    """Standard deviation 1.1 along (1, 1, 1): no unknown alone exceeds 0.64, and all are named."""
    found = analyse_identifiability(
        from_directions([[1, 1, 1], [1, -1, 0], [1, 1, -2]], [1.1, 0.01, 0.01]), NAMES
    )
    assert found.report.rank == 2
    assert found.involved.all()


def test_rank_does_not_depend_on_the_units_of_the_unknowns():
    R = np.array([[30.0, 30.0, 0.0], [0.0, 0.0, 5.0], [1.0, 2.0, 1.0]])
    scale = np.array([1e-5, 1.0, 1e4])
    one, two = (
        analyse_identifiability(1e3 * R, NAMES),
        analyse_identifiability(1e3 * R * scale, NAMES),
    )
    assert one.report.singular_values == pytest.approx(two.report.singular_values, rel=1e-9)


@pytest.mark.parametrize("residual", [EquationError(), LogError()], ids=lambda r: r.name)
def test_gear_train_null_direction_against_sixty_digits(gear_train, gear_train_reference, residual):
    """Four lines determine 17 of 18 unknowns; per unit of Y6 the others move as computed in 60 digits."""
    unknowns = updyn.parameters(gear_train, stiffness="all", mass="all", loss_factor="all")
    exact = {
        k.replace("u", "unit "): w
        for k, w in gear_train_reference["null_direction_4_lines"].items()
    }

    def analysed(omega):
        data = updyn.response(
            gear_train, np.array(omega) / (2 * np.pi), [f"{i}:RZ" for i in range(1, 5)], ["2:RZ"]
        )
        problem = FRFPart.build(gear_train, data, unknowns)
        local = residual.local(Problem.of([problem]), problem.coordinates.to_x(unknowns.start))
        return analyse_identifiability(1e9 * local.R, unknowns.names), local

    four, local = analysed([10, 20, 50, 100])
    assert four.report.rank == 17
    (direction,) = four.report.null_directions
    assert set(direction) == set(exact)
    per_y6 = {k: w / direction["unit 6.stiffness"] for k, w in direction.items()}
    assert per_y6 == pytest.approx(exact, rel=2e-5)
    unseen = null_space(local.R)
    assert unseen.shape == (18, 1)
    assert abs(unseen[:, 0] @ four.null_space[:, 0]) == pytest.approx(1.0, abs=1e-9)
    assert {n for n, i in zip(unknowns.names, four.involved, strict=True) if i} == set(exact)
    five, _ = analysed([10, 20, 50, 100, 150])
    assert five.report.rank == 18
    assert five.report.complete


@pytest.mark.parametrize("freq", [2.0, 3.0, 5.0, 9.0, 12.0])
def test_one_line_of_one_channel_determines_two_combinations(freq):
    """Of four unknowns, however little two of them change it: the rank of central differences."""
    K = {"a": np.diag([1e4, 0.0]), "b": 1e4 * np.array([[1.0, -1.0], [-1.0, 1.0]])}
    groups = {name: updyn.Group(k, loss_factor=0.02) for name, k in K.items()}
    model = updyn.Model.from_groups({"m": updyn.Group(mass=np.eye(2)), **groups}, ["1:X", "2:X"])
    unknowns = updyn.parameters(model, stiffness="all", loss_factor="all")
    frf = updyn.response(model, [freq], ["1:X"], ["1:X"])
    found = identifiability(model, frf, unknowns, noise={"relative": 0.01})
    omega, h, rows = 2.0 * np.pi * freq, 1e-6, []
    for name in K:
        for change in ("stiffness", "loss_factor"):
            ends = []
            for step in (h, -h):
                Z = -(omega**2) * np.eye(2) + 0j
                for other, k in K.items():
                    factor = np.exp(step) if (other, change) == (name, "stiffness") else 1.0
                    loss = 0.02 + (step if (other, change) == (name, "loss_factor") else 0.0)
                    Z += factor * (1.0 + 1j * loss) * k
                ends.append(np.log(np.linalg.solve(Z, [1.0, 0.0])[0]))
            slope = (ends[0] - ends[1]) / (2.0 * h) / 0.01
            rows.append([slope.real, slope.imag])
    size = np.sqrt(2.0) * np.linalg.svd(np.array(rows), compute_uv=False)
    assert size.min() > 100.0  # each is known to 1 %
    assert found.rank == 2
