"""What is particular to cuDSS: on a card where there is one, and on one that the host plays."""

import ctypes
import enum
import sys
import types

import numpy as np
import pytest
import scipy.sparse as sp

from updyn.linalg import cudss
from updyn.linalg.solver import SparseSolver


@pytest.fixture(autouse=True)
def fresh():
    cudss._libraries.cache_clear()
    yield
    cudss._libraries.cache_clear()


def chain(n, shift, kind, loss_factor=0):
    """Masses on springs, (1 + i loss factor) K - shift M, the ends fixed."""
    K = sp.diags_array([-np.ones(n - 1), 2.0 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1])
    return sp.csc_array(
        K * kind(1 + 1j * loss_factor if loss_factor else 1) - shift * sp.eye_array(n)
    )


def below(n, shift):
    """Eigenvalues of the chain below a shift: 2 - 2 cos (Strang, SIAM Review 41 (1999) 135)."""
    return int((2 - 2 * np.cos(np.pi * np.arange(1, n + 1) / (n + 1)) < shift).sum())


class Played:
    """The functions of the bindings that are called, with the host's memory as the card's."""

    class cuDSSError(Exception):  # noqa: N801  (the bindings' name)
        def __init__(self, status):
            super().__init__(status.name)
            self.status = status

    DataType = enum.IntEnum("DataType", {"R_64F": 1, "C_64F": 5, "R_32I": 10})
    MatrixType = enum.IntEnum("MatrixType", {"SYMMETRIC": 1})
    MatrixViewType = enum.IntEnum("MatrixViewType", {"UPPER": 2})
    IndexBase = enum.IntEnum("IndexBase", {"ZERO": 0})
    Layout = enum.IntEnum("Layout", {"COL_MAJOR": 0})
    Status = enum.IntEnum("Status", {"ALLOC_FAILED": 2, "EXECUTION_FAILED": 5})
    Phase = enum.IntEnum("Phase", {"ANALYSIS": 3, "FACTORIZATION": 4, "SOLVE": 1008})
    ConfigParam = enum.IntEnum("ConfigParam", {"PIVOT_EPSILON": 9})
    DataParam = enum.IntEnum(
        "DataParam", {"INFO": 0, "NPIVOTS": 2, "INERTIA": 3, "MEMORY_ESTIMATES": 13}
    )
    cudaError_t = enum.IntEnum(  # noqa: N815
        "cudaError_t", {"cudaSuccess": 0, "cudaErrorMemoryAllocation": 2, "cudaErrorUnknown": 999}
    )
    cudaMemcpyKind = enum.IntEnum(  # noqa: N815
        "cudaMemcpyKind", {"cudaMemcpyHostToDevice": 1, "cudaMemcpyDeviceToHost": 2}
    )

    def __init__(self):
        self.alive, self.settings, self.cards, self.version = {}, {}, 1, (0, 8)
        self.malloc_fails, self.fails_in = False, {}

    # -- CUDA

    def cudaGetDeviceCount(self):
        return self.cudaError_t.cudaSuccess, self.cards

    def cudaMalloc(self, n_bytes):
        if self.malloc_fails:
            return self.cudaError_t.cudaErrorMemoryAllocation, None
        memory = np.full(n_bytes, 255, dtype=np.uint8)
        self.alive[memory.ctypes.data] = memory
        return self.cudaError_t.cudaSuccess, memory.ctypes.data

    def cudaFree(self, place):
        del self.alive[place]
        return (self.cudaError_t.cudaSuccess,)

    def cudaMemcpy(self, to, place, n_bytes, direction):
        on_card = to if direction == 1 else place
        assert self.alive[on_card].nbytes >= n_bytes
        ctypes.memmove(to, place, n_bytes)
        return (self.cudaError_t.cudaSuccess,)

    def cudaDeviceSynchronize(self):
        return (self.cudaError_t.cudaSuccess,)

    # -- cuDSS

    def get_property(self, number):
        return self.version[number]

    def made(self, what):
        key = len(self.alive) + 1
        while key in self.alive:
            key += 1
        self.alive[key] = what
        return key

    def destroyed(self, *keys):
        del self.alive[keys[-1]]

    def create(self):
        return self.made("handle")

    def config_create(self):
        return self.made("config")

    def data_create(self, handle):
        assert self.alive[handle] == "handle"
        return self.made({})

    destroy = config_destroy = data_destroy = matrix_destroy = destroyed

    def config_set(self, config, parameter, place, n_bytes):
        assert self.alive[config] == "config"
        kind = {4: ctypes.c_int32, 8: ctypes.c_double}[n_bytes]
        self.settings[parameter.name] = kind.from_address(place).value

    def data_get(self, handle, data, parameter, place, n_bytes, written):
        values = self.alive[data].get(parameter, np.zeros(1, dtype=np.int32))
        assert values.nbytes <= n_bytes
        ctypes.memmove(place, values.ctypes.data, values.nbytes)

    def matrix_create_csr(
        self, n, m, nnz, begin, end, column, values, offset, index, kind, mtype, view, base
    ):
        assert (n, end, offset, index, mtype, view, base) == (m, 0, 10, 10, 1, 2, 0)
        return self.made(("csr", n, nnz, begin, column, values, kind))

    def matrix_create_dn(self, n, r, ld, values, kind, layout):
        assert (ld, layout) == (n, 0)
        return self.made(("dense", n, r, values, kind))

    def on_card(self, place, kind, shape):
        return self.alive[place].view(kind)[: np.prod(shape)].reshape(shape, order="F")

    def execute(self, handle, phase, config, data, matrix, solution, load):
        if phase in self.fails_in:
            raise self.cuDSSError(self.fails_in[phase])
        _, n, nnz, begin, column, values, kind = self.alive[matrix]
        kind, told = {1: np.float64, 5: np.complex128}[kind], self.alive[data]
        begin = self.on_card(begin, np.int32, (n + 1,))
        column = self.on_card(column, np.int32, (nnz,))
        if phase == self.Phase.ANALYSIS:
            told[self.DataParam.MEMORY_ESTIMATES] = np.array([5, 7] + 14 * [0], dtype=np.int64)
        if phase == self.Phase.FACTORIZATION:
            upper = sp.csr_array((self.on_card(values, kind, (nnz,)), column, begin), shape=(n, n))
            assert (abs(sp.tril(upper, -1)).sum(), upper.indptr[-1]) == (0, nnz)
            told["A"] = (upper + sp.triu(upper, 1).T).toarray()
            # Of the order in which they stand, as of any other: Sylvester's law of inertia.
            small = abs(np.linalg.eigvals(told["A"])) < self.settings["PIVOT_EPSILON"]
            told[self.DataParam.NPIVOTS] = np.array([small.sum()], dtype=np.int32)
            if kind is np.float64:
                negative = int((np.linalg.eigvalsh(told["A"]) < 0).sum())
                told[self.DataParam.INERTIA] = np.array([n - negative, negative], dtype=np.int32)
        if phase == self.Phase.SOLVE:
            (_, *shape, to, _), (_, *_, b, _) = self.alive[solution], self.alive[load]
            self.on_card(to, kind, shape)[:] = np.linalg.solve(
                told["A"], self.on_card(b, kind, shape)
            )


@pytest.fixture
def played(monkeypatch):
    """A card that the host plays, with the bindings' own signatures."""
    made = Played()
    modules = {
        "nvmath.bindings.cudss": made,
        "cuda.bindings.runtime": made,
        "cuda.pathfinder": types.SimpleNamespace(
            load_nvidia_dynamic_lib=lambda name: types.SimpleNamespace(abs_path="/nowhere/lib.so")
        ),
    }
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    return made


@pytest.fixture(params=[pytest.param("card", marks=pytest.mark.needs("card")), "played"])
def card(request):
    """Return the played card; None where it is a real one."""
    return request.getfixturevalue("played") if request.param == "played" else None


@pytest.mark.parametrize("kind", [float, complex])
def test_new_values_on_a_kept_analysis(card, kind):
    n, made = 200, None
    B = np.random.default_rng(0).standard_normal((n, 3)).astype(kind)
    for shift, unit in ((0.0, 1.0), (0.3, 1e-18), (1.7, 1e12)):
        A = chain(n, shift, kind) * unit
        made = cudss.Cudss(A, real=kind is float) if made is None else made
        kept, solve = B.copy(), made.factor(A)
        truth = np.linalg.solve(A.toarray(), B)
        # The order of the columns, and how many there are, may change between solves.
        for columns in (slice(None), slice(0, 1), slice(0, 0)):
            for right in (B[:, columns], np.asfortranarray(B[:, columns])):
                assert solve(right) == pytest.approx(
                    truth[:, columns], rel=1e-9, abs=1e-11 * abs(truth).max()
                )
        assert np.array_equal(B, kept)
        assert solve.negative == (below(n, shift) if kind is float else None)
    made.release()


def test_units_do_not_decide_what_a_small_pivot_is(card):
    """Rotations beside translations: twelve decades on the diagonal."""
    n, size = 60, np.logspace(-3, 3, 60)
    A = sp.csc_array(sp.diags_array(size) @ chain(n, 0.3, complex, 0.01) @ sp.diags_array(size))
    solver, B = SparseSolver("cudss"), np.diag(size).astype(complex)
    X = solver.solve(A, B, 1.0)
    truth = np.linalg.solve(chain(n, 0.3, complex, 0.01).toarray(), np.eye(n))
    assert X * size[:, None] == pytest.approx(truth, abs=1e-11)
    assert solver.solve_counts == {"cudss": 1}


def test_a_perturbed_pivot_is_not_accepted(card):
    A = sp.csc_array(np.array([[1.0, -1.0, 0], [-1.0, 1.0, 0], [0, 0, 2.0]], dtype=complex))
    with pytest.raises(RuntimeError, match="perturbed 1 pivots"):
        cudss.Cudss(A).factor(A)


@pytest.mark.needs("card")
def test_memory_of_the_card_is_stated():
    A = sp.csc_array(np.ones((1500, 1500)) + 1500 * np.eye(1500))
    assert 0.5 < cudss.Cudss(A, real=True).peak_bytes / (8 * 1500**2) < 6


def test_all_is_given_back(played):
    A = chain(20, 0.3, complex)
    made = cudss.Cudss(A)
    assert made.peak_bytes == 7
    assert played.settings == {"PIVOT_EPSILON": 1e-13}
    for_the_session = len(played.alive)
    made.factor(A)(np.eye(20, 4))
    assert len(played.alive) == for_the_session
    made.release()
    made.release()
    assert not played.alive
    made = cudss.Cudss(A)
    del made
    assert not played.alive


def test_errors_have_the_types_of_the_protocol(played):
    A = chain(20, 0.3, complex)
    made = cudss.Cudss(A)
    played.fails_in = {played.Phase.FACTORIZATION: played.Status.ALLOC_FAILED}
    with pytest.raises(MemoryError, match="graphics card"):
        made.factor(A)
    made.release()
    played.fails_in = {played.Phase.ANALYSIS: played.Status.EXECUTION_FAILED}
    with pytest.raises(RuntimeError, match="cuDSS: EXECUTION_FAILED in phase ANALYSIS"):
        cudss.Cudss(A)
    assert not played.alive
    played.malloc_fails = True
    with pytest.raises(MemoryError, match="graphics card"):
        cudss.Cudss(A)
    assert not played.alive


@pytest.mark.parametrize(
    "lack",
    [{"cards": 0}, {"version": (1, 0)}, {"get_property": None}],
    ids=["no card", "another version", "no library"],
)
def test_where_something_is_missing_it_is_not_available(played, lack):
    assert cudss.Cudss.available()
    cudss._libraries.cache_clear()

    def missing(number):
        raise ImportError("libcudss.so.0: cannot open shared object file")

    for name, value in lack.items():
        setattr(played, name, value or missing)
    played.cards = lack.get("cards", 1)
    assert not cudss.Cudss.available()


def test_it_is_used_only_where_it_is_named():
    from updyn.linalg.solver import BACKENDS, check_backend

    assert list(BACKENDS).index("cudss") > list(BACKENDS).index("superlu")
    assert check_backend(None) != "cudss"
