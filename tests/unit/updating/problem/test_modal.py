"""Measured modes as data: residuals and their derivatives, pairing, loss factors, estimated noise."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

import updyn
from updyn.errors import DataError, OptionError
from updyn.modal import ModeSet
from updyn.model import Group, Model
from updyn.updating.judge.assessment import linearise_at_start
from updyn.updating.problem.modal import ModalError, ModalPart
from updyn.updating.problem.modal_rows import KINDS, ModalRows
from updyn.updating.problem.noise.modes import ASSUMED_OF_MODES, ModalNoise, choose_modal_noise
from updyn.updating.problem.problem import Problem


def shaft(parts: int = 3, loss: float = 0.03) -> Model:
    """Eight masses on springs, held at one end, in pieces; dashpots to the ground at two of them."""
    n = 8
    groups = {}
    for p in range(parts):
        K, M = np.zeros((n, n)), np.zeros((n, n))
        for i in range(n):
            if i * parts // n == p:
                M[i, i] = 1.0 + 0.1 * i
                K[i, i] += 1e4
                if i:
                    K[i - 1, i - 1] += 1e4
                    K[i, i - 1] -= 1e4
                    K[i - 1, i] -= 1e4
        groups[f"piece {p + 1}"] = Group(K, M, loss_factor=loss * (p + 1), stiffness_damping=1e-5)
    C = np.zeros((n, n))
    C[2, 2], C[6, 6] = 0.4, 0.9
    groups["dashpots"] = Group(viscous=C)
    return Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])


def modes_of(model: Model, n: int, *, scaled: bool = False, **known: object) -> ModeSet:
    value, shapes = scipy.linalg.eigh(model.stiffness.toarray(), model.mass.toarray())
    if not scaled:
        shapes = shapes * np.array([3.0, -2.0, 0.5, 7.0, 1.0, 1.0, 1.0, 1.0])
    return ModeSet(
        np.sqrt(value[:n]) / (2 * np.pi), shapes[:, :n], model.dofs, scaled=scaled, **known
    )


def part_of(model: Model, modes: ModeSet, noise: object = None) -> ModalPart:
    unknowns = updyn.parameters(
        model,
        stiffness="piece*",
        mass="piece*",
        loss_factor="piece*",
        viscous="dashpots",
        stiffness_damping=["piece 2"],
    )
    return ModalPart.build(model, modes, unknowns, choose_modal_noise(noise))


# -- residuals -------------------------------------------------------------------------------------------------------
def test_derivatives_are_those_of_central_differences() -> None:
    true = shaft().scaled({"piece 1": {"stiffness": 1.2}, "piece 3": {"mass": 0.9}})
    modes = modes_of(true, 4, scaled=True, loss_factor=[0.05, 0.06, 0.04, 0.07])
    part = part_of(shaft(), modes)
    x = part.coordinates.start + 0.02 * np.sin(np.arange(part.n))
    rows = part.rows(x)
    assert sorted(set(rows.kind)) == list(range(len(KINDS)))
    assert len(rows.r) == 4 * (1 + 8 + 1 + 1 + 1)
    for i in range(part.n):
        step = np.zeros(part.n)
        step[i] = 1e-5
        ahead, behind = part.rows(x + step, derivatives=False), part.rows(x - step)
        difference = (ahead.r - behind.r) / 2e-5
        np.testing.assert_allclose(rows.J[:, i], difference, rtol=1e-5, atol=1e-7)


def test_loss_factors_of_modes_are_those_of_the_damped_model() -> None:
    """Complex eigenvalues: damping is small, so that the energy lost in the undamped shape is exact to its square."""
    model = shaft(loss=0.004)
    damped = updyn.modes(model, 5)
    modes = modes_of(model, 5, loss_factor=damped.loss_factor)
    rows = part_of(model, modes).rows(part_of(model, modes).coordinates.start)
    own = rows.r[rows.of("loss_factor")]
    assert len(own) == 5
    assert np.abs(own).max() < 5e-4


def test_damping_is_not_compared_where_no_unknown_changes_it() -> None:
    model = shaft()
    modes = modes_of(model, 3, loss_factor=[0.05, 0.06, 0.04])
    part = ModalPart.build(model, modes, updyn.parameters(model, stiffness="piece*"), ModalNoise())
    assert not part.has_damping_unknowns
    rows = part.rows(part.coordinates.start)
    assert not rows.of("loss_factor").any()
    np.testing.assert_allclose(rows.r, 0.0, atol=1e-9)


def test_a_mode_that_resembles_none_counts_more_than_any_that_does() -> None:
    """So the misfit falls when a mode of the model comes to resemble it."""
    model = shaft()
    modes = modes_of(model, 3)
    shapes = np.column_stack([modes.shapes, np.resize([1.0, -1.0], 8)])
    stray = ModeSet([*modes.frequency, 25.0], shapes, model.dofs)
    both = [part_of(model, m) for m in (modes, stray)]
    x = both[0].coordinates.start
    error = ModalError(ModalNoise())
    known, lost = (error.local(part, x).cost for part in both)
    assert list(both[1].rows(x).unpaired_modes(both[1].least_mac)) == [3]
    expected = 0.5 * (1.0 / 0.01**2 + 7.0 / 0.1**2 + 1.0 / 0.2**2)
    assert lost - known == pytest.approx(expected, rel=1e-12)


def test_scale_counts_only_where_it_is_stated() -> None:
    model = shaft()
    part = part_of(model, modes_of(model, 3, scaled=True))
    rows = part.rows(part.coordinates.start)
    assert rows.of("scale").sum() == 3
    assert np.isinf(ModalNoise().std(rows)[rows.of("scale")]).all()
    stated = choose_modal_noise({"scale": 0.05})
    assert stated.std(rows)[rows.of("scale")] == pytest.approx(0.05)


def test_more_modes_than_the_model_has_are_refused() -> None:
    model = shaft()
    shapes = np.random.default_rng(0).standard_normal((8, 9))
    part = part_of(model, ModeSet(np.arange(1.0, 10.0), shapes, model.dofs))
    with pytest.raises(DataError, match=r"9 modes were measured; .* the model has 8"):
        part.rows(part.coordinates.start)


# -- noise -----------------------------------------------------------------------------------------------------------
def simulated(
    sizes: dict[str, float], std: dict[str, float], seed: int, n: int = 4, modes: int = 400
) -> ModalRows:
    """Residuals of a linear model at its least-squares solution; shapes of 20 sensors."""
    rng = np.random.default_rng(seed)
    kind, mode, real = [], [], []
    for m in range(modes):
        for name, many in (("frequency", 1), ("shape", 20), ("loss_factor", 1)):
            kind += [KINDS.index(name)] * many
            mode += [m] * many
            real += [np.hypot(sizes[name], std.get(name, 0.0))] * many
    known = np.array([std.get(KINDS[k], 0.0) for k in kind])
    sigma = np.array(real)
    J = rng.standard_normal((len(kind), n)) * sigma[:, None]
    noise = sigma * rng.standard_normal(len(kind))
    fitted = J / sigma[:, None]
    left = noise - J @ np.linalg.lstsq(fitted, noise / sigma, rcond=None)[0]
    # The length of each shape is free: one of its residuals is lost.
    shape = np.array(kind) == KINDS.index("shape")
    left[shape] *= np.sqrt(19.0 / 20.0)
    return ModalRows(left, J, np.array(kind), np.array(mode), known, np.ones(modes))


def test_sizes_of_errors_are_told_apart() -> None:
    sizes = {"frequency": 2e-3, "shape": 0.05, "loss_factor": 0.1}
    found = ModalNoise().refit(simulated(sizes, {}, 0), np.zeros((0, 4)))
    assert found.kind == "estimated"
    for name, size in sizes.items():
        assert found.added[name] == pytest.approx(size, rel=0.1)


def test_what_the_data_state_holds_unless_the_residual_contradicts_it() -> None:
    std = {"frequency": 2e-3, "shape": 0.05, "loss_factor": 0.1}
    same = simulated(dict.fromkeys(std, 0.0), std, 1)
    found = ModalNoise().refit(same, np.zeros((0, 4)))
    assert found.kind == "standard deviations"
    assert found.std(same) == pytest.approx(same.std, rel=1e-6)
    more = simulated({"frequency": 6e-3, "shape": 0.0, "loss_factor": 0.0}, std, 2)
    found = ModalNoise().refit(more, np.zeros((0, 4)))
    assert found.added["frequency"] == pytest.approx(6e-3, rel=0.1)
    assert found.added["shape"] < 1e-6


def without_spare(shape: float) -> ModalRows:
    """Three frequencies that three unknowns reproduce, and shapes off by a share."""
    rows = simulated({"frequency": 1e-9, "shape": shape, "loss_factor": 0.1}, {}, 3, n=3, modes=3)
    J = rows.J.copy()
    J[rows.of("frequency")] = 100.0 * np.eye(3)
    J[~rows.of("frequency")] = 0.0
    return ModalRows(rows.r, J, rows.kind, rows.mode, rows.std, rows.mac)


@pytest.mark.parametrize(("shape", "expected"), [(0.04, 0.004), (0.1, 0.01), (0.5, 0.01)])
def test_few_residuals_of_a_kind_have_the_usual_size(shape: float, expected: float) -> None:
    """In the usual ratio to shapes that are exact; shapes that leave much loosen no frequency."""
    found = ModalNoise().refit(without_spare(shape), np.zeros((0, 3)))
    assert found.added["shape"] == pytest.approx(shape, rel=0.3)
    ratio = found.added["frequency"] / ASSUMED_OF_MODES["frequency"]
    assert ratio == pytest.approx(
        min(found.added["shape"] / ASSUMED_OF_MODES["shape"], 1.0), rel=1e-3
    )
    assert found.added["frequency"] == pytest.approx(expected, rel=0.3)
    assert "frequency" in found.by_ratio


def test_weights_and_unknowns_minimise_one_function() -> None:
    """s^2 = (sum r^2 + 2 s_0^2) / (n + 2): the usual size counts as two residuals."""
    rows = without_spare(0.5)
    found = ModalNoise().estimate_for_weights(rows)
    for kind, n in (("frequency", 3), ("shape", 57), ("loss_factor", 3)):
        r, usual = rows.r[rows.of(kind)], ASSUMED_OF_MODES[kind]
        expected = np.sqrt((r @ r + 2.0 * usual**2) / (n + 2.0))
        assert found.added[kind] == pytest.approx(expected, rel=1e-9)


def test_what_is_stated_is_not_estimated() -> None:
    rows = simulated({"frequency": 2e-3, "shape": 0.05, "loss_factor": 0.1}, {}, 4)
    stated = choose_modal_noise({"frequency": 1e-3, "shape": 0.1, "loss_factor": 0.3})
    assert stated.size_known
    assert stated.refit(rows, np.zeros((0, 4))) is stated
    partly = choose_modal_noise({"frequency": 1e-3}).refit(rows, np.zeros((0, 4)))
    assert partly.added["frequency"] == 1e-3
    assert partly.added["shape"] == pytest.approx(0.05, rel=0.1)


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        ("coherence", "modes take a table with some of frequency, shape, loss_factor, scale"),
        ({"shapes": 0.1}, "no key 'shapes' for modes; did you mean 'shape'"),
        ({"frequency": 0}, "frequency = 0; expected a number above 0"),
        ({"shape": True}, "shape = True; expected a number above 0"),
    ],
)
def test_noise_that_is_not_understood(noise: object, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        choose_modal_noise(noise)


@pytest.mark.parametrize("turn", [0.0, np.pi / 2])  # cos(90 degrees) is 6e-17
def test_a_mode_in_another_plane_than_the_sensors_is_paired_with_none(turn: float) -> None:
    """At a single sensor every shape has a MAC of 1, that of rounding, too."""
    along = shaft(parts=2)
    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[c, -s], [s, c]])
    groups = {}
    for name in ("piece 1", "piece 2"):
        part = along.group(name)
        K = np.kron(part.stiffness.toarray(), R.T @ np.diag([1.0, 1.37]) @ R)
        groups[name] = Group(K, np.kron(part.mass.toarray(), np.eye(2)))
    model = Model.from_groups(groups, [f"{i + 1}:{axis}" for i in range(8) for axis in "YZ"])
    unknowns = updyn.parameters(model, stiffness="all")
    true = {"piece 1": {"stiffness": 0.75}, "piece 2": {"stiffness": 0.72}}
    found = updyn.modes(model.scaled(true), 10)
    for axis in "YZ":
        seen = found.at([f"8:{axis}"])
        move = np.abs(seen[0]) > 1e-9
        measured = ModeSet(found.frequency[move][:4], seen[:, move][:, :4], [f"8:{axis}"])
        result = updyn.update(model, measured, unknowns)
        assert result.values == pytest.approx(
            {"piece 1.stiffness": 0.75, "piece 2.stiffness": 0.72}, rel=1e-6
        )


def test_correlated_frequencies_are_weighted_by_the_inverse_of_their_covariance() -> None:
    """Of four modes, the second one has no known error: its residual has the added noise alone."""
    model = shaft()
    f = modes_of(model, 4).frequency
    root = np.array([[2.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.5, -0.5, 0.8]])
    known = np.ix_([0, 2, 3], [0, 2, 3])
    shares = np.zeros((4, 4))
    shares[known] = 1e-6 * root @ root.T
    covariance = np.full((4, 4), np.nan)
    covariance[known] = (shares * np.outer(f, f))[known]
    part = part_of(
        model.scaled({"piece 1": {"stiffness": 1.3}}), ModeSet(f, cov_frequency=covariance)
    )
    noise = ModalNoise({"frequency": 5e-4})
    x = part.coordinates.start
    plain, error = part.rows(x), ModalError(noise)
    inverse = np.linalg.solve(shares + 25e-8 * np.eye(4), np.eye(4))
    assert 2.0 * error.local(part, x).cost == pytest.approx(plain.r @ inverse @ plain.r, rel=1e-10)
    local = error.local(part, x)
    normal = plain.J.T @ inverse @ plain.J
    np.testing.assert_allclose(local.R.T @ local.R, normal, rtol=1e-8, atol=1e-9)
    size = -0.5 * np.linalg.slogdet(inverse)[1]
    expected = 0.5 * plain.r @ inverse @ plain.r + size
    assert error.negative_log_likelihood(part, x) == pytest.approx(expected, rel=1e-10)
    # A stated size replaces the covariance of the data.
    stated = ModalError(ModalNoise({"frequency": 1e-2}, frozenset({"frequency"})))
    assert 2.0 * stated.local(part, x).cost == pytest.approx(1e4 * plain.r @ plain.r, rel=1e-10)


def test_a_principal_variance_below_zero_by_rounding_is_known_and_small() -> None:
    """A standard deviation of 0 would count as unknown, and nan would omit the residual."""
    covariance = np.diag([1e-2, -1e-20])
    two = np.arange(2)
    rows = ModalRows(np.zeros(2), np.zeros((2, 1)), 0 * two, two, np.ones(2), np.ones(2))
    std = rows.decorrelate_frequencies(covariance).std
    assert 0.0 < std[0] < 1e-100
    assert std[1] == pytest.approx(0.1)


def test_before_a_fit_the_standard_deviations_of_the_data_hold_alone() -> None:
    """The assumed size of a frequency, 1 %, is added only where the data state none."""
    model = shaft()
    f = modes_of(model, 2).frequency
    covariance = 1e-6 * np.array([[4.0, 1.5], [1.5, 1.0]]) * np.outer(f, f)
    stated = {"cov_frequency": covariance}
    for known, shares in ((stated, covariance / np.outer(f, f)), ({}, 1e-4 * np.eye(2))):
        part = part_of(model, ModeSet(f, **known))
        plain = part.rows(part.coordinates.start)
        R = linearise_at_start(Problem.of((), [part]), ())[0].R
        expected = plain.J.T @ np.linalg.solve(shares, plain.J)
        np.testing.assert_allclose(R.T @ R, expected, rtol=1e-6, atol=1e-6)
