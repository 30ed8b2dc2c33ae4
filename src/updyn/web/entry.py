"""`TextEntry`: a text input that is not overwritten while the user types."""

from __future__ import annotations

from nicegui import ui

__all__ = ["TextEntry"]


class TextEntry(ui.input, component="entry.js"):
    """A text input; a value that is set while it has the focus does not replace typed text."""
