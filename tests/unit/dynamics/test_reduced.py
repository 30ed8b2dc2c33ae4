"""The reduced tier against direct solves: the error stated holds, on models of every kind, at lines not looked at."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp

import updyn
from overriding import override
from reduced_cases import moved, plate, true_error
from updyn import sensitivity
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.basis import Basis
from updyn.dynamics.fields import LineSolver
from updyn.dynamics.reduction import Reduction
from updyn.dynamics.settings import SHIFTED
from updyn.errors import OptionError
from updyn.linalg.solver import check_backend
from updyn.sensitivity import Unknowns


def built(system: AffineSystem, state: State, *about: object, accuracy: float = 1e-5) -> Reduction:
    reduction = Reduction(system, *about, "superlu", accuracy)  # type: ignore[arg-type]
    reduction.build(state)
    return reduction


SENSORS, FORCES = np.array([470, 250, 130, 60, 31, 400, 333, 222]), np.array([470, 31])
BAND = np.linspace(8.0, 70.0, 160)
UNSEEN = BAND[:-1:8] + 0.37 * (BAND[1] - BAND[0])


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"local": 0.8},
        {"damper": 3e3},
        {"held": False},
        {"held": False, "local": 0.5, "damper": 1e4},
    ],
    ids=["layers", "local-loss", "dampers", "free", "free-all"],
)
@pytest.mark.parametrize("sensors", [SENSORS, SENSORS[:1]], ids=["8-sensors", "1-sensor"])
@pytest.mark.parametrize("move", [0.0, 0.3])
def test_the_error_stated_holds_at_lines_that_were_not_looked_at(
    options: dict, sensors: np.ndarray, move: float
) -> None:
    system = AffineSystem.compile(plate(**options))
    state = moved(system, move)
    reduction = built(system, state, sensors, FORCES[:1], (BAND[0], BAND[-1]))
    certificate = reduction.certify(state, BAND)
    assert certificate.error <= 1e-5
    assert certificate.size < 0.6 * system.n
    assert true_error(system, state, reduction, UNSEEN) <= 1e-5
    looked = np.array(certificate.lines)
    # Never too small, and not wildly too large.
    assert true_error(system, state, reduction, looked) <= certificate.error
    assert certificate.error <= 60 * max(true_error(system, state, reduction, looked), 1e-8)


def softened(system: AffineSystem, size: float) -> State:
    """The start with two of its quarters at a share of their stiffness: many modes in the band."""
    factor = system.start.factor.copy()
    stiff = [i for i, t in enumerate(system.terms) if t.quantity == "stiffness"]
    factor[[stiff[0], stiff[3]]] = size
    return State(factor, system.start.loss, system.start.rate)


def differences(
    system: AffineSystem, state: State, reduction: Reduction, freq: np.ndarray, tier: str = "sparse"
) -> tuple[np.ndarray, np.ndarray]:
    """|H_reduced - H| and H of every line, response and reference, by direct solves."""
    exact, fast = LineSolver.choose(system, tier), reduction.solver()
    c = system.coefficients(state, 2 * np.pi * freq)
    H = exact.at(exact.solve(c, reduction.columns, freq), reduction.rows).transpose(1, 0, 2)
    R = fast.at(fast.solve(c, reduction.columns, freq), reduction.rows).transpose(1, 0, 2)
    return np.abs(R - H), H


@pytest.mark.parametrize("held", [True, False], ids=["held", "free"])
@pytest.mark.parametrize("sensors", [SENSORS, SENSORS[:1]], ids=["8-sensors", "1-sensor"])
@pytest.mark.parametrize("size", [0.3, 0.1])
@pytest.mark.parametrize("enrich", [True, False])
def test_the_error_is_stated_of_every_line_and_channel(
    held: bool, sensors: np.ndarray, size: float, enrich: bool
) -> None:
    # Residuals at 14 lines alone state up to two hundred times less than the true error here.
    system = AffineSystem.compile(plate(held=held))
    state = softened(system, size)
    band = (BAND[0], BAND[-1])
    reduction = built(system, state if enrich else system.start, sensors, FORCES[:1], band)
    certificate = reduction.certify(state, BAND, enrich=enrich)
    off, H = differences(system, state, reduction, BAND)
    assert certificate.errors.shape == off.shape
    assert (off <= certificate.errors).all()
    if not enrich:
        assert certificate.error > 1e-5
        return
    largest = (off / np.abs(H).max(axis=(1, 2), keepdims=True)).max()
    assert largest <= certificate.error <= max(30 * largest, 1e-7)  # not absurdly large either
    assert (off / np.sqrt(np.mean(np.abs(H) ** 2, axis=0))).max() <= certificate.channel <= 1.0


def test_rounding_is_in_the_error() -> None:
    # Between quarters a million times softer than the seams, sparse and dense solves differ.
    system = AffineSystem.compile(plate(12))
    state = softened(system, 1e-6)
    rows = np.array([140, 77, 30, 9])
    reduction = built(system, state, rows, rows[:1], (BAND[0], BAND[-1]), accuracy=1e-10)
    certificate = reduction.certify(state, BAND)
    assert 0.0 < certificate.rounding <= certificate.error
    for tier in ("sparse", "dense"):
        off, _ = differences(system, state, reduction, BAND, tier)
        assert (off <= certificate.errors).all()


def test_a_basis_of_the_start_is_caught_after_the_unknowns_have_moved_and_cured() -> None:
    system = AffineSystem.compile(plate())
    reduction = built(system, system.start, SENSORS, FORCES, (BAND[0], BAND[-1]))
    there = moved(system, 0.2)
    before = true_error(system, there, reduction, BAND)
    checked = reduction.certify(there, BAND, enrich=False, count=40)
    assert before > 1e-4
    assert checked.error > 1e-5
    size = checked.size
    assert reduction.certify(there, BAND).size > size
    assert true_error(system, there, reduction, UNSEEN) <= 1e-5


def test_the_error_at_states_beside_each_other_takes_one_factorisation() -> None:
    system = AffineSystem.compile(plate())
    near = [moved(system, 0.02, seed) for seed in range(3)]
    reduction = built(system, system.start, SENSORS, FORCES, (BAND[0], BAND[-1]))
    reduction.enrich_around(near, BAND)
    before = reduction.shifted.count
    stated = reduction.errors([*near, moved(system, 0.3)], BAND)
    assert reduction.shifted.count == before + 2
    true = [true_error(system, state, reduction, BAND) for state in near]
    assert (np.array(true) <= stated[:3]).all()
    assert stated[:3].max() <= 1e-5
    for state, error in zip(near, stated, strict=False):  # by their own factorisation
        own = reduction.certify(state, BAND, enrich=False).error
        assert error == pytest.approx(own, rel=0.2)


def test_a_basis_that_has_settled_is_certified_as_it_is() -> None:
    system = AffineSystem.compile(plate())
    reduction = built(system, system.start, SENSORS, FORCES, (BAND[0], BAND[-1]), accuracy=1e-7)
    built_size = reduction.basis.size
    reduction.enrich_until_accurate([system.start], BAND, accuracy=1e-4)
    roughly = reduction.basis.size
    reduction.enrich_until_accurate([system.start], BAND)
    size = reduction.basis.size
    assert built_size <= roughly < size
    assert reduction.certify(system.start, BAND).size == size
    assert true_error(system, system.start, reduction, UNSEEN) <= 1e-7


def test_a_group_without_entries_is_no_hindrance() -> None:
    model = plate()
    empty = sp.csr_array(model.stiffness.shape)
    groups = {**model.groups, "none": updyn.Group(stiffness=empty, mass=empty)}
    system = AffineSystem.compile(updyn.Model.from_groups(groups, model.dofs))
    reduction = built(system, system.start, SENSORS, FORCES, (BAND[0], BAND[-1]), accuracy=1e-7)
    reduction.enrich_until_accurate([system.start], BAND)
    assert true_error(system, system.start, reduction, UNSEEN) <= 1e-7


def test_one_factorisation_makes_a_basis_hold_at_states_far_off() -> None:
    """Terms differ by a factor of e; each pass looks at other lines of them."""
    system = AffineSystem.compile(plate())
    reduction = built(system, system.start, SENSORS, FORCES, (BAND[0], BAND[-1]))
    definite, before = reduction.shifted.factor_definite(system.start), reduction.shifted.count
    signs = np.where(np.random.default_rng(3).random((2, len(system.terms))) < 0.5, -0.5, 0.5)
    level = np.ones(len(BAND))
    for sign in signs:
        far = State(system.start.factor * np.exp(sign), system.start.loss, system.start.rate)
        off = true_error(system, far, reduction, UNSEEN)
        assert off > 3e-3
        passes = 0
        while reduction.enrich_with_nearby_factor(definite, far, BAND, level, passes, 1e-4):
            passes += 1
        assert 2 <= passes <= 12
        assert true_error(system, far, reduction, UNSEEN) < min(1e-3, 0.05 * off)
    assert reduction.shifted.count == before
    # what was there is as good as before
    assert true_error(system, system.start, reduction, UNSEEN) <= 1e-5


@pytest.mark.parametrize("backend", ["superlu", None])
@pytest.mark.parametrize("size", [0.3, 0.1])
def test_in_single_precision_bases_and_their_errors_are_as_in_double(
    monkeypatch: pytest.MonkeyPatch, backend: str | None, size: float
) -> None:
    """Unrefined answers filled a basis with rounding: a fifth to a half more vectors."""
    system = AffineSystem.compile(plate())
    state, made = softened(system, size), []
    for most in (0, 10**9):
        override(monkeypatch, SHIFTED, double_dofs=most)
        about = SENSORS, FORCES, (BAND[0], BAND[-1])
        reduction = Reduction(system, *about, check_backend(backend))
        assert reduction.shifted._solver.single is (most == 0)
        reduction.build(state)
        certificate = reduction.certify(state, BAND)
        off, H = differences(system, state, reduction, BAND)
        assert certificate.error <= 1e-5
        assert (off / np.abs(H).max(axis=(1, 2), keepdims=True)).max() <= certificate.error
        made.append(certificate.size)
    assert made[0] <= 1.15 * made[1]


def beside(system: AffineSystem, share: float) -> State:
    """The start, every other mass and stiffness changed by a share."""
    change = np.where(np.arange(len(system.terms)) % 2 == 0, 1.0 + share, 1.0 - share)
    return State(system.start.factor * change, system.start.loss, system.start.rate)


@pytest.mark.parametrize("keeps", [True, False])
def test_a_factorisation_serves_states_beside_its_own_while_it_is_kept(keeps: bool) -> None:
    system = AffineSystem.compile(plate())
    reduction = built(system, system.start, SENSORS, FORCES, (BAND[0], BAND[-1]))
    reduction.shifted.keeps = keeps
    reduction.certify(system.start, BAND)
    before, near = reduction.shifted.count, beside(system, 0.05)
    certificate = reduction.certify(near, BAND)
    assert reduction.shifted.count == before + (not keeps)
    # P of the other state is a tenth off at most, and so is the error that it states.
    assert true_error(system, near, reduction, UNSEEN) <= certificate.error <= 1e-5
    reduction.certify(beside(system, 0.2), BAND)  # too far off
    assert reduction.shifted.count == before + 1 + (not keeps)
    reduction.shifted.release()
    reduction.certify(beside(system, 0.2), BAND)
    assert reduction.shifted.count == before + 2 + (not keeps)


def test_a_basis_is_enriched_or_certified_but_not_both() -> None:
    system = AffineSystem.compile(plate())
    reduction = built(system, system.start, SENSORS, FORCES, (BAND[0], BAND[-1]))
    far, size = beside(system, 0.3), reduction.basis.size
    assert true_error(system, far, reduction, UNSEEN) > 1e-5
    calls = 0
    while (certificate := reduction.certify_or_enrich(far, BAND)) is None:
        assert reduction.basis.size > size
        size, calls = reduction.basis.size, calls + 1
    assert 1 <= calls <= 4
    assert certificate.size == reduction.basis.size == size
    assert true_error(system, far, reduction, UNSEEN) <= certificate.error <= 1e-5
    again = reduction.certify(far, BAND, enrich=False)
    assert certificate.error == pytest.approx(again.error, rel=0.01)


def test_a_model_at_rest_on_a_shift_that_hits_a_natural_frequency() -> None:
    # A chain of two masses among thousands of free DOFs would do; here 1 Hz^2 units make the shift
    # exact.
    n = 600
    K, M = sp.diags_array(np.arange(1.0, n + 1)), sp.eye_array(n)
    model = updyn.Model.from_groups(
        {"a": updyn.Group(K, M, loss_factor=0.01)}, [f"{i + 1}:X" for i in range(n)]
    )
    system = AffineSystem.compile(model)
    band = (
        np.sqrt(1.0) / (2 * np.pi),
        np.sqrt(9.0) / (2 * np.pi),
    )  # both ends are natural frequencies
    dofs = np.arange(12)
    reduction = built(system, system.start, dofs, dofs[:1], band, accuracy=1e-6)
    lines = np.linspace(*band, 9)
    reduction.certify(system.start, lines)
    assert true_error(system, system.start, reduction, lines) <= 1e-6


def test_derivatives_are_those_of_the_whole_model() -> None:
    model = plate(local=0.3)
    system = AffineSystem.compile(model)
    chosen = updyn.parameters(model, stiffness="all", loss_factor=["quarter 4", "seams"])
    unknowns = Unknowns.find(system, chosen)
    reduction = built(system, system.start, SENSORS, FORCES, (BAND[0], BAND[-1]), accuracy=1e-8)
    reduction.certify(system.start, BAND)
    fast, exact = reduction.solver(), LineSolver.choose(system, "sparse")
    for freq in np.split(UNSEEN, 4):
        H, dH = sensitivity.receptance(exact, unknowns, chosen.start, freq, SENSORS, FORCES)
        R, dR = sensitivity.receptance(fast, unknowns, chosen.start, freq, SENSORS, FORCES)
        np.testing.assert_allclose(R, H, rtol=0, atol=1e-7 * np.abs(H).max())
        np.testing.assert_allclose(dR, dH, rtol=0, atol=1e-4 * np.abs(dH).max())


def test_fields_along_directions_are_those_of_the_whole_model() -> None:
    model = plate(local=0.3)
    system = AffineSystem.compile(model)
    chosen = updyn.parameters(model, stiffness="all", loss_factor=["quarter 4", "seams"])
    unknowns = Unknowns.find(system, chosen)
    reduction = built(system, system.start, SENSORS, FORCES, (BAND[0], BAND[-1]), accuracy=1e-8)
    reduction.certify(system.start, BAND)
    directions = np.random.default_rng(0).standard_normal((len(chosen), 2))
    found = []
    for solver in (LineSolver.choose(system, "sparse"), reduction.solver()):
        U, dU = sensitivity.fields_along(
            solver, unknowns, chosen.start, UNSEEN[:4], FORCES, directions
        )
        found.append([solver.at(field, SENSORS) for field in (U, dU[:, :, 0], dU[:, :, 1])])
    for exact, reduced in zip(*found, strict=True):
        np.testing.assert_allclose(reduced, exact, rtol=0, atol=1e-4 * np.abs(exact).max())


def test_projected_matrices_are_those_of_the_basis_however_it_grew() -> None:
    system = AffineSystem.compile(plate(8))
    rng = np.random.default_rng(0)
    basis = Basis(system, np.sqrt(rng.uniform(1, 1e6, system.n)))
    basis.append(rng.standard_normal((system.n, 4)))
    basis.append(
        np.hstack([basis.expand(np.eye(4)), rng.standard_normal((system.n, 2))])
    )  # four are there already
    basis.extend(rng.standard_normal((system.n, 3)))
    assert basis.size == 9
    V = basis.expand(np.eye(9))
    for term, A in zip(system.terms, basis.terms, strict=True):
        full = np.zeros((system.n, system.n))
        full[np.ix_(term.rows, term.rows)] = (
            term.local if isinstance(term.local, np.ndarray) else term.local.toarray()
        )
        np.testing.assert_allclose(A, V.T @ full @ V, rtol=1e-9, atol=1e-9 * np.abs(A).max())
    C = rng.standard_normal((4, 2))
    combined = basis.combine_last(5, C)
    W = np.hstack([V[:, :5], V[:, 5:] @ C])
    np.testing.assert_allclose(combined.expand(np.eye(7)), W, rtol=1e-10, atol=1e-12)
    for A, of_combined in zip(basis.terms, combined.terms, strict=True):
        T = scipy.linalg.block_diag(np.eye(5), C)
        np.testing.assert_allclose(of_combined, T.T @ A @ T, rtol=1e-9, atol=1e-9)
    C = rng.standard_normal((9, 5))
    basis.rotate(C)
    np.testing.assert_allclose(basis.expand(np.eye(5)), V @ C, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(basis.at(np.array([3, 1])), (V @ C)[[3, 1]], rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize(("outside", "kept"), [(0.4, 0), (0.7, 1)])
def test_a_missing_direction_mostly_in_the_basis_is_omitted(outside: float, kept: int) -> None:
    """Without rounding errors it would be orthogonal to the basis in K + omega^2 M."""
    system = AffineSystem.compile(plate(8))
    reduction = built(system, system.start, np.arange(4), np.arange(1), (8.0, 70.0))
    size = reduction.basis.size
    weights = reduction.shifted.weights(system.start, -reduction.shifted.top)
    P = system.multiply(weights, np.eye(system.n))
    V = reduction.basis.expand(np.eye(size))
    new, held = np.random.default_rng(0).standard_normal((2, system.n, 1))
    for _ in range(2):
        new -= V @ np.linalg.lstsq(V.T @ P @ V, V.T @ P @ new)[0]
    held = V @ (V.T @ held)
    new, held = (x / np.sqrt(x.T @ P @ x) for x in (new, held))
    reduction.basis.extend(np.sqrt(outside) * new + np.sqrt(1.0 - outside) * held)
    reduction._omit_rounding_errors(size, system.start)
    assert reduction.basis.size == size + kept


@pytest.mark.parametrize("change", ["rotated", "extended", "leading"])
def test_vectors_are_added_to_a_basis_that_is_not_orthonormal(change: str) -> None:
    """What is in the basis adds nothing, and what is new is added, whatever was done before."""
    system = AffineSystem.compile(plate(10))
    rng = np.random.default_rng(1)
    basis = Basis(system, np.sqrt(rng.uniform(1, 1e6, system.n)))
    basis.append(rng.standard_normal((system.n, 8)))
    if change == "rotated":
        basis.rotate(rng.standard_normal((8, 5)))
    else:
        basis.extend(rng.standard_normal((system.n, 4)))
    if change == "leading":
        basis = basis.take_leading(10)
    size, all_dofs = basis.size, np.arange(system.n)
    before = basis.at(all_dofs)
    basis.append(before @ rng.standard_normal((size, 3)))
    assert basis.size == size
    new = rng.standard_normal((system.n, 2))
    basis.append(np.hstack([new, before[:, :2]]))
    assert basis.size == size + 2
    V = basis.at(all_dofs)
    left = new - V @ np.linalg.lstsq(V, new)[0]
    np.testing.assert_array_less(np.linalg.norm(left, axis=0), 1e-9 * np.linalg.norm(new, axis=0))
    W = V[:, size:] * basis.weight[:, None] ** 2
    np.testing.assert_allclose(V[:, size:].T @ W, np.eye(2), atol=1e-9)
    lengths = np.linalg.norm(before * basis.weight[:, None], axis=0)
    np.testing.assert_allclose(before.T @ W / lengths[:, None], 0.0, atol=1e-9)


@pytest.mark.parametrize("options", [{}, {"damper": 3e3}], ids=["layers", "dampers"])
def test_a_basis_of_many_states_holds_roughly_between_them(options: dict) -> None:
    system = AffineSystem.compile(plate(**options))
    reduction = built(system, system.start, SENSORS, FORCES, (BAND[0], BAND[-1]))
    between = moved(system, 0.3)
    near = true_error(system, between, reduction, BAND)
    states = [system.start, *(moved(system, 0.4, seed) for seed in range(2, 14))]
    reduction.build_around(states)
    wide = reduction.basis.size
    error = true_error(system, between, reduction, BAND)
    assert error < min(0.1 * near, 1e-3)
    samples = [system.start, *(moved(system, 0.4, seed) for seed in range(20, 40))]
    reduction.compress_around(samples, BAND, 1e-3)
    assert reduction.basis.size < 0.8 * wide
    assert true_error(system, between, reduction, BAND) < 0.01


def test_compressing_tells_what_each_channel_lost() -> None:
    system = AffineSystem.compile(plate())
    reduction = Reduction(system, SENSORS, FORCES, (BAND[0], BAND[-1]), "superlu")
    states = [system.start, *(moved(system, 0.4, seed) for seed in range(2, 8))]
    reduction.build_around(states)
    full, lines = reduction.solver(), BAND[:: -(-len(BAND) // 10)]
    lost = reduction.compress_around(states, lines, 3e-3)
    fewer, squares = reduction.solver(), []
    for state in states:
        c = system.coefficients(state, 2 * np.pi * lines)
        before, after = (
            solver.at(solver.solve(c, FORCES, lines), SENSORS) for solver in (full, fewer)
        )
        level = np.abs(before).max(axis=(0, 2), keepdims=True)
        squares.append((np.abs(after - before) / level) ** 2)
    expected = np.sqrt(np.concatenate(squares, axis=1).mean(axis=1))
    assert expected.min() > 1e-9
    np.testing.assert_allclose(lost, expected, rtol=1e-3)


def test_many_references_take_no_more_vectors_than_a_few() -> None:
    system = AffineSystem.compile(plate())
    sizes = []
    for n in (4, 8):
        reduction = Reduction(system, SENSORS, SENSORS[:n], (BAND[0], BAND[-1]), "superlu")
        reduction.build_around([system.start, moved(system, 0.3)])
        sizes.append(reduction.basis.size)
    assert sizes[0] == sizes[1] == 2 * 3 * (4 + 2)


def test_compressing_keeps_the_answers() -> None:
    system = AffineSystem.compile(plate())
    reduction = built(system, system.start, SENSORS, FORCES, (BAND[0], BAND[-1]), accuracy=1e-8)
    reduction.certify(system.start, BAND)
    size = reduction.basis.size
    reduction.accuracy = 1e-5
    reduction.compress(system.start, BAND)
    assert reduction.basis.size < size
    assert true_error(system, system.start, reduction, BAND) <= 1e-5


def test_the_condensed_stiffness_is_refused() -> None:
    system = AffineSystem.compile(plate(6))
    reduction = built(system, system.start, np.array([3]), np.array([3]), (5.0, 20.0))
    with pytest.raises(OptionError, match="tier 'sparse'"):
        reduction.solver().condense(np.ones((6, 1)) + 0j, np.array([3]), np.array([10.0]))


def test_response_by_a_reduced_model_says_how_good_it_is() -> None:
    model = plate(local=0.5)
    sensors = [str(model.dofs[int(i)]) for i in SENSORS]
    exact = updyn.response(model, BAND, sensors, sensors[1:3], "accelerance")
    fast = updyn.response(
        model, BAND, sensors, sensors[1:3], "accelerance", tier="reduced", accuracy=1e-6
    )
    peak = np.abs(exact.values).max(axis=(1, 2), keepdims=True)
    assert (np.abs(fast.values - exact.values) <= 1e-6 * peak).all()
    assert "reduced to" in fast.source
    # More references than responses: the forces stand at the responses.
    swapped = updyn.response(
        model, BAND, sensors[1:3], sensors, "accelerance", tier="reduced", accuracy=1e-6
    )
    np.testing.assert_allclose(
        swapped.values.transpose(0, 2, 1), exact.values, rtol=0, atol=1e-6 * peak.max()
    )
    with pytest.raises(OptionError, match="accuracy = 0"):
        updyn.response(model, BAND, sensors, sensors[:1], tier="reduced", accuracy=0)
