"""Measured modes (`ModeSet`) and their identification from measured FRFs (`identify_modes`)."""

from __future__ import annotations

from updyn.modal.identify import identify_modes
from updyn.modal.mode_set import ModeSet

__all__ = ["ModeSet", "identify_modes"]
