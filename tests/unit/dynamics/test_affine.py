"""The compiled model: values of Z, derivatives of its coefficients, and what is shared between groups."""

import numpy as np
import pytest
import scipy.sparse as sp

import updyn
from overriding import override
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.settings import AFFINE
from updyn.sensitivity import Unknowns


@pytest.fixture
def model():
    """Two groups that share DOF 2; a ground spring whose negative cancels an entry of the first."""
    a = updyn.Group(
        [[3.0, -1.0, 0], [-1.0, 2.0, 0], [0, 0, 0]], np.diag([1.0, 2.0, 0.0]), loss_factor=0.1
    )
    b = updyn.Group(
        [[0, 0, 0], [0, 5.0, -5.0], [0, -5.0, 5.0]],
        np.diag([0.0, 0.5, 4.0]),
        viscous=np.diag([0, 0, 7.0]),
    )
    c = updyn.Group(
        [[1.0, 1.0, 0], [1.0, 1.0, 0], [0, 0, 0]]
    )  # its off-diagonal cancels that of the first
    return updyn.Model.from_groups({"a": a, "b": b, "c": c}, ["1:X", "2:X", "3:X"])


def dense(system, values):
    n = system.n
    return np.stack(
        [sp.csr_array((v, system.indices, system.indptr), shape=(n, n)).toarray() for v in values.T]
    )


def by_hand(model, omega, factors=None, loss=None):
    factors, loss = factors or {}, loss or {}
    Z = 0
    for name, g in model.groups.items():
        gamma = loss.get(name, g.loss_factor)
        if g.stiffness is not None:
            Z = Z + factors.get((name, "stiffness"), 1.0) * (1 + 1j * gamma) * g.stiffness.toarray()
        if g.mass is not None:
            Z = Z - omega**2 * factors.get((name, "mass"), 1.0) * g.mass.toarray()
        if g.viscous is not None:
            Z = Z + 1j * omega * factors.get((name, "viscous"), 1.0) * g.viscous.toarray()
    return Z


def test_dynamic_stiffness_is_the_sum_of_groups(model):
    system, omega = AffineSystem.compile(model), np.array([0.0, 1.5, 20.0])
    Z = dense(system, system.values(system.coefficients(system.start, omega)))
    for z, w in zip(Z, omega, strict=True):
        assert z == pytest.approx(by_hand(model, w), rel=1e-15, abs=1e-14)


def test_entries_that_cancel_keep_their_place_in_the_pattern(model):
    """The cancelling entry must be there: with other factors it no longer cancels."""
    system = AffineSystem.compile(model)
    state = State(
        np.where([t.group == "c" for t in system.terms], 3.0, 1.0),
        system.start.loss,
        system.start.rate,
    )
    Z = dense(system, system.values(system.coefficients(state, np.array([1.0]))))[0]
    assert pytest.approx(by_hand(model, 1.0, {("c", "stiffness"): 3.0}), rel=1e-15) == Z
    assert Z[0, 1] == pytest.approx(-1.0 - 0.1j + 3.0)


def test_loss_factor_acts_on_the_updated_stiffness(model):
    """D_e = gamma_e kappa_e K_e: the erratum of the paper's eq. (15)."""
    system = AffineSystem.compile(model)
    chosen = updyn.parameters(model, stiffness="a", loss_factor="a", viscous="b")
    state = Unknowns.find(system, chosen).state(system, np.array([2.0, 0.3, 0.5]))
    Z = dense(system, system.values(system.coefficients(state, np.array([4.0]))))[0]
    expected = by_hand(model, 4.0, {("a", "stiffness"): 2.0, ("b", "viscous"): 0.5}, {"a": 0.3})
    assert pytest.approx(expected, rel=1e-15) == Z
    assert Z[0, 0].imag == pytest.approx(0.3 * 2.0 * 3.0)


def test_terms_by_quantity_and_loss_factor_shares_the_stiffness(model):
    system = AffineSystem.compile(model)
    assert [(t.group, t.quantity) for t in system.terms] == [
        ("a", "stiffness"), ("a", "mass"), ("b", "stiffness"), ("b", "mass"), ("b", "viscous"), ("c", "stiffness"),
    ]  # fmt: skip
    assert system.find("a", "loss_factor") == system.find("a", "stiffness") == 0
    assert list(system.terms[2].rows) == [1, 2]
    with pytest.raises(KeyError):
        system.find("c", "mass")


@pytest.mark.parametrize("n", [6, 900])
def test_term_times_a_field_is_the_matrix_product(n):
    """Small groups are held dense, large and empty ones sparse; both multiply complex fields as real ones."""
    rng = np.random.default_rng(1)
    K = sp.diags_array(
        [np.full(n - 1, -1.0), np.full(n, 2.5), np.full(n - 1, -1.0)], offsets=[-1, 0, 1]
    )
    model = updyn.Model.from_groups(
        {"all": updyn.Group(K, sp.eye_array(n))}, [f"{i}:X" for i in range(n)]
    )
    term = AffineSystem.compile(model).terms[0]
    assert sp.issparse(term.local) == (n == 900)
    field = rng.standard_normal((n, 3, 2)) + 1j * rng.standard_normal((n, 3, 2))
    assert term.times(field[term.rows]) == pytest.approx(
        np.einsum("ij,jab->iab", K.toarray(), field), rel=1e-13
    )
    backwards = field[:, ::-1].transpose(0, 2, 1)  # not contiguous
    assert term.times(backwards) == pytest.approx(
        np.einsum("ij,jab->iab", K.toarray(), backwards), rel=1e-13
    )


@pytest.mark.parametrize("n_lines", [1, 3])
@pytest.mark.parametrize(("chunk", "beside"), [(2, 0), (8192, 0), (8192, 100)])
def test_sums_in_pieces_and_at_once(n_lines, chunk, beside, monkeypatch):
    """Two groups that fill the whole pattern, whose entries are mixed together, and one that does not."""
    override(monkeypatch, AFFINE, cached_entries=chunk)
    override(monkeypatch, AFFINE, combined_entries=beside)
    rng = np.random.default_rng(2)
    A, B, C = (X @ X.T for X in rng.standard_normal((3, 4, 4)))
    groups = {
        "a": updyn.Group(A, B, 0.1),
        "b": updyn.Group(C),
        "c": updyn.Group(np.diag([1.0, 0, 2.0, 0])),
    }
    full = updyn.Model.from_groups(groups, [f"{i}:X" for i in range(1, 5)])
    system, omega = AffineSystem.compile(full), np.array([0.5, 2.0, 7.0])[:n_lines]
    assert (system.columns is not None) == (beside > 0)
    Z = dense(system, system.values(system.coefficients(system.start, omega)))
    for z, w in zip(Z, omega, strict=True):
        assert z == pytest.approx(by_hand(full, w), rel=1e-14, abs=1e-14)


@pytest.mark.parametrize("beside", [0, 100])
def test_real_sums_stay_real(model, beside, monkeypatch):
    """K - 4 M with weights on the terms, as `terms` lists them."""
    override(monkeypatch, AFFINE, combined_entries=beside)
    system = AffineSystem.compile(model)
    values = system.real_values(np.array([1.0, -4.0, 1.0, -4.0, 0.0, 1.0]))
    assert values.dtype == np.float64
    expected = by_hand(model, 2.0, {("b", "viscous"): 0.0}, {"a": 0.0})
    assert dense(system, values[:, None])[0] == pytest.approx(expected.real, rel=1e-15)


def test_what_matrices_have_in_common_is_kept_once(model):
    n = 900
    K = sp.diags_array(
        [np.full(n - 1, -1.0), np.full(n, 2.5), np.full(n - 1, -1.0)], offsets=[-1, 0, 1]
    )
    large = updyn.Model.from_groups(
        {"a": updyn.Group(K, abs(K)), "b": updyn.Group(sp.eye_array(n))},
        [f"{i}:X" for i in range(n)],
    )
    stiffness, mass, other = AffineSystem.compile(large).terms
    assert stiffness.slots is mass.slots
    assert stiffness.rows is mass.rows is other.rows
    assert stiffness.slots.dtype == np.int32
    own = large.groups["a"].stiffness.data
    assert np.shares_memory(stiffness.data, own)
    assert np.shares_memory(stiffness.local.data, own)
    full = AffineSystem.compile(
        updyn.Model.from_groups({"f": updyn.Group(np.eye(2) + 1.0)}, ["1:X", "2:X"])
    ).terms[0]
    assert np.shares_memory(full.local, full.data)
    assert [t.row_index for t in AffineSystem.compile(model).terms][:3] == [
        slice(0, 2),
        slice(0, 2),
        slice(1, 3),
    ]


def test_rows_apart_are_an_index():
    K = np.array([[1.0, 0, -1.0], [0, 0, 0], [-1.0, 0, 1.0]])
    model = updyn.Model.from_groups(
        {"a": updyn.Group(K), "b": updyn.Group(np.eye(3))}, ["1:X", "2:X", "3:X"]
    )
    term = AffineSystem.compile(model).terms[0]
    assert list(term.row_index) == [0, 2]
    assert term.times(np.array([2.0 + 1j, 5.0])[:, None])[:, 0] == pytest.approx([-3 + 1j, 3 - 1j])


def test_a_matrix_of_zeros_adds_nothing():
    model = updyn.Model.from_groups(
        {"a": updyn.Group(np.eye(2)), "none": updyn.Group(np.zeros((2, 2)))}, ["1:X", "2:X"]
    )
    system = AffineSystem.compile(model)
    assert list(system.real_values(np.array([3.0, 5.0]))) == [3.0, 3.0]
    assert np.arange(2)[system.terms[1].row_index].size == 0


def test_state_of_start_repeats_the_model(model):
    start = AffineSystem.compile(model).start
    assert isinstance(start, State)
    assert list(start.loss) == [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]


@pytest.mark.filterwarnings("ignore:unknown 'b.stiffness' changes nothing")
def test_a_matrix_of_zeros_is_a_term_without_rows() -> None:
    K, M = np.diag([2e4, 1e4]), np.eye(2)
    groups = {"a": updyn.Group(K, M, 0.02), "b": updyn.Group(np.zeros((2, 2)), M)}
    model = updyn.Model.from_groups(groups, ["1:X", "2:X"])
    frf = updyn.response(model, [5.0, 8.0, 11.0], ["1:X"], ["1:X"])
    result = updyn.update(model, frf, updyn.parameters(model, stiffness="all"))
    assert result.status == "not-identifiable"
    assert result.values["a.stiffness"] == pytest.approx(1.0, abs=1e-6)
    assert np.isinf(result.std["b.stiffness"])


@pytest.mark.parametrize("few", [0, 10**6])
def test_full_matrices_and_others_have_a_full_pattern(few, monkeypatch):
    override(monkeypatch, AFFINE, sorted_entries=few)
    rng = np.random.default_rng(1)
    A, B = rng.standard_normal((2, 6, 6))
    corner = np.zeros((6, 6))
    corner[4:, 4:] = [[2.0, -1.0], [-1.0, 1.0]]
    groups = {
        "corner": updyn.Group(corner, np.diag([0, 0, 0, 0, 1.0, 1.0])),
        "one": updyn.Group(A @ A.T, np.eye(6)),
        "two": updyn.Group(B @ B.T, loss_factor=0.1),
    }
    model = updyn.Model.from_groups(groups, [f"{i}:X" for i in range(1, 7)])
    system, omega = AffineSystem.compile(model), np.array([0.0, 2.0])
    Z = dense(system, system.values(system.coefficients(system.start, omega)))
    for z, w in zip(Z, omega, strict=True):
        assert z == pytest.approx(by_hand(model, w), rel=1e-14, abs=1e-14)
    assert len(system.indices) == 36
    one, two = (
        system.terms[system.find("one", "stiffness")],
        system.terms[system.find("two", "stiffness")],
    )
    assert one.slots is two.slots


def test_small_patterns_are_those_of_large_ones(monkeypatch):
    """Places found by sorting numbers, and by sparse arrays: the same in every term."""
    rng = np.random.default_rng(0)
    n = 40
    groups = {"ground": updyn.Group(sp.eye_array(n, format="csr"))}
    for i in range(6):
        rows = np.sort(rng.choice(n, rng.integers(2, 12), replace=False))
        A = np.zeros((n, n))
        B = rng.standard_normal((len(rows), len(rows)))
        A[np.ix_(rows, rows)] = B @ B.T * (rng.random((len(rows), len(rows))) < 0.5)
        A = A + A.T
        A += np.diag(np.abs(A).sum(axis=0))
        groups[f"g{i}"] = updyn.Group(sp.csr_array(A), sp.csr_array(np.diag(np.diag(A))))
    model = updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])
    few = AffineSystem.compile(model)
    override(monkeypatch, AFFINE, sorted_entries=0)
    many = AffineSystem.compile(model)
    np.testing.assert_array_equal(few.indptr, many.indptr)
    np.testing.assert_array_equal(few.indices, many.indices)
    for one, other in zip(few.terms, many.terms, strict=True):
        np.testing.assert_array_equal(one.rows, other.rows)
        np.testing.assert_array_equal(one.slots, other.slots)
        assert one.slots.dtype == other.slots.dtype
        full = [A if isinstance(A, np.ndarray) else A.toarray() for A in (one.local, other.local)]
        np.testing.assert_array_equal(*full)
