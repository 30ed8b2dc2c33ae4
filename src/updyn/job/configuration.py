"""The model of a job configured as in its tests: damping, added masses, fixed DOFs."""

from __future__ import annotations

from dataclasses import replace

from updyn.errors import OptionError, key_path, suggest
from updyn.grouping import match_names
from updyn.job.schema import DampingTable, Job
from updyn.model import Model
from updyn.nonlinear.records import build_element

__all__ = ["add_all_masses", "add_elements", "apply_damping", "configure_model"]


def apply_damping(job: Job, model: Model) -> Model:
    """Return the model with the damping of ``[[damping]]``; later tables take precedence."""
    for number, table in enumerate(job.damping):
        names = _find_damped_groups(model, number, table)
        chosen = {name: table.damping_values for name in model.groups if name in names}
        with key_path("damping", number):
            model = model.with_damping(chosen)
    return model


def add_elements(job: Job, model: Model) -> Model:
    """Return the model with the nonlinear elements of ``[[element]]``."""
    for number, table in enumerate(job.element):
        with key_path("element", number):
            element = build_element(table.kind, table.values)
            model = model.with_elements({table.name: (element, table.dofs)})
    return model


def _find_damped_groups(model: Model, number: int, table: DampingTable) -> set[str]:
    # A pattern selects the groups that have the quantities to damp. If it is the name of a group,
    # or none of its groups has them, all matches are returned, and the model reports the missing
    # quantity.
    needed = {"loss_factor" if name == "loss_table" else name for name in table.damping_values}
    names: set[str] = set()
    for pattern in table.groups:
        fits = set(model.groups)
        if pattern != "all":
            fits = set(match_names(model.groups, pattern))
        if not fits:
            text = f"damping: no group {pattern!r}; {suggest(pattern, model.groups)}"
            raise OptionError(text, key=("damping", number, "groups"))
        able = {name for name in fits if all(model.group(name).has(q) for q in needed)}
        if pattern in model.groups or not able:
            names |= fits
        else:
            names |= able
    return names


def configure_model(job: Job, model: Model) -> Model:
    """Return the model configured as in the job's test, with added masses and fixed DOFs."""
    from updyn.elements.constraints import constrain

    model = _add_test_masses(job, model)
    if job.test.grounded:
        with key_path("test", "grounded"):
            model = constrain(model, grounded=job.test.grounded)
    return model


def _add_test_masses(job: Job, model: Model) -> Model:
    from updyn.elements.masses import add_masses, add_sensor_masses

    if job.test.masses:
        with key_path("test", "masses"):
            model = add_masses(model, job.test.masses)
    if job.test.sensor_masses:
        with key_path("test", "sensor_masses"):
            model = add_sensor_masses(model, job.test.sensor_masses)
    return model


def add_all_masses(job: Job, model: Model) -> Model:
    """Return the model with the masses of all tests, to which unknowns may refer."""
    groups = dict(model.groups)
    for part in job.parts:
        groups = dict(_add_test_masses(part, model).groups) | groups
    order = dict.fromkeys([*model.groups, *groups])
    return replace(model, groups={name: groups[name] for name in order})
