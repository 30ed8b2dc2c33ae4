"""Residuals, methods and noise models that another package registers."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

import updyn
from updyn.errors import OptionError
from updyn.updating.fit.method import Fit, Method
from updyn.updating.fit.methods import METHODS, methods_with, options_of
from updyn.updating.problem.noise import NOISE_MODELS, NoiseModel
from updyn.updating.problem.residuals import RESIDUALS, LineResidual


@dataclass(frozen=True, slots=True)
class SquareRoot(LineResidual):
    """r = sqrt(H_A / H_X) - 1."""

    name: str = "square-root"
    reference: ClassVar[str] = "Test 2026"
    calibrates: ClassVar[bool] = True

    def block(self, part, x, lines):
        block = part.block(x, lines)
        root = np.sqrt(block.H / block.measured)
        return root - 1.0, 0.5 * root / block.H * block.dH


@dataclass(frozen=True, slots=True)
class StaysAtStart(Method):
    """Changes nothing."""

    max_iterations: int = 1
    tolerance: float = 0.0
    name: ClassVar[str] = "stays-at-start"
    cannot: ClassVar[tuple[str, ...]] = ("mass",)

    def fit(self, problem, noises, monitor, x):
        return Fit.without_jacobian(x, "converged")


@dataclass(frozen=True, slots=True)
class Constant(NoiseModel):
    """The same standard deviation everywhere."""

    kind: ClassVar[str] = "constant"

    def variance(self, H, frf):
        return np.full(H.shape, (1e-3 * np.abs(frf.values).max()) ** 2)


@pytest.fixture
def registered(monkeypatch):
    for registry in (METHODS, RESIDUALS, NOISE_MODELS):
        monkeypatch.setattr(registry, "_entries", dict(registry._entries))
    RESIDUALS.register("square-root", SquareRoot)
    METHODS.register("stays-at-start", StaysAtStart)
    NOISE_MODELS.register("constant", Constant)


@pytest.fixture
def case(chain12_true):
    true = chain12_true.scaled({"part3": {"stiffness": 1.02}})
    data = updyn.response(true, np.linspace(5.0, 60.0, 20), ["2:X", "12:X"], ["12:X"])
    return chain12_true, data, updyn.parameters(chain12_true, stiffness=["part2", "part3"])


@pytest.mark.usefixtures("registered")
def test_a_residual_is_minimised_by_the_method_of_its_name(case):
    result = updyn.update(*case, method="square-root")
    assert result.status == "converged"
    assert result.values["part3.stiffness"] == pytest.approx(1.02, rel=1e-8)
    assert result.values["part2.stiffness"] == pytest.approx(1.0, rel=1e-8)
    assert {h.stage for h in result.history} == {"square-root"}
    assert "square-root" in METHODS
    assert list(METHODS)[-1] == "square-root"
    assert options_of("square-root") == {"max_iterations": 100, "tolerance": 1e-10}
    assert METHODS["square-root"].reference == "Test 2026"
    assert "square-root" in methods_with("calibrates")


@pytest.mark.usefixtures("registered")
def test_a_method_and_a_noise_model_are_found_by_name(case):
    model, data, _ = case
    result = updyn.update(*case, method="stays-at-start", noise="constant")
    assert result.values["part3.stiffness"] == 1.0
    found = updyn.update(*case, noise="constant", starts=0)
    assert found.noise["kind"] == "constant"
    assert found.values["part3.stiffness"] == pytest.approx(1.02, rel=1e-6)
    rows = updyn.compare(
        model, data, updyn.parameters(model, mass="all"), ["log", "stays-at-start"]
    )
    assert "cannot update mass" in rows["stays-at-start"].message


def test_what_is_not_registered_is_refused(case):
    with pytest.raises(OptionError, match="square-root"):
        updyn.update(*case, method="square-root")


@pytest.mark.parametrize("name", list(METHODS))
def test_a_method_states_its_name_and_source(name):
    assert METHODS[name].name == name
    assert METHODS[name].reference
