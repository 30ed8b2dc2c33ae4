"""The response by one decomposition against that of the model itself, line by line."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

import updyn
from updyn.control.ports import as_ports
from updyn.control.space import ModalProjection, projection
from updyn.control.spectrum import SpectralDecomposition
from updyn.control.structure import CompiledStructure
from updyn.dynamics.affine import AffineSystem

LINES = np.linspace(0.5, 60.0, 400)
BAND = (0.5, 60.0)
N = 8


def row(
    *,
    held: float = 0.0,
    drag: float = 0.0,
    dampers: bool = False,
    massless: bool = False,
    table: bool = False,
) -> updyn.Model:
    """Masses in a row, every second spring lossy."""
    mass = np.full(N, 2.0)
    if massless:
        mass[3] = 0.0
    parts = {"hard": np.zeros((N, N)), "soft": np.zeros((N, N))}
    for i in range(N - 1):
        part = parts["soft" if i % 2 else "hard"]
        part[i : i + 2, i : i + 2] += 4e4 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    end = np.zeros((N, N))
    end[0, 0] = 1.0
    groups = {
        "masses": updyn.Group(mass=np.diag(mass)),
        "hard": updyn.Group(parts["hard"], loss_factor=0.01),
        "soft": updyn.Group(
            0.5 * parts["soft"],
            loss_factor=0.3,
            loss_table=[[0.1, 20.0, 100.0], [0.5, 1.0, 1.5]] if table else None,
            viscous=1e-3 * parts["soft"] if dampers else None,
        ),
    }
    if held or drag:
        groups["end"] = updyn.Group(held * end if held else None, viscous=drag * end)
    return updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(N)])


def projected(model: updyn.Model) -> tuple[ModalProjection, AffineSystem]:
    structure = CompiledStructure.of(model)
    ports = as_ports(["1:X", "5:X"], "input"), as_ports(["1:X", "4:X", "8:X"], "output")
    return projection(structure, *ports, BAND), structure.system


@pytest.mark.parametrize(
    ("options", "decomposed"),
    [
        ({}, True),
        ({"held": 2e4}, True),
        ({"drag": 30.0}, True),
        ({"held": 2e4, "drag": 30.0, "massless": True}, True),
        ({"dampers": True}, False),
        ({"table": True}, False),
    ],
)
def test_it_is_that_of_the_model(options: dict[str, float], decomposed: bool) -> None:
    model = row(**options)
    found, system = projected(model)
    spectrum = SpectralDecomposition.of(found, system.start)
    assert (spectrum.modes is not None) == decomposed
    exact = updyn.response(model, LINES, ["1:X", "4:X", "8:X"], ["1:X", "5:X"]).values
    np.testing.assert_allclose(spectrum.receptance(LINES), exact, rtol=1e-7)
    np.testing.assert_allclose(spectrum.solve_lines(LINES), exact, rtol=1e-9)


def test_it_is_that_of_another_state() -> None:
    model = row(held=2e4)
    found, system = projected(model)
    changed = model.scaled({"hard": {"stiffness": 1.3, "loss_factor": 0.05}})
    state = AffineSystem.compile(changed).start
    factor = system.start.factor.copy()
    factor[system.find("hard", "stiffness")] = 1.3
    state = type(state)(factor, state.loss, state.rate)
    exact = updyn.response(changed, LINES, ["1:X", "4:X", "8:X"], ["1:X", "5:X"]).values
    np.testing.assert_allclose(
        SpectralDecomposition.of(found, state).receptance(LINES), exact, rtol=1e-7
    )


@pytest.mark.parametrize(("drag", "rtol"), [(0.0, 1e-9), (3.0, 2e-3)])
def test_poles_are_those_of_the_quadratic_pencil(drag: float, rtol: float) -> None:
    """Viscous damping is there to the first order: of light damping the poles are nearly exact."""
    model = row(held=2e4, drag=drag)
    found, system = projected(model)
    poles = SpectralDecomposition.of(found, system.start).poles
    K, M, C, D = (
        x.toarray() for x in (model.stiffness, model.mass, model.viscous, model.structural)
    )
    zero, eye = np.zeros((N, N)), np.eye(N)
    first = np.block([[zero, eye], [-np.linalg.solve(M, K + 1j * D), -np.linalg.solve(M, C)]])
    exact = scipy.linalg.eigvals(first)
    exact = exact[np.argsort(-exact.imag)[:N]]
    np.testing.assert_allclose(np.sort_complex(1j * poles), np.sort_complex(1j * exact), rtol=rtol)
