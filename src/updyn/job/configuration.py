"""The model of a job in the configuration of its tests: damping, added masses, held DOFs."""

from __future__ import annotations

import fnmatch

from updyn.errors import OptionError, key_path, suggest
from updyn.job.schema import Job
from updyn.model import Model

__all__ = ["configured", "damped", "with_all_masses"]


def damped(job: Job, model: Model) -> Model:
    """Return the model with the damping that the job begins with; a later table wins."""
    for number, table in enumerate(job.damping):
        acting = {"loss_factor" if name == "loss_table" else name for name in table.stated}
        able = {name for name, group in model.groups.items() if all(group.has(q) for q in acting)}
        names: list[str] = []
        for pattern in table.groups:
            fits = [n for n in model.groups if fnmatch.fnmatchcase(n, pattern) or pattern == "all"]
            if not fits:
                text = f"damping: no group {pattern!r}; {suggest(pattern, model.groups)}"
                raise OptionError(text, key=("damping", number, "groups"))
            if pattern in model.groups or not able.intersection(fits):
                names += fits  # and if there is nothing to act on, that is said
            names += able.intersection(fits)
        chosen = {name: table.stated for name in model.groups if name in names}
        with key_path("damping", number):
            model = model.with_damping(chosen)
    return model


def configured(job: Job, model: Model) -> Model:
    """Return the model as it stands in the job's test: with what was added to it, and held."""
    from updyn.elements.constraints import constrain

    model = _loaded(job, model)
    if job.test.grounded:
        with key_path("test", "grounded"):
            model = constrain(model, grounded=job.test.grounded)
    return model


def _loaded(job: Job, model: Model) -> Model:
    """Return the model with the masses of the job's test."""
    from updyn.elements.masses import add_masses, add_sensor_masses

    if job.test.masses:
        with key_path("test", "masses"):
            model = add_masses(model, job.test.masses)
    if job.test.sensor_masses:
        with key_path("test", "sensor_masses"):
            model = add_sensor_masses(model, job.test.sensor_masses)
    return model


def with_all_masses(job: Job, model: Model) -> Model:
    """Return the model with the masses of all tests, for unknowns to name them."""
    groups = dict(model.groups)
    for part in job.parts:
        groups = dict(_loaded(part, model).groups) | groups
    order = [*model.groups, *(name for name in groups if name not in model.groups)]
    return Model({name: groups[name] for name in order}, model.dofs, model.geometry, model.title)
