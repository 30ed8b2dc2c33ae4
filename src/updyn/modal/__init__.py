"""Measured modes (`ModeSet`), their identification (`identify_modes`) and its indicators."""

from __future__ import annotations

from updyn.modal.identify import identify_modes
from updyn.modal.indicator import cmif
from updyn.modal.mode_set import ModeSet
from updyn.modal.synthesis import synthesise

__all__ = ["ModeSet", "cmif", "identify_modes", "synthesise"]
