"""Measured modes (`ModeSet`), repeated tests, identification (`identify_modes`), indicators."""

from __future__ import annotations

from updyn.modal.identify import identify_modes
from updyn.modal.indicator import cmif
from updyn.modal.mode_set import ModeSet
from updyn.modal.repeated import RepeatedTests
from updyn.modal.synthesis import synthesise

__all__ = ["ModeSet", "RepeatedTests", "cmif", "identify_modes", "synthesise"]
