"""Noise models: how uncertain each measured value is, given or estimated; one file each.

Everywhere E|dH|^2 is the variance of the complex value: the real and the imaginary part have half of it each. Where the
noise is proportional the model's |H| is used, not the measured one, as weights made from noisy data bias the estimate.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias

import numpy as np

from updyn.errors import OptionError, suggest
from updyn.frf import FRF
from updyn.updating.noise.base import ASSUMED, NoiseModel, level_by_unit
from updyn.updating.noise.coherence import Coherence
from updyn.updating.noise.estimated import Estimated
from updyn.updating.noise.given import Variance
from updyn.updating.noise.stated import Assumed, Stated

__all__ = [
    "ASSUMED",
    "Assumed",
    "Coherence",
    "Estimated",
    "NoiseModel",
    "Stated",
    "Variance",
    "choose_noise",
    "level_by_unit",
]

NoiseChoice: TypeAlias = "str | Mapping[str, float] | None"

#: Where the noise may be taken from, by name.
SOURCES = {"variance": lambda frf: Variance(), "coherence": Coherence.of, "estimated": lambda frf: Estimated()}


def choose_noise(noise: NoiseChoice, frf: FRF) -> NoiseModel:
    """Choose the noise model.

    Parameters
    ----------
    noise : None, str or mapping
        None: from the data's variance, else their coherence (of two averages or more), else estimated.
        ``"variance"``, ``"coherence"`` or ``"estimated"`` to force one. A mapping with ``relative`` and/or ``floor``
        states it.
    frf : FRF
        The data of the fit.

    Raises
    ------
    OptionError
        If a name or key is not known, a number is not usable, or the data lack what is asked for.
    """
    if isinstance(noise, Mapping):
        return _stated(noise)
    if noise is None:
        single = frf.averages == 1  # its coherence is 1 whatever the noise
        usable = frf.coherence is not None and not single
        noise = "variance" if frf.variance is not None else "coherence" if usable else "estimated"
    if noise not in SOURCES:
        raise OptionError(f"noise {noise!r}: {suggest(str(noise), SOURCES)}, or a table with relative and floor")
    if noise in ("variance", "coherence") and getattr(frf, noise) is None:
        raise OptionError(f"noise {noise!r}: the data carry no {noise}")
    if noise == "coherence" and frf.averages == 1:
        raise OptionError("noise 'coherence': that of a single average is 1 whatever the noise; it says nothing")
    return SOURCES[noise](frf)


def _stated(noise: Mapping[str, float]) -> Stated:
    for key, value in noise.items():
        if key not in ("relative", "floor"):
            raise OptionError(f"noise: no key {key!r}; {suggest(str(key), ('relative', 'floor'))}")
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value) or value < 0:
            raise OptionError(f"noise: {key} = {value!r}; expected a number of at least 0")
    stated = Stated(float(noise.get("relative", 0.0)), float(noise.get("floor", 0.0)))
    if stated.relative == stated.floor == 0.0:
        raise OptionError("noise: relative and floor are both 0; data without noise need no noise model, leave it out")
    return stated
