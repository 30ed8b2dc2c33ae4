"""Sparse solves: right answers, singular matrices found, backends checked by name."""

import pickle

import numpy as np
import pytest
import scipy.sparse as sp

from updyn.errors import OptionError, SolverError
from updyn.linalg import solver as factorise
from updyn.linalg.solver import BACKENDS, SparseSolver

INSTALLED = [b for b in BACKENDS if BACKENDS[b].available()]


def symmetric(n, seed=0):
    rng = np.random.default_rng(seed)
    A = sp.random_array((n, n), density=3.0 / n, rng=rng) + 1j * sp.random_array(
        (n, n), density=3.0 / n, rng=rng
    )
    return sp.csc_array(A + A.T + (4 + 1j) * sp.eye_array(n))


@pytest.mark.parametrize("backend", INSTALLED)
def test_solution_against_dense(backend):
    A, rng = symmetric(80), np.random.default_rng(3)
    B = rng.standard_normal((80, 4)) + 1j * rng.standard_normal((80, 4))
    assert SparseSolver(backend).solve(A, B, 1.0) == pytest.approx(
        np.linalg.solve(A.toarray(), B), rel=1e-11
    )


@pytest.mark.parametrize("backend", INSTALLED)
def test_zero_on_the_diagonal(backend):
    """A massless mechanism has zeros on the diagonal that pivoting must step around."""
    A = sp.csc_array(np.array([[0, 1.0, 0], [1.0, 0, 2.0], [0, 2.0, 1.0]], dtype=complex))
    B = np.eye(3, dtype=complex)
    assert SparseSolver(backend).solve(A, B, 1.0) == pytest.approx(
        np.linalg.solve(A.toarray(), B), abs=1e-14
    )


@pytest.mark.parametrize("backend", INSTALLED)
@pytest.mark.parametrize("lost", [0.0, 3e-15])
def test_singular_matrix_is_found_and_the_line_named(backend, lost):
    """Exactly singular, and singular but for rounding: the residual alone shows neither."""
    A = sp.csc_array(np.array([[1.0 + lost, -1.0], [-1.0, 1.0]], dtype=complex))
    with pytest.raises(
        SolverError, match=r"singular at 12\.5 Hz: a natural frequency without damping"
    ):
        SparseSolver(backend).solve(A, np.eye(2, dtype=complex), 12.5)


def test_message_at_rest_speaks_of_support():
    A = sp.csc_array(np.array([[1.0, -1.0], [-1.0, 1.0]], dtype=complex))
    with pytest.raises(SolverError, match="singular at 0 Hz: the structure is free to move"):
        SparseSolver("superlu").solve(A, np.eye(2, dtype=complex), 0.0)


class Fake:
    """A backend whose answers are what a test wants."""

    answer = staticmethod(lambda A, B: np.linalg.solve(A.toarray(), B))
    analyses = 0
    solves = 0

    released = 0

    @staticmethod
    def available():
        return True

    def __init__(self, pattern, *, real=False):
        type(self).analyses += 1

    def factor(self, A):
        def solve(B):
            type(self).solves += 1
            return self.answer(A, B)

        return solve

    def release(self):
        type(self).released += 1


@pytest.fixture
def fake(monkeypatch):
    """Put a fake in the place of SuperLU, which nothing backs up."""

    def make(answer):
        made = type("Made", (Fake,), {"answer": staticmethod(answer)})
        monkeypatch.setitem(BACKENDS._entries, "superlu", made)
        return made

    return make


def exact(A, B):
    return np.linalg.solve(A.toarray(), B)


def test_solution_that_is_not_a_number_is_never_returned(fake):
    fake(lambda A, B: np.full(B.shape, np.nan + 0j))
    with pytest.raises(SolverError, match="superlu: residual nan at 3 Hz"):
        SparseSolver("superlu").solve(symmetric(5), np.eye(5, dtype=complex), 3.0)


def test_one_step_of_refinement_repairs_a_sloppy_backend(fake):
    """A relative error of 1e-5 is above the residual that is asked for; one correction leaves 1e-10."""
    made = fake(lambda A, B: exact(A, B) * (1 + 1e-5))
    A, B = symmetric(6), np.eye(6, dtype=complex)
    assert SparseSolver("superlu").solve(A, B, 1.0) == pytest.approx(exact(A, B), rel=1e-9)
    assert made.solves == 2


def test_a_pattern_is_analysed_once_and_another_anew(fake):
    made = fake(exact)
    solver, A, B = SparseSolver("superlu"), symmetric(40), np.eye(40, dtype=complex)
    for factor in (1.0, 2.0, 3.0):
        assert solver.solve(A * factor, B, 1.0) == pytest.approx(exact(A * factor, B), rel=1e-9)
    assert made.analyses == 1
    other = symmetric(40, seed=5)
    assert solver.solve(other, B, 1.0) == pytest.approx(exact(other, B), rel=1e-9)
    assert made.analyses == 2


def refuses(A, B):
    raise RuntimeError("no answer")


BROKEN = {
    "nan": (lambda A, B: B * np.nan, 2),
    "inf": (lambda A, B: B + np.inf, 2),
    "wrong": (lambda A, B: exact(A, B) * 1.5, 2),
    "refuses": (refuses, 1),
}


@pytest.mark.parametrize(("broken", "solves"), BROKEN.values(), ids=list(BROKEN))
def test_another_backend_answers_where_the_first_fails(monkeypatch, broken, solves):
    wrong = type("Wrong", (Fake,), {"answer": staticmethod(broken)})
    monkeypatch.setitem(BACKENDS._entries, "pardiso", wrong)
    A, B = symmetric(6), np.eye(6, dtype=complex)
    assert SparseSolver("pardiso").solve(A, B, 1.0) == pytest.approx(exact(A, B), rel=1e-11)
    assert wrong.solves == solves


def test_where_no_backend_answers_the_line_is_named(fake):
    fake(refuses)
    with pytest.raises(SolverError, match="singular at 3 Hz"):
        SparseSolver("superlu").solve(symmetric(5), np.eye(5), 3.0)


def test_every_installed_backend_gives_the_same_on_new_values():
    """The analysis is kept and the values change, as from line to line."""
    A, B = symmetric(300), np.eye(300, dtype=complex)[:, :5]
    solvers = [SparseSolver(b) for b in INSTALLED]
    for shift in (0.0, 0.7, -1.3):
        Z = sp.csc_array(A + shift * sp.eye_array(300))
        answers = [s.solve(Z, B, 1.0) for s in solvers]
        assert all(a == pytest.approx(exact(Z, B), rel=1e-9, abs=1e-12) for a in answers)


# -- real matrices, kept factorisations ----------------------------------------------------------------------
def indefinite(n=60, seed=1):
    """K - s M of a chain of springs, with the number of its negative eigenvalues."""
    K = sp.diags_array([-np.ones(n - 1), 2.0 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1])
    m = np.random.default_rng(seed).uniform(0.5, 2.0, n)
    A = sp.csc_array(K - 0.7 * sp.diags_array(m))
    return A, int((np.linalg.eigvalsh(A.toarray()) < 0).sum())


@pytest.mark.parametrize("backend", INSTALLED)
def test_a_real_factorisation_serves_later_right_hand_sides(backend):
    A, _ = indefinite()
    factorised = SparseSolver(backend, real=True).factorise(A, 1.0)
    rng = np.random.default_rng(0)
    for r in (1, 7, 130):
        B = rng.standard_normal((60, r))
        X = factorised.solve(B)
        assert X.dtype == np.float64
        assert pytest.approx(np.linalg.solve(A.toarray(), B), rel=1e-9, abs=1e-10) == X


@pytest.mark.parametrize("backend", INSTALLED)
def test_inertia_counts_negative_eigenvalues(backend):
    """Truth by the eigenvalues; a backend may not know, but may not be wrong."""
    solver = SparseSolver(backend, real=True)
    known = []
    for seed in range(5):
        A, truth = indefinite(seed=seed)
        known.append(solver.factorise(A, 1.0).negative)
        assert 0 < truth < 60
        assert known[-1] in (truth, None)
    assert backend == "superlu" or None not in known
    positive = sp.csc_array(A + 5 * sp.eye_array(60))
    assert solver.factorise(positive, 1.0).negative == 0


@pytest.mark.parametrize("backend", INSTALLED)
def test_inertia_with_pivots_off_the_diagonal(backend):
    """Eigenvalues of 1 and -1; with its rows exchanged, the factor of an LU is the unit matrix."""
    A = sp.csc_array(
        (np.array([0.0, 1, 1, 0]), np.array([0, 1, 0, 1]), np.array([0, 2, 4])), shape=(2, 2)
    )
    assert SparseSolver(backend, real=True).factorise(A, 1.0).negative in (1, None)


@pytest.mark.parametrize("backend", INSTALLED)
def test_a_complex_matrix_has_no_inertia(backend):
    assert SparseSolver(backend).factorise(symmetric(9), 1.0).negative is None


@pytest.mark.parametrize("backend", INSTALLED)
@pytest.mark.parametrize("ended_by", ["factorise", "solve", "release", "pattern"])
def test_an_earlier_factorisation_ends(backend, ended_by):
    """PARDISO's memory is reused: an earlier factorisation would silently answer for another matrix."""
    solver, (A, _), B = SparseSolver(backend, real=True), indefinite(), np.ones((60, 1))
    first = solver.factorise(A, 1.0)
    first.solve(B)
    end = {
        "factorise": lambda: solver.factorise(A * 2, 1.0),
        "solve": lambda: solver.solve(A * 2, B, 1.0),
        "release": solver.release,
        "pattern": lambda: solver.factorise(sp.csc_array((A @ A).toarray()), 1.0),
    }[ended_by]
    later = end()
    for use in (lambda: first.solve(B), lambda: first.negative):
        with pytest.raises(RuntimeError, match="factorisation is no longer valid"):
            use()
    del later
    assert solver.solve(A, B, 1.0) == pytest.approx(np.linalg.solve(A.toarray(), B), rel=1e-9)


def test_what_is_not_of_the_solvers_kind_is_refused():
    (A, _), Z = indefinite(), symmetric(6)
    with pytest.raises(TypeError, match="found a matrix of float64; expected complex"):
        SparseSolver("superlu").factorise(A, 1.0)
    with pytest.raises(TypeError, match="found a matrix of complex128; expected real"):
        SparseSolver("superlu", real=True).factorise(Z, 1.0)
    with pytest.raises(TypeError, match="complex right-hand sides"):
        SparseSolver("superlu", real=True).solve(A, np.ones((60, 1)) * 1j, 1.0)
    real_load = SparseSolver("superlu").solve(Z, np.eye(6), 1.0)
    assert real_load == pytest.approx(exact(Z, np.eye(6)), rel=1e-11)


@pytest.mark.parametrize("backend", INSTALLED)
def test_a_real_singular_matrix_is_found(backend):
    A = sp.csc_array(np.array([[1.0, -1.0], [-1.0, 1.0]]))
    with pytest.raises(SolverError, match="singular at 0 Hz: the structure is free to move"):
        SparseSolver(backend, real=True).solve(A, np.eye(2), 0.0)


@pytest.mark.parametrize("backend", INSTALLED)
def test_no_right_hand_side_at_all(backend):
    solver = SparseSolver(backend)
    assert solver.solve(symmetric(9), np.zeros((9, 0)), 1.0).shape == (9, 0)
    assert solver.solve_counts == {backend: 1}


@pytest.mark.parametrize("backend", INSTALLED)
@pytest.mark.parametrize("real", [True, False])
def test_sent_to_another_process_it_begins_anew(backend, real):
    """What the library holds stays behind: two would give it back."""
    (A, _), B = indefinite(), np.ones((60, 1))
    A = A if real else A * (1 + 0.1j)
    solver = SparseSolver(backend, real=real)
    solver.solve(A, B, 1.0)
    other = pickle.loads(pickle.dumps(solver))  # noqa: S301
    assert (other.backend, other.real, other.solve_counts) == (backend, real, {})
    solver.release()
    assert other.solve(A, B, 1.0) == pytest.approx(np.linalg.solve(A.toarray(), B), rel=1e-9)


# -- what happened -------------------------------------------------------------------------------------------
def test_solves_are_counted_by_backend(monkeypatch):
    sloppy = type(
        "Sloppy", (Fake,), {"answer": staticmethod(lambda A, B: exact(A, B) * (1 + 1e-5))}
    )
    monkeypatch.setitem(BACKENDS._entries, "pardiso", sloppy)
    A, B = symmetric(6), np.eye(6, dtype=complex)
    solver = SparseSolver("pardiso")
    assert (solver.solve_counts, solver.refined) == ({}, 0)
    solver.solve(A, B, 1.0)
    solver.solve(A, B, 1.0)
    assert (solver.solve_counts, solver.refined) == ({"pardiso": 2}, 2)
    sloppy.answer = staticmethod(lambda A, B: B * np.nan)
    solver.solve(A, B, 1.0)
    assert solver.solve_counts["pardiso"] == 2
    assert sum(solver.solve_counts.values()) == 3


def test_a_backend_that_fails_gives_its_memory_back_before_another_takes_some(monkeypatch):
    wrong = type("Wrong", (Fake,), {"answer": staticmethod(lambda A, B: B * np.nan)})
    monkeypatch.setitem(BACKENDS._entries, "pardiso", wrong)
    A = symmetric(6)
    solver = SparseSolver("pardiso")
    for line in (1, 2):
        solver.solve(A, np.eye(6, dtype=complex), 1.0)
        assert wrong.released == line
    assert wrong.analyses == 2


def test_a_factorisation_kept_survives_the_failure_of_its_backend(monkeypatch):
    """The first right-hand side is answered, the second not: the other backend factorises then, once."""
    moody = type("Moody", (Fake,), {"answer": staticmethod(exact)})
    monkeypatch.setitem(BACKENDS._entries, "pardiso", moody)
    solver, (A, truth), B = SparseSolver("pardiso", real=True), indefinite(), np.ones((60, 2))
    factorised = solver.factorise(A, 1.0)
    assert factorised.solve(B) == pytest.approx(exact(A, B), rel=1e-9)
    moody.answer = staticmethod(lambda A, B: B * 0)
    for _ in range(2):
        assert factorised.solve(B) == pytest.approx(exact(A, B), rel=1e-9)
    assert solver.solve_counts.pop("pardiso") == 1
    assert list(solver.solve_counts.values()) == [2]
    assert factorised.negative in (truth, None)


def test_backends_are_tried_in_order_and_those_not_installed_are_passed_over(monkeypatch):
    tried = []

    class Broken(Fake):
        def __init__(self, pattern, *, real=False):
            tried.append(self.name)
            raise RuntimeError(self.name)

    made = {name: type("Made", (Broken,), {"name": name}) for name in BACKENDS}
    for name, backend in made.items():
        monkeypatch.setitem(BACKENDS._entries, name, backend)
    with pytest.raises(SolverError, match="singular at 2 Hz"):
        SparseSolver("pardiso").solve(symmetric(5), np.eye(5), 2.0)
    assert tried == ["pardiso", "mumps", "superlu"]
    made["mumps"].available = staticmethod(lambda: False)
    tried.clear()
    with pytest.raises(SolverError):
        SparseSolver("pardiso").solve(symmetric(5), np.eye(5), 2.0)
    assert tried == ["pardiso", "superlu"]


def test_too_little_memory_is_not_answered_by_a_backend_that_needs_more(fake, monkeypatch):
    """It would be called singular, or the process would be ended by the system."""
    other = fake(exact)

    def short(self, A):
        raise MemoryError("PARDISO needs 17.4 GB")

    monkeypatch.setitem(BACKENDS._entries, "pardiso", type("Short", (Fake,), {"factor": short}))
    with pytest.raises(
        SolverError,
        match=r"pardiso: not enough memory to factorise 5 DOFs \(PARDISO needs 17.4 GB\)",
    ):
        SparseSolver("pardiso").solve(symmetric(5), np.eye(5), 2.0)
    assert other.analyses == 0


def test_peak_memory_is_that_of_the_backend_that_needs_most(monkeypatch):
    solver = SparseSolver("superlu")
    assert solver.peak_bytes is None
    solver.solve(symmetric(5), np.eye(5), 2.0)
    assert solver.peak_bytes is None
    monkeypatch.setitem(
        BACKENDS._entries,
        "superlu",
        type("Tells", (Fake,), {"peak_bytes": 7, "answer": staticmethod(exact)}),
    )
    solver.release()
    solver.solve(symmetric(5), np.eye(5), 2.0)
    assert solver.peak_bytes == 7


def test_growth_does_not_depend_on_units():
    """Scaling DOFs (metres to millimetres, radians kept) leaves the measure of singularity as it is."""
    A = symmetric(7).toarray()
    B = np.eye(7)[:, :2] + 0j
    d = 10.0 ** np.arange(-3, 4)
    X = np.linalg.solve(A, B)
    scaled = d[:, None] * A * d
    Y, C = np.linalg.solve(scaled, d[:, None] * B), d[:, None] * B
    one = factorise.growth(A.diagonal(), X, B)
    assert factorise.growth(scaled.diagonal(), Y, C) == pytest.approx(one, rel=1e-9)
    assert 0.5 < one < np.linalg.cond(A)


def test_growth_of_a_column_without_load_and_of_what_is_not_a_number():
    diagonal, B = np.ones(2) + 0j, np.array([[1.0, 0.0], [0.0, 0.0]]) + 0j
    X = np.array([[3.0, 0.0], [4.0, 0.0]]) + 0j
    assert factorise.growth(diagonal, X, B) == pytest.approx(4.0)
    assert factorise.growth(diagonal, X * np.nan, B) == np.inf


def test_backend_names(monkeypatch):
    assert factorise.check_backend(None) == INSTALLED[0]
    assert factorise.check_backend("superlu") == "superlu"
    with pytest.raises(OptionError, match=r"backend 'superlo'.*superlu"):
        factorise.check_backend("superlo")
    monkeypatch.setattr(BACKENDS["pardiso"], "available", lambda: False)
    monkeypatch.setattr(BACKENDS["mumps"], "available", lambda: False)
    assert factorise.check_backend(None) == "superlu"
    with pytest.raises(
        OptionError, match=r"'pardiso' is not installed; pip install 'updyn\[mkl\]'"
    ):
        factorise.check_backend("pardiso")
    with pytest.raises(
        OptionError, match=r"'mumps' is not installed; .*libmumps.*pip install 'updyn\[mumps\]'"
    ):
        factorise.check_backend("mumps")
    monkeypatch.setattr(BACKENDS["mumps"], "available", lambda: True)
    assert factorise.check_backend(None) == "mumps"


class Dense:
    """A backend as another package may add one."""

    install = "pip install dense"

    def __init__(self, pattern, *, real=False):
        self.peak_bytes = None

    @staticmethod
    def available():
        return True

    def factor(self, A):
        return lambda B: np.linalg.solve(A.toarray(), B)

    def release(self):
        """Do nothing."""


@pytest.fixture
def registered(monkeypatch):
    monkeypatch.setattr(BACKENDS, "_entries", dict(BACKENDS._entries))
    BACKENDS.register("dense", Dense)


def test_a_backend_of_another_package_is_one_registration(registered):
    assert factorise.check_backend("dense") == "dense"
    assert factorise.check_backend(None) == INSTALLED[0]
    A, B = symmetric(6), np.eye(6, dtype=complex)
    solver = SparseSolver("dense")
    assert solver.solve(A, B, 1.0) == pytest.approx(exact(A, B), rel=1e-11)
    assert solver.solve_counts == {"dense": 1}


def test_a_backend_of_another_package_is_backed_up_by_the_built_in_ones(registered, monkeypatch):
    monkeypatch.setattr(Dense, "factor", lambda self, A: lambda B: B * np.nan)
    A, B = symmetric(6), np.eye(6, dtype=complex)
    solver = SparseSolver("dense")
    assert solver.solve(A, B, 1.0) == pytest.approx(exact(A, B), rel=1e-11)
    assert solver.solve_counts == {INSTALLED[0]: 1}
