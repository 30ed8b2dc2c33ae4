"""Noise models: the variance of each measured value, known or estimated.

E|dH|^2 is the variance of the complex value; the real and the imaginary part have half of it each.
Proportional noise is computed from the model's |H|, not the measured one, because weights made from
noisy data bias the estimate.

To add a noise model, derive it from `NoiseModel` and register it under a name:
``NOISE_MODELS.register("my-noise", MyNoise)``, or an entry point of the group ``updyn.noise``. The
option ``noise="NAME"`` selects it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np

from updyn.errors import OptionError, suggest
from updyn.frf import FRF
from updyn.group import is_number
from updyn.registry import Registry
from updyn.updating.problem.noise.approximate import Approximate
from updyn.updating.problem.noise.estimated import Estimated, EstimatedByChannel
from updyn.updating.problem.noise.known import (
    ASSUMED,
    Assumed,
    Coherence,
    NoiseModel,
    Stated,
    Variance,
    level_by_unit,
)
from updyn.updating.problem.noise.repeats import average
from updyn.updating.problem.noise.robust import Robust
from updyn.updating.problem.noise.settings import ROBUST_NOISE

__all__ = [
    "ASSUMED",
    "NOISE_MODELS",
    "Approximate",
    "Assumed",
    "Coherence",
    "Estimated",
    "EstimatedByChannel",
    "NoiseModel",
    "Robust",
    "Stated",
    "Variance",
    "average",
    "choose_noise",
    "level_by_unit",
    "restore_noise",
]

NoiseChoice: TypeAlias = "str | Mapping[str, float | str] | None"

#: Noise models by name.
NOISE_MODELS: Registry[type[NoiseModel]] = Registry(
    "noise",
    "updyn.noise",
    {
        "variance": Variance,
        "coherence": Coherence,
        "estimated": Estimated,
        "estimated-by-channel": EstimatedByChannel,
    },
)
_NUMBERS, _KEYS = ("relative", "floor"), ("relative", "floor", "source", "robust")


def choose_noise(noise: NoiseChoice | NoiseModel, frf: FRF) -> NoiseModel:
    """Choose the noise model of FRFs, or return the given one of these FRFs.

    None: the variance of the data unless it is zero everywhere, else their coherence (of two
    averages or more, and not 1 everywhere), else estimated. A name selects a model; a mapping has
    ``relative`` and/or ``floor`` (stated noise) or ``source`` (a name), and ``robust =
    "student-t"`` for less weight on outliers.
    """
    if isinstance(noise, NoiseModel):
        return noise
    if not isinstance(noise, Mapping):
        return _choose_source(noise, frf)
    for key in noise:
        if key not in _KEYS:
            raise OptionError(
                f"noise: no key {key!r}; {suggest(str(key), _KEYS)}", key=("noise", key)
            )
    robust = noise.get("robust")
    if robust not in (None, Robust.name):
        raise OptionError(
            f"noise: robust = {robust!r}; {suggest(str(robust), (Robust.name,))}",
            key=("noise", "robust"),
        )
    numbers = {key: noise[key] for key in _NUMBERS if key in noise}
    if numbers and "source" in noise:
        raise OptionError(
            "noise: relative and floor state it, source takes it from elsewhere; give one of"
            " the two",
            key=("noise",),
        )
    tails = np.inf if robust is None else ROBUST_NOISE.freedoms
    stated = numbers or not (robust or "source" in noise)
    model = _make_stated(numbers) if stated else _choose_source(noise.get("source"), frf, tails)
    return model if robust is None else Robust(model)


def _choose_source(source: Any, frf: FRF, tails: float = np.inf) -> NoiseModel:
    if source is None:
        source = "estimated"
        if Variance.is_informative(frf):
            source = "variance"
        elif Coherence.is_informative(frf):
            source = "coherence"
    if source not in NOISE_MODELS:
        raise OptionError(
            f"noise {source!r}: {suggest(str(source), NOISE_MODELS)}, or a table with relative and"
            " floor",
            key=("noise",),
        )
    model = NOISE_MODELS[source]
    if model.needs and getattr(frf, model.needs) is None:
        raise OptionError(f"noise {source!r}: the data carry no {model.needs}", key=("noise",))
    return model.of_data(frf, tails)


def _make_stated(noise: Mapping[str, Any]) -> Stated:
    usable: dict[str, float] = {}
    for key, value in noise.items():
        if not is_number(value) or not 0.0 <= value < np.inf:
            raise OptionError(
                f"noise: {key} = {value!r}; expected a number of at least 0", key=("noise", key)
            )
        usable[key] = float(value)
    stated = Stated(usable.get("relative", 0.0), usable.get("floor", 0.0))
    if stated.relative == stated.floor == 0.0:
        raise OptionError(
            "noise: relative and floor are both 0; data without noise need no noise model, leave"
            " it out",
            key=("noise",),
        )
    return stated


def restore_noise(record: Mapping[str, Any], frf: FRF) -> NoiseModel:
    """Return the noise model of a result's record with fixed numbers."""
    base: NoiseModel
    if "relative_by_channel" in record:
        base = _restore_by_channel(record, frf)
    elif record.get("kind") in NOISE_MODELS and "relative" not in record:
        base = _choose_source(record["kind"], frf)
    else:
        base = Stated(float(record.get("relative", 0.0)), float(record.get("floor", 0.0)))
    return Robust(base) if record.get("robust") == Robust.name else base


def _restore_by_channel(record: Mapping[str, Any], frf: FRF) -> EstimatedByChannel:
    relative, floor = record["relative_by_channel"], record["floor_by_channel"]
    names = tuple(frf.responses.labels)
    lacking = [label for label in names if label not in relative]
    if lacking:
        raise OptionError(
            f"noise by channel: nothing is known of response {lacking[0]}", key=("noise",)
        )
    a = np.array([relative[label] for label in names])
    b = np.array([floor[label] for label in names])
    return EstimatedByChannel(relative=a, floor=b, names=names, held=True)
