"""Sentences of the message of a result."""

from __future__ import annotations

__all__ = ["split_ending"]


def split_ending(message: str) -> tuple[str, str]:
    """Return the first sentence, which states how the fit ended, and the others."""
    ending, separator, others = message.partition(". ")
    return (f"{ending}." if separator else ending), others
