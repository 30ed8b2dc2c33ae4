"""Builders of models: beams, drive trains, structures in space and meshes, and constraints.

`MODEL_KINDS` has the builders for ``[model] kind = "..."`` of a job file. `MODEL_QUESTIONS` has
functions that check such a table against the band of the test.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from updyn.registry import Registry

if TYPE_CHECKING:
    from updyn.model import Model

__all__ = ["MODEL_KINDS", "MODEL_QUESTIONS"]

#: Builders of models by kind: functions from the keys of the table ``[model]`` to a `Model`.
MODEL_KINDS: Registry[Callable[[Mapping[str, object]], Model]] = Registry(
    "model kind",
    "updyn.model_kinds",
    {
        "beam": "updyn.elements.beam:beam_from_table",
        "drivetrain": "updyn.elements.drivetrain:drivetrain_from_table",
        "structure": "updyn.elements.structure:structure_from_table",
    },
)

#: Questions about the table of a kind: functions of its keys and of a band in Hz.
MODEL_QUESTIONS: Registry[Callable[[Mapping[str, object], tuple[float, float]], list[str]]] = (
    Registry(
        "model kind",
        "updyn.model_questions",
        {"drivetrain": "updyn.elements.drivetrain:ratio_questions"},
    )
)
