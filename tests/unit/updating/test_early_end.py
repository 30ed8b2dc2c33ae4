"""A fit that ends after few steps, or that the caller stops, has a status, for each method and kind of data."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import updyn
from updyn.updating.fit.methods import METHODS, methods_with
from updyn.updating.result import STATUSES

#: Stiffnesses in N/m and masses in kg of a chain of four, fixed at one end.
STIFFNESS, MASS = (3e4, 2.5e4, 2e4, 2.2e4), (1.0, 1.1, 0.9, 1.0)
N = len(MASS)
DOFS = [f"{i + 1}:X" for i in range(N)]


def chain(*, held: bool = False) -> updyn.Model:
    """The chain; with `held`, a further spring at its end."""
    groups = {"mass": updyn.Group(mass=np.diag(MASS))}
    for i, stiffness in enumerate(STIFFNESS):
        link = np.zeros(N)
        link[i] = 1.0
        if i:
            link[i - 1] = -1.0
        groups[f"part{i}"] = updyn.Group(stiffness * np.outer(link, link), loss_factor=0.06)
    if held:
        end = np.zeros((N, N))
        end[-1, -1] = 1e4
        groups["held"] = updyn.Group(end)
    return updyn.Model.from_groups(groups, DOFS)


def truth(model: updyn.Model) -> updyn.Model:
    return model.scaled({f"part{i}": {"stiffness": 1.0 + 0.3 * (-1) ** i} for i in range(N)})


def measured_frf(model: updyn.Model, **more: Any) -> updyn.FRF:
    exact = updyn.response(truth(model), np.linspace(5.0, 50.0, 80), DOFS, DOFS[:1])
    noise = np.random.default_rng(0).standard_normal((2, *exact.values.shape))
    return updyn.FRF(
        exact.freq,
        exact.values * (1.0 + 0.02 * (noise[0] + 1j * noise[1])),
        exact.responses,
        exact.references,
        exact.quantity,
        **more,
    )


def measured_modes(model: updyn.Model, *, shapes: bool = True, std: bool = True) -> updyn.ModeSet:
    found = updyn.modes(truth(model), 3)
    frequency = found.frequency * (1.0 + 0.003 * np.array([1, -1, 1]))
    known = {"std_frequency": 0.001 * frequency} if std else {}
    if shapes:
        return updyn.ModeSet(frequency, found.shapes, DOFS, **known)
    return updyn.ModeSet(frequency, np.ones((1, 3)), DOFS[-1:], **known)


def of_frf() -> list[updyn.Test]:
    return [updyn.Test(chain(), measured_frf(chain()))]


def of_frf_with_variance() -> list[updyn.Test]:
    frf = measured_frf(chain())
    known = updyn.FRF(
        frf.freq,
        frf.values,
        frf.responses,
        frf.references,
        frf.quantity,
        variance=(0.02 * np.abs(frf.values)) ** 2,
    )
    return [updyn.Test(chain(), known)]


def of_modes() -> list[updyn.Test]:
    return [updyn.Test(chain(), measured_modes(chain()))]


def of_frequencies() -> list[updyn.Test]:
    return [updyn.Test(chain(), measured_modes(chain(), shapes=False))]


def of_modes_without_deviation() -> list[updyn.Test]:
    return [updyn.Test(chain(), measured_modes(chain(), std=False))]


def of_two_frfs() -> list[updyn.Test]:
    held = chain(held=True)
    return [*of_frf(), updyn.Test(held, measured_frf(held))]


def of_frf_and_modes() -> list[updyn.Test]:
    held = chain(held=True)
    return [*of_frf(), updyn.Test(held, measured_modes(held))]


def of_two_sets_of_modes() -> list[updyn.Test]:
    held = chain(held=True)
    return [*of_modes(), updyn.Test(held, measured_modes(held, shapes=False))]


FRFS = (of_frf, of_frf_with_variance, of_two_frfs)
MODES = (
    of_modes,
    of_frequencies,
    of_modes_without_deviation,
    of_frf_and_modes,
    of_two_sets_of_modes,
)
CASES = [(method, data) for method in METHODS for data in FRFS] + [
    (method, data) for method in methods_with("fits_modes") for data in MODES
]
each_case = pytest.mark.parametrize(
    ("method", "data"), CASES, ids=[f"{method}-{data.__name__}" for method, data in CASES]
)


def fitted(method: str, tests: list[updyn.Test], **options: Any) -> Any:
    """Return the result; of one test, that of `updyn.update`."""
    parts = [f"part{i}" for i in range(N)]
    unknowns = updyn.parameters(tests[0].model, stiffness=parts)
    if len(tests) > 1:
        return updyn.update_jointly(tests, unknowns, method, **options)
    return updyn.update(tests[0].model, tests[0].data, unknowns, method, **options)


def check(found: Any, method: str) -> None:
    """Check that a result can be read, printed and judged."""
    assert found.status in STATUSES
    assert all(np.isfinite(value) for value in found.values.values())
    text = found.summary()
    assert found.status in text
    for one in getattr(found, "results", {"": found}).values():
        assert one.method == method
        assert one.message
        updyn.modal_table(one)


@each_case
def test_one_step(method: str, data: Any, request: pytest.FixtureRequest) -> None:
    if method != "maximum-likelihood":  # causes are sought in the same way after each method
        request.getfixturevalue("no_causes")
    found = fitted(method, data(), max_iterations=1)
    check(found, method)
    assert found.status != "stopped"


@each_case
@pytest.mark.parametrize("after", [1, 4])
def test_stopped(method: str, data: Any, after: int) -> None:
    shown = []

    def stop(progress: Any) -> bool:
        shown.append(progress)
        return len(shown) >= after

    found = fitted(method, data(), callback=stop)
    check(found, method)
    assert found.status == "stopped" or len(shown) < after


def test_modes_that_have_not_settled_have_no_adequacy() -> None:
    """The adequacy is a test of the residual of FRFs."""
    found = fitted("maximum-likelihood", of_frequencies(), starts=0, max_iterations=3)
    assert found.status == "max-iterations"
    assert found.adequacy is None
