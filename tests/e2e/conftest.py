"""One browser for the tests of a module."""

from window import chromium

__all__ = ["chromium"]
