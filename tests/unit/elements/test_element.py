"""A kind of element from outside the package: one class and one registration."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

import updyn
from updyn.elements.structure import (
    ELEMENTS,
    Element,
    ElementMatrices,
    PointMass,
    structure,
    structure_from_table,
)
from updyn.errors import ModelError
from updyn.job import load_job, prepare


@dataclass(frozen=True)
class Cable(Element):
    """A taut string without bending stiffness, in the XZ plane: T / L across, rho A L / 2 at its ends."""

    name: str
    connectivity: list[list[int]]
    tension: float
    mass_per_length: float
    loss_factor: float = 0.0

    directions: ClassVar[tuple[int, ...]] = (2,)

    def matrices(self, numbers: np.ndarray, xyz: np.ndarray) -> ElementMatrices:
        length = np.linalg.norm(xyz[:, 1] - xyz[:, 0], axis=1)[:, None, None]
        K = self.tension / length * np.array([[1.0, -1.0], [-1.0, 1.0]])
        M = 0.5 * self.mass_per_length * length * np.eye(2)
        return ElementMatrices(K, M)

    def edges(self) -> np.ndarray:
        return np.array(self.connectivity)


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ELEMENTS, "_entries", dict(ELEMENTS._entries))
    ELEMENTS.register("cable", Cable)


N = 40
NODES = {i: [0.05 * (i - 1), 0.0, 0.0] for i in range(1, N + 2)}  # 2 m
PAIRS = [[i, i + 1] for i in range(1, N + 1)]


def test_a_structure_takes_it() -> None:
    cable = Cable("cable", PAIRS, 1000.0, 0.1, loss_factor=0.01)
    model = structure(NODES, [cable], grounded=[1, N + 1])
    assert model.dofs.labels == [f"{i}:Z" for i in range(2, N + 1)]
    assert model.group("cable").loss_factor == 0.01
    assert model.geometry is not None
    assert len(model.geometry.lines) == N
    exact = np.sqrt(1000.0 / 0.1) / (2 * 2.0)  # of a string, Hz
    assert updyn.modes(model, 1).frequency[0] == pytest.approx(exact, rel=1e-3)


def test_a_wrong_shape_is_named() -> None:
    class Wrong(Cable):
        def matrices(self, numbers: np.ndarray, xyz: np.ndarray) -> ElementMatrices:
            return ElementMatrices(np.eye(6)[None])

    with pytest.raises(ModelError, match=r"wrong 'w': element matrices of shape \(1, 6, 6\)"):
        structure(NODES, [Wrong("w", PAIRS, 1.0, 1.0)])


@pytest.mark.usefixtures("registered")
def test_a_table_takes_its_rows() -> None:
    row = {"name": "cable", "connectivity": PAIRS, "tension": 1000.0, "mass_per_length": 0.1}
    load = {"name": "load", "node": 5, "mass": 2.0}
    nodes = {str(k): x for k, x in NODES.items()}
    found = structure_from_table({"nodes": nodes, "cable": [row], "mass": [load], "grounded": [1]})
    same = structure(NODES, [PointMass("load", 5, 2.0), Cable(**row)], grounded=[1])
    assert found.dofs == same.dofs
    assert abs(found.stiffness - same.stiffness).max() == 0.0
    with pytest.raises(ModelError, match=r"model.cable, number 1: no key 'tensio'"):
        structure_from_table({"nodes": nodes, "cable": [row | {"tensio": 1.0}]})


JOB = """
[model]
kind = "structure"
grounded = [1, 4]

[model.nodes]
1 = [0, 0, 0]
2 = [0.5, 0, 0]
3 = [1.0, 0, 0]
4 = [1.5, 0, 0]

[[model.cable]]
name = "cable"
connectivity = [[1, 2], [2, 3], [3, 4]]
tension = 1000.0
mass_per_length = 0.1
loss_factor = 0.01

[test]
file = "test.uff"

[[parameter]]
groups = ["cable"]
quantity = "stiffness"
"""


@pytest.mark.usefixtures("registered")
def test_a_job_takes_its_rows(tmp_path: Path) -> None:
    cable = Cable("cable", [[1, 2], [2, 3], [3, 4]], 1000.0, 0.1, 0.01)
    start = structure({i + 1: [0.5 * i, 0, 0] for i in range(4)}, [cable], grounded=[1, 4])
    truth = start.scaled({"cable": {"stiffness": 1.2}})
    frf = updyn.response(truth, np.linspace(5, 60, 56), ["2:Z", "3:Z"], ["3:Z"])
    updyn.write_frf(frf, tmp_path / "test.uff")
    (tmp_path / "job.toml").write_text(JOB, encoding="utf-8")
    prepared = prepare(load_job(tmp_path / "job.toml"))
    result = updyn.update(prepared.model, prepared.frf, prepared.parameters)
    assert result.values["cable.stiffness"] == pytest.approx(1.2, rel=1e-6)
