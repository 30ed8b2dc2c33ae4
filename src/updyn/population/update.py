"""`update_population`: the unknowns of several structures of one design."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from updyn.arrays import RealArray
from updyn.dynamics.settings import REDUCTION
from updyn.engines import Engine, opened_engine
from updyn.errors import DataError, OptionError, StoppedError, UpdynWarning, suggest
from updyn.population.result import PopulationResult, Specimen
from updyn.population.scatter import estimate_scatter
from updyn.text_table import format_count
from updyn.uncertainty.posterior import Posterior
from updyn.uncertainty.progress import WorkCounter, WorkProgress
from updyn.uncertainty.restored import AT_MINIMUM
from updyn.updating.problem.data import Test, name_tests
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.result import UpdateResult
from updyn.updating.run import run
from updyn.updating.setup import RunOptions

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["update_population"]


def update_population(
    tests: Sequence[Test],
    parameters: ParameterSet,
    method: str = "maximum-likelihood",
    engine: int | Client | Engine | None = None,
    callback: Callable[[WorkProgress], bool | None] | None = None,
    *,
    title: str = "",
    tier: str | None = None,
    backend: str | None = None,
    accuracy: float = REDUCTION.accuracy,
    known: Mapping[str, UpdateResult] | None = None,
    **options: Any,
) -> PopulationResult:
    """Estimate mean and scatter of the unknowns over structures of one design.

    Each test is that of another specimen, or of one structure after it was taken apart and
    assembled again. The unknowns of each are fitted to its data; mean and covariance over specimens
    follow from the estimates and their errors, so that the noise of the tests does not count as
    scatter. Unknowns are normally distributed over specimens. For several tests of one specimen
    use `updyn.update_jointly`.

    Parameters
    ----------
    tests : sequence of Test
        At least two, with different names. Data may be FRFs, modes, or natural frequencies alone.
        Data may differ between specimens, such as by missing modes.
    parameters : ParameterSet
        The unknowns, the same for all specimens.
    method, engine
        As for `updyn.update`.
    callback : callable, optional
        Called with a `WorkProgress` after every specimen; returning True stops with a
        `StoppedError`.
    title, tier, backend, accuracy
        As for `updyn.update`.
    known : mapping of str to UpdateResult, optional
        Results of specimens by the name of their test. These are not fitted again, such as after a
        stop or if a specimen is added.
    **options
        As for `updyn.update`.

    Returns
    -------
    PopulationResult

    Raises
    ------
    InputError
        If models, data, unknowns or options do not fit together.
    DataError
        If the specimens together do not determine an unknown, or fewer than two updates ended at a
        minimum.
    SolverError
        If a model cannot be solved at its start, at one of the lines.
    StoppedError
        If the callback stops the run. Its message names the specimens that are done.

    Warns
    -----
    UpdynWarning
        If the update of a specimen did not end at a minimum; the specimen is not used.

    Notes
    -----
    Restricted maximum likelihood for estimates with known errors (Jackson, White & Thompson, Stat.
    Med. 29 (2010) 1282). If there are not more specimens than unknowns, correlations are not
    estimated. If modes do not determine an unknown of a specimen alone, they count as not
    determining it; FRFs count by the combinations that they determine.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, unknowns = chain.build(), {"stiffness": "part1"}
    >>> factors = {"a": 0.9, "b": 1.0, "c": 1.15, "d": 1.05}
    >>> tests = []
    >>> for name, factor in factors.items():
    ...     specimen = model.scaled({"part1": {"stiffness": factor}})
    ...     found = updyn.modes(specimen, 3)
    ...     data = updyn.ModeSet(found.frequency, std_frequency=1e-4 * found.frequency)
    ...     tests.append(updyn.Test(model, data, name))
    >>> population = updyn.update_population(tests, updyn.parameters(model, **unknowns))
    >>> round(population.mean["part1.stiffness"], 3), round(population.std["part1.stiffness"], 3)
    (1.025, 0.104)
    """
    named = name_tests(tests, "update_population", "specimen", least=2)
    done = _check_known(known or {}, named, parameters)
    counter = WorkCounter("population", len(named), callback)
    with opened_engine(engine) as opened:
        run_options = RunOptions(
            method,
            options,
            engine=opened,
            tier=tier,
            backend=backend,
            accuracy=accuracy,
        )
        for name, test in named.items():
            if name not in done:
                (done[name],) = run([test], parameters, replace(run_options, title=name))
            if counter.step(name):
                raise StoppedError(f"stopped by the callback after {', '.join(done)}")
    return _combine(parameters, {name: done[name] for name in named}, title)


def _check_known(
    known: Mapping[str, UpdateResult], named: Mapping[str, Test], parameters: ParameterSet
) -> dict[str, UpdateResult]:
    """Return the known results; OptionError for other names or other unknowns."""
    for name, result in known.items():
        if name not in named:
            raise OptionError(f"known: no test {name!r}; {suggest(name, named)}")
        if result.parameters.names != parameters.names:
            raise OptionError(f"known: the result of {name!r} has other unknowns")
    return dict(known)


def _combine(
    parameters: ParameterSet, results: Mapping[str, UpdateResult], title: str
) -> PopulationResult:
    """Return the population of updated specimens."""
    excluded = {
        name: f"ended as {result.status!r}: {result.message}"
        for name, result in results.items()
        if result.status not in AT_MINIMUM
    }
    results = {name: result for name, result in results.items() if name not in excluded}
    for name, reason in excluded.items():
        warnings.warn(f"{name} is not used: its update {reason}", UpdynWarning, stacklevel=3)
    if len(results) < 2:
        raise DataError(
            f"{format_count(len(results), 'specimen')} with an update that ended at a minimum;"
            " expected at least 2"
        )
    x = np.array(
        [[result.values[name] for name in parameters.names] for result in results.values()]
    )
    information = np.array([_find_information(result) for result in results.values()])
    _check_determined(parameters, information)
    correlated = len(x) > x.shape[1]
    found = estimate_scatter(x, information, is_full=correlated)

    def by_name(values: RealArray) -> dict[str, float]:
        return dict(zip(parameters.names, values.tolist(), strict=True))

    specimens = {}
    rows = zip(results.items(), found.values, found.value_covariance, strict=True)
    for (name, result), values, covariance in rows:
        specimens[name] = Specimen(
            result,
            by_name(values),
            by_name(np.sqrt(np.diag(covariance))),
            by_name(values - found.mean),
            covariance,
        )
    return PopulationResult(
        parameters,
        by_name(found.mean),
        found.mean_covariance,
        found.covariance,
        correlated,
        specimens,
        excluded,
        found.p_value,
        title,
    )


def _find_information(result: UpdateResult) -> RealArray:
    """Return the inverse covariance of an estimate; combinations not determined have none."""
    covariance = Posterior.of(result).covariance
    size = np.sqrt(np.diag(covariance))
    size[size == 0.0] = 1.0  # without information
    values, vectors = np.linalg.eigh(covariance / size / size[:, None])
    known = values > len(values) * np.finfo(float).eps * values[-1]
    vectors = vectors[:, known] / size[:, None]
    return np.asarray((vectors / values[known]) @ vectors.T)


def _check_determined(parameters: ParameterSet, information: RealArray) -> None:
    """Raise DataError if the specimens together do not determine every unknown."""
    total = information.sum(axis=0)
    size = np.sqrt(np.diag(total))
    open_names = [name for name, one in zip(parameters.names, size, strict=True) if one == 0.0]
    if not open_names:
        values, vectors = np.linalg.eigh(total / size / size[:, None])
        if values[0] > len(total) * np.finfo(float).eps:
            return
        involved = np.abs(vectors[:, 0]) > np.abs(vectors[:, 0]).max() / 2
        open_names = [name for name, one in zip(parameters.names, involved, strict=True) if one]
    raise DataError(
        f"the specimens together do not determine {', '.join(open_names)}; fix or link unknowns, or"
        " measure more"
    )
