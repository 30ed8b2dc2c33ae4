"""The unknowns of a job: parameters of the model, and calibration factors of sensors."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from typing import Any

from updyn.errors import OptionError, key_path
from updyn.frf import FRF
from updyn.group import GROUP_QUANTITIES
from updyn.grouping import match_names
from updyn.job.configuration import add_all_masses
from updyn.job.schema import Job, ParameterTable
from updyn.model import Model
from updyn.nonlinear.parameters import list_parameters
from updyn.updating.fit.methods import METHODS, check_channels
from updyn.updating.problem.channels import calibration
from updyn.updating.problem.parameters import Parameter, ParameterSet, link, parameters

__all__ = ["choose_unknowns"]

_QUANTITY_ORDER = (
    "mass",
    "stiffness",
    "loss_factor",
    "viscous",
    "mass_damping",
    "stiffness_damping",
)


def choose_unknowns(job: Job, model: Model, data: Sequence[FRF]) -> ParameterSet:
    """Return the unknowns of a job: by group, then linked ones, then calibration factors.

    `model` has no masses or supports of the tests; `data` have the DOF labels of the model.
    """
    return _add_calibration(job, _choose_model_unknowns(job, model), data)


def _choose_model_unknowns(job: Job, model: Model) -> ParameterSet:
    """Return the unknowns of the model by group, then those that drive several quantities."""
    chosen: dict[str, tuple[int, Parameter]] = {}
    loaded = add_all_masses(job, model)
    for number, table in enumerate(job.parameter):
        # Masses added by a test are known; they are unknowns only if a table names them, not by
        # "all" and "*".
        without_masses = _matches_groups(model, table.groups or ()) and _matches_groups(
            model, table.drives or (), GROUP_QUANTITIES
        )
        with key_path("parameter", number):
            items = _choose_from_table(job, model if without_masses else loaded, table)
        for p in items:
            if p.name in chosen:
                first = job.place("parameter", chosen[p.name][0])
                text = f"{p.name} is already an unknown of the [[parameter]] on line {first}"
                raise OptionError(text, key=("parameter", number))
            chosen[p.name] = (number, p)
    groups, elements = list(loaded.groups), list(loaded.nonlinear)

    def position(entry: tuple[int, Parameter]) -> tuple[int, int]:
        number, p = entry
        if p.of_element:
            parameters_of_element = list_parameters(loaded.nonlinear[p.group].element)
            place = list(parameters_of_element).index(p.quantity)
            return len(groups) + elements.index(p.group), place
        if p.drives:  # after the others, in the order of the job
            return len(groups) + len(elements), number
        return groups.index(p.group), _QUANTITY_ORDER.index(p.quantity)

    ordered = sorted(chosen.values(), key=position)
    with key_path("parameter"):
        return ParameterSet(tuple(p for _, p in ordered))


def _add_calibration(job: Job, chosen: ParameterSet, data: Sequence[FRF]) -> ParameterSet:
    items = list(chosen)
    first: dict[str, int] = {}
    for number, table in enumerate(job.calibration):
        with key_path("calibration", number):
            found = calibration(
                data,
                responses=table.responses,
                references=table.references,
                prior_std=table.prior_std,
                bounds=table.bounds,
                name=table.name,
            )
        for p in found:
            if first.setdefault(p.name, number) != number:
                line = job.place("calibration", first[p.name])
                text = f"{p.name} is already an unknown of the [[calibration]] on line {line}"
                raise OptionError(text, key=("calibration", number))
        items += found
    whole = ParameterSet(tuple(items))
    with key_path("method", "name"):
        check_channels(whole, METHODS.find(job.method.name))
    return whole


def _matches_groups(
    model: Model, patterns: Iterable[str], quantities: Collection[str] = ()
) -> bool:
    """Return whether each pattern but ``"all"`` matches a group of a model, or its quantity."""
    names = list(model.groups)
    if quantities:
        names = [f"{name}.{quantity}" for name in names for quantity in quantities]
    return all(pattern == "all" or match_names(names, pattern) for pattern in patterns)


def _find_sensor_mass(job: Job, group: str) -> float | None:
    """Return the nominal mass in kg of a sensor's group; None for other groups."""
    from updyn.elements.masses import sensor_group

    given = set()
    for part in job.parts:
        for key, mass in (part.test.sensor_masses or {}).items():
            if sensor_group(key) == group:
                given.add(mass)
    if len(given) > 1:
        masses = " and ".join(f"{mass:g}" for mass in sorted(given))
        raise OptionError(
            f"{group!r} weighs {masses} kg in different tests; one unknown cannot be both"
        )
    return given.pop() if given else None


def _choose_from_table(job: Job, model: Model, table: ParameterTable) -> Sequence[Parameter]:
    if table.name is not None and table.drives is not None:
        with key_path(otherwise=("drives",)):
            return link(
                model,
                table.name,
                table.drives,
                start=table.start,
                bounds=table.bounds,
                prior_std=table.prior_std,
                nominal=table.nominal,
                unit=table.unit,
            )
    assert table.quantity is not None
    if table.element is not None:
        return _choose_of_elements(model, table)
    assert table.groups is not None
    bounds = table.bounds
    groups = "all" if table.groups == ("all",) and "all" not in model.groups else table.groups
    chosen: dict[str, Any] = {table.quantity: groups}
    with key_path("groups"):
        items: Sequence[Parameter] = parameters(model, **chosen)
    if bounds is not None and table.start is None:
        # may move the start of a loss factor onto a bound
        items = parameters(model, **chosen, bounds={table.quantity: bounds})
    elif table.start is not None:
        changes: dict[str, Any] = {"start": table.start}
        if bounds is not None:
            changes |= {"lower": bounds[0], "upper": bounds[1]}
        items = [replace(p, **changes) for p in items]
    common: dict[str, Any] = {
        "prior_std": table.prior_std,
        "nominal": table.nominal,
        "unit": table.unit,
    }
    items = [replace(p, **common) for p in items]
    if table.quantity != "mass" or table.nominal is not None:
        return items
    weighed = []
    for p in items:
        mass = _find_sensor_mass(job, p.group)
        weighed.append(p if mass is None else replace(p, nominal=mass, unit="kg"))
    return weighed


def _choose_of_elements(model: Model, table: ParameterTable) -> Sequence[Parameter]:
    """Return the unknown parameters of nonlinear elements of one table."""
    names = [f"{element}.{table.quantity}" for element in table.element or ()]
    bounds = None if table.bounds is None else dict.fromkeys(names, table.bounds)
    with key_path("element"):
        items: Sequence[Parameter] = parameters(model, nonlinear=names, bounds=bounds)
    std, start = table.prior_std, table.start
    return [replace(p, prior_std=std, start=p.start if start is None else start) for p in items]
