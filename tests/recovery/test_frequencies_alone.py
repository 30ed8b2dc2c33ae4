"""Updates to natural frequencies alone, and to shapes that the model cannot reproduce."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from scipy.optimize import least_squares

import updyn
from updyn.job import load_job, run_job
from updyn.modal import ModeSet
from updyn.model import Group, Model


def chain(n: int, factors: np.ndarray | None = None) -> Model:
    """Equal masses on springs, held at one end; each spring is a group, the masses are one."""
    groups = {}
    for i in range(n):
        v = np.zeros(n)
        v[i] = 1.0
        if i:
            v[i - 1] = -1.0
        scale = 1.0 if factors is None else factors[i]
        groups[f"spring {i + 1}"] = Group(2e4 * scale * np.outer(v, v))
    groups["masses"] = Group(mass=np.eye(n))
    return Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])


def frequencies(factors: np.ndarray) -> np.ndarray:
    """Natural frequencies in Hz by SciPy alone."""
    n = len(factors)
    K = np.zeros((n, n))
    for i, k in enumerate(2e4 * factors):
        K[i, i] += k
        if i:
            K[i - 1, i - 1] += k
            K[i, i - 1] -= k
            K[i - 1, i] -= k
    return np.sqrt(np.maximum(np.linalg.eigvalsh(K), 0.0)) / (2 * np.pi)


@cache
def isospectral(measured: tuple[float, ...]) -> list[np.ndarray]:
    """All stiffness factors of a chain that have a spectrum, by 400 fits with SciPy."""
    rng, found = np.random.default_rng(0), list[np.ndarray]()
    for _ in range(400):
        fit = least_squares(
            lambda y: frequencies(np.exp(y)) / np.array(measured) - 1.0,
            rng.uniform(np.log(0.2), np.log(5.0), len(measured)),
            xtol=1e-14,
            ftol=1e-14,
            gtol=1e-14,
        )
        x = np.exp(fit.x)
        if fit.cost < 1e-18 and not any(np.allclose(x, other, rtol=1e-4) for other in found):
            found.append(x)
    return found


@pytest.mark.parametrize(
    "start", [(1.0, 1.0, 1.0, 1.0), (0.6, 1.4, 0.8, 1.3), (0.52, 0.59, 1.72, 2.07)]
)
def test_all_answers_that_frequencies_allow_are_reported(start: tuple[float, ...]) -> None:
    """Four springs and four frequencies: every chain of that spectrum, and none called the answer.

    From the last start, the first descent ends at a fold, where two answers would meet: its rms
    error is 1.7 %, and its Jacobian is singular.
    """
    measured = frequencies(np.array([0.871, 1.127, 1.016, 1.036]))
    known = isospectral(tuple(measured))
    assert len(known) == 4
    model = chain(4, np.array(start))
    unknowns = updyn.parameters(model, stiffness="spring*", bounds={"*": (0.1, 10.0)})
    modes = ModeSet(measured, std_frequency=1e-3 * measured)
    result = updyn.update(model, modes, unknowns)
    answers = [result.values, *(other.values for other in result.alternatives)]
    assert len(answers) == len(known)
    for factors in known:
        off = [np.abs(np.array(list(a.values())) * start / factors - 1.0).max() for a in answers]
        assert min(off) < 0.02
    assert result.status == "not-identifiable"
    assert "4 answers" in result.trust["determined"].why


def test_shapes_that_are_stated_to_say_nothing_determine_nothing() -> None:
    """Nor do they pair modes: their errors are as large as they are."""
    model = chain(4)
    measured = updyn.modes(model, 4)
    modes = ModeSet(
        measured.frequency, measured.shapes.real, model.dofs, std_frequency=np.full(4, 1e-3)
    )
    unknowns = updyn.parameters(model, stiffness="spring*", bounds={"*": (0.1, 10.0)})
    noise = {"frequency": 1e-3, "shape": 1.0}
    result = updyn.update(model, modes, unknowns, noise=noise)
    assert result.trust is not None
    assert result.trust["determined"].holds is False
    assert 1 + len(result.alternatives) == len(isospectral(tuple(measured.frequency)))


def test_frequencies_are_paired_in_their_order() -> None:
    """The model is a third too soft, so that each of its frequencies is nearest to another's."""
    true = np.array([1.5, 1.5, 1.5, 1.5, 1.5, 1.5])
    model = chain(6)
    springs = updyn.link(
        model, "springs.stiffness", {f"spring {i + 1}.stiffness": 1.0 for i in range(6)}
    )
    modes = ModeSet(frequencies(true), std_frequency=1e-4 * frequencies(true))
    result = updyn.update(model, modes, springs)
    assert result.status == "converged"
    assert result.values["springs.stiffness"] == pytest.approx(1.5, rel=1e-6)
    # df / f = dk / 2 k, of six independent frequencies.
    assert result.std["springs.stiffness"] == pytest.approx(1.5 * 2e-4 / np.sqrt(6.0), rel=1e-3)


def test_loss_factors_without_shapes() -> None:
    model = chain(4)
    damped = Model.from_groups(
        {
            name: Group(
                group.stiffness,
                group.mass,
                loss_factor=0.02 if group.stiffness is not None else 0.0,
            )
            for name, group in model.groups.items()
        },
        model.dofs,
    )
    loss = updyn.link(
        damped, "springs.loss", {f"spring {i + 1}.loss_factor": 1.0 for i in range(4)}
    )
    measured = frequencies(np.ones(4))
    modes = ModeSet(measured, loss_factor=np.full(4, 0.05), std_frequency=1e-3 * measured)
    result = updyn.update(damped, modes, loss)
    assert result.values["springs.loss"] == pytest.approx(0.05, rel=1e-3)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_shapes_that_the_model_cannot_reproduce_loosen_no_frequency(seed: int) -> None:
    """The shapes of the test hold 30 % of other modes, its frequencies are those of the model."""
    rng = np.random.default_rng(seed)
    true = np.exp(rng.uniform(-0.3, 0.3, 12))
    start, exact = chain(12), chain(12, true)
    value, phi = scipy.linalg.eigh(exact.stiffness.toarray(), exact.mass.toarray())
    mixed = phi[:, :5] + phi @ (0.3 * rng.standard_normal((12, 5)) / np.sqrt(12.0))
    modes = ModeSet(np.sqrt(value[:5]) / (2 * np.pi), mixed, exact.dofs)
    unknowns = updyn.parameters(start, stiffness="spring*", bounds={"*": (0.2, 5.0)})
    result = updyn.update(start, modes, unknowns, starts=0)
    before, after = (updyn.correlate(model, modes) for model in (start, result.model))
    assert np.abs(after.frequency_change).max() < 0.5
    assert after.pairs.mac.min() > before.pairs.mac.min() - 0.05


#: The modes of the table that are data: as often in published updates, not all that were found.
USED = [1, 2, 3, 4, 5, 6, 7, 8, 10, 11, 12, 14, 16, 18]
PIECES = np.array([1.2, 0.8, 1.1, 0.9, 1.3, 0.85])


@pytest.fixture(scope="module")
def tested(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a model of 22 springs in six pieces, and a table of its tests.

    Each test is of another assembly, whose frequencies differ by 0.3 %. Ten found no mode, the
    others most of 18.
    """
    folder, rng = tmp_path_factory.mktemp("tests"), np.random.default_rng(0)
    single = chain(22)
    pieces = {
        f"piece {p + 1}": Group(
            sum(single.group(f"spring {i + 1}").stiffness for i in range(22) if i * 6 // 22 == p)
        )
        for p in range(6)
    }
    model = Model.from_groups({**pieces, "masses": single.group("masses")}, single.dofs)
    updyn.write_model(model, folder / "model.npz")
    true = frequencies(PIECES[np.arange(22) * 6 // 22])[:18]
    found = true * (1.0 + 3e-3 * rng.standard_normal((40, 18)))
    found[rng.random(found.shape) < 0.1] = np.nan
    lines = [
        "# 50 tests (reassembled each time) x 18 natural frequencies, Hz; nan = not identified"
    ]
    lines += [",".join(["nan"] * 18)] * 10
    lines += [",".join(f"{value:.5f}" for value in row) for row in found]
    (folder / "tests.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def test_a_table_of_tests_is_read_and_fitted_in_three_lines(tested: Path) -> None:
    model = updyn.read_model(tested / "model.npz")
    modes = updyn.read_modes(tested / "tests.csv", modes=USED)
    result = updyn.update(model, modes, updyn.parameters(model, stiffness="piece*"), starts=0)
    assert result.status == "converged"
    table = np.genfromtxt(tested / "tests.csv", delimiter=",")[:, np.array(USED) - 1]
    count = np.isfinite(table).sum(axis=0)
    assert modes.frequency == pytest.approx(np.nanmean(table, axis=0), rel=1e-12)
    of_mean = np.nanstd(table, axis=0, ddof=1) / np.sqrt(count)
    assert modes.std_frequency == pytest.approx(of_mean, rel=1e-9)
    off = np.array(list(result.values.values())) - PIECES
    assert (np.abs(off) < 4.0 * np.array(list(result.std.values()))).all()
    assert np.abs(off / PIECES).max() < 0.02


def test_a_table_of_tests_is_fitted_by_a_job(tested: Path) -> None:
    (tested / "job.toml").write_text(
        f"""
[model]
file = "model.npz"
[test]
modes = "tests.csv"
modes_reader = {{ modes = {USED} }}
[[parameter]]
groups = ["piece*"]
quantity = "stiffness"
[method]
starts = 0
[output]
report = false
""",
        encoding="utf-8",
    )
    result = run_job(load_job(tested / "job.toml"), tested / "out").result
    assert isinstance(result, updyn.UpdateResult)
    assert result.status == "converged"
    assert list(result.values.values()) == pytest.approx(PIECES.tolist(), rel=0.02)


def test_report_and_record(tmp_path: Path) -> None:
    model = chain(4)
    measured = frequencies(np.array([1.2, 0.9, 1.1, 0.8]))
    modes = ModeSet(measured, std_frequency=1e-3 * measured)
    result = updyn.update(model, modes, updyn.parameters(model, stiffness="spring*"), starts=0)
    updyn.write_result(result, tmp_path / "run.nc")
    again = updyn.read_result(tmp_path / "run.nc")
    assert again.data.digest == modes.digest
    assert not again.data.has_shapes
    updyn.write_report(again, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "4 natural frequencies" in page
    assert "paired in the order of their frequencies" in page
    assert "COMAC by sensor" not in page
    table = updyn.modal_table(result)
    assert [row.updated.mac for row in table.rows if row.updated] == pytest.approx(
        [np.nan] * 4, nan_ok=True
    )
