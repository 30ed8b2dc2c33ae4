"""Transmissibilities against partitioned dense solutions, their derivatives, and refusals."""

from types import SimpleNamespace

import numpy as np
import pytest

import updyn
from updyn.dynamics.excitation import DrivenSolver, Excitation
from updyn.errors import DataError, DofError, OptionError, SolverError
from updyn.updating.problem.problem import FRFPart

N = 12
ALL = [f"{i}:Z" for i in range(N)]
FREQ = np.concatenate([[0.0, 1e-4, 1e-2], np.linspace(0.3, 60.0, 120)])
ONE = (["0:Z"], {0: 1.0})
SEVERAL = (["5:-Z", "0:Z", "9:Z"], {5: -1.0, 0: 1.0, 9: 1.0})


def spring(i, j, k):
    K = np.zeros((N, N))
    K[i, i] = K[j, j] = k
    K[i, j] = K[j, i] = -k
    return K


@pytest.fixture(scope="module")
def model():
    """A free chain with a full mass matrix, structural and viscous damping, and one more spring."""
    rng = np.random.default_rng(0)
    groups = {}
    for i in range(N - 1):
        K = spring(i, i + 1, 2e4 * (1 + rng.random()))
        groups[f"s{i + 1}"] = updyn.Group(K, loss_factor=0.02, viscous=1e-5 * K)
    groups["tie"] = updyn.Group(spring(1, 7, 3e4), loss_factor=0.05)
    A = rng.standard_normal((N, N))
    groups["mass"] = updyn.Group(mass=A @ A.T / N + np.eye(N))
    return updyn.Model.from_groups(groups, ALL)


def dynamic_stiffness(model, freq):
    K, M, C, D = (
        A.toarray() for A in (model.stiffness, model.mass, model.viscous, model.structural)
    )
    w = 2 * np.pi * freq
    return K + 1j * D + 1j * w * C - w**2 * M


def partitioned(model, freq, motion):
    """Return -Z_ff^-1 Z_fb d, with the motion of the base, (n_f, N)."""
    b, d = list(motion), np.array(list(motion.values()))
    f = np.setdiff1d(np.arange(N), b)
    out = np.zeros((len(freq), N), dtype=complex)
    out[:, b] = d
    for u, line in zip(out, freq, strict=True):
        Z = dynamic_stiffness(model, line)
        u[f] = -np.linalg.solve(Z[np.ix_(f, f)], Z[np.ix_(f, b)] @ d)
    return out


@pytest.mark.parametrize("tier", ["dense", "sparse", "reduced"])
@pytest.mark.parametrize(("base", "motion"), [ONE, SEVERAL])
def test_equals_the_partitioned_solution(model, base, motion, tier):
    """To 1e-12 of the largest value of a line, at 0 Hz and far below the lowest mode, too."""
    options = {"accuracy": 1e-8} if tier == "reduced" else {}
    T = updyn.response(
        model, FREQ, ALL, ["0:Z"], "transmissibility", base=base, tier=tier, **options
    )
    exact = partitioned(model, FREQ, motion)
    level = np.abs(exact).max(axis=1, keepdims=True)
    assert (np.abs(T.values[:, :, 0] - exact) / level).max() < 1e-12
    assert T.values[0, 3, 0] == pytest.approx(exact[0, 3], rel=1e-12)


def test_sign_of_reference_and_base(model):
    """A reversed reference reverses the result; a common sign of the base does not."""
    T = updyn.response(model, FREQ, ["3:Z"], ["0:Z"], "transmissibility", base=["0:Z", "5:Z"])
    one = updyn.response(model, FREQ, ["3:Z"], ["0:-Z"], "transmissibility", base=["0:Z", "5:Z"])
    two = updyn.response(model, FREQ, ["3:Z"], ["0:Z"], "transmissibility", base=["0:-Z", "5:-Z"])
    np.testing.assert_allclose(one.values, -T.values, rtol=1e-14)
    np.testing.assert_allclose(two.values, T.values, rtol=1e-14)


def test_single_oscillator():
    """T = (k + i omega c) / (k + i omega c - omega^2 m) (Rao, Mechanical Vibrations, section 3.6)."""
    k, c, m, freq = 4e3, 6.0, 2.5, np.array([0.0, 3.0, 6.3, 20.0])
    pair = np.array([[1.0, -1.0], [-1.0, 1.0]])
    group = updyn.Group(k * pair, np.diag([7.0, m]), viscous=c * pair)
    model = updyn.Model.from_groups({"it": group}, ["1:X", "2:X"])
    T = updyn.response(model, freq, ["2:X"], ["1:X"], "transmissibility", base=["1:X"])
    w = 2 * np.pi * freq
    expected = (k + 1j * w * c) / (k + 1j * w * c - w**2 * m)
    np.testing.assert_allclose(T.values[:, 0, 0], expected, rtol=1e-13)


def test_ratio_of_two_responses(model):
    """T_ij = H_ik / H_jk for a force at k."""
    freq = FREQ[FREQ > 0.1]
    T = updyn.response(model, freq, ["2:Z", "8:-Z"], ["4:Z"], "transmissibility", force="10:Z")
    H = np.array([np.linalg.solve(dynamic_stiffness(model, f), np.eye(N)[10]) for f in freq])
    expected = np.stack([H[:, 2], -H[:, 8]], axis=1) / H[:, [4]]
    np.testing.assert_allclose(T.values[:, :, 0], expected, rtol=1e-10)


EXCITATIONS = [
    {"base": ["0:Z"]},
    {"base": ["5:-Z", "0:Z", "9:Z"]},
    {"force": "10:Z"},
]


@pytest.mark.parametrize("tier", ["dense", "sparse"])
@pytest.mark.parametrize("excitation", EXCITATIONS)
def test_derivatives_equal_central_differences(model, excitation, tier):
    freq = np.array([0.5, 3.0, 11.0, 25.0])
    unknowns = updyn.parameters(
        model, stiffness="all", mass="all", loss_factor=["s1", "tie"], viscous=["s2"]
    )
    rows = ["1:Z", "6:Z", "11:Z", "0:Z"]
    data = updyn.response(model, freq, rows, ["0:Z"], "transmissibility", **excitation)
    part = FRFPart.build(model, data, unknowns, tier=tier)
    x = part.coordinates.start + 0.02 * np.arange(part.n) / part.n
    block = part.block(x, slice(0, 4))
    step = 1e-5
    for p in range(part.n):
        e = step * np.eye(part.n)[p]
        high, low = (part.block(x + sign * e, slice(0, 4), derivatives=False).H for sign in (1, -1))
        np.testing.assert_allclose(
            block.dH[p], (high - low) / (2 * step), rtol=2e-7, atol=2e-8 * np.abs(block.H).max()
        )


def test_labels_of_large_bases_differ():
    """Labels distinguish cached results; the text of a long array is shortened."""
    labels = set()
    for middle in (700, 701):
        moved = np.setdiff1d(np.arange(1400), middle)
        driven = Excitation(moved, np.ones(len(moved)), moved)
        labels.add(DrivenSolver(SimpleNamespace(label="sparse"), driven).label)
    assert len(labels) == 2


def test_undamped_resonance_of_the_held_structure_is_an_error():
    pair = np.array([[1.0, -1.0], [-1.0, 1.0]])
    group = updyn.Group((2 * np.pi * 4.0) ** 2 * pair, np.diag([0.0, 1.0]))
    model = updyn.Model.from_groups({"it": group}, ["1:X", "2:X"])
    with pytest.raises(SolverError, match="4 Hz"):
        updyn.response(model, [4.0], ["2:X"], ["1:X"], "transmissibility", base=["1:X"])


@pytest.mark.parametrize(
    ("options", "kind", "text"),
    [
        ({}, DataError, r"excitation is not stated.*base = \[\"0:Z\"\].*force = "),
        ({"base": ["40:Z"]}, DofError, "base: DOF 40:Z.*nearest.*fixes.*release it"),
        ({"base": ["1:Z"]}, DataError, "reference 0:Z .* is not among 1:Z"),
        ({"base": ["0:Z"], "force": "3:Z"}, DataError, "expected one of them"),
        ({"force": "40:Z"}, DofError, "force 40:Z"),
        ({"base": "0:Z"}, DataError, "expected a list"),
        ({"base": []}, DataError, "at least one DOF"),
    ],
)
def test_refusals(model, options, kind, text):
    with pytest.raises(kind, match=text):
        updyn.response(model, [1.0], ["2:Z"], ["0:Z"], "transmissibility", **options)


def test_refuses_several_references_and_other_quantities(model):
    with pytest.raises(DataError, match=r"2 references .0:Z, 5:Z.*another test"):
        updyn.response(
            model, [1.0], ["2:Z"], ["0:Z", "5:Z"], "transmissibility", base=["0:Z", "5:Z"]
        )
    with pytest.raises(DataError, match="base: only for the quantity 'transmissibility'"):
        updyn.response(model, [1.0], ["2:Z"], ["0:Z"], "accelerance", base=["0:Z"])
    T = updyn.response(model, [1.0], ["2:Z"], ["0:Z"], "transmissibility", base=["0:Z"])
    with pytest.raises(DataError, match="cannot be converted to accelerance"):
        T.converted("accelerance")
    unknowns = updyn.parameters(model, stiffness="all")
    for method in ("equation-error", "force-residual", "constitutive", "rfm"):
        with pytest.raises(OptionError, match="needs measured forces"):
            updyn.update(model, T, unknowns, method=method)
