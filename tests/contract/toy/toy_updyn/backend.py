"""A sparse backend: SuperLU, counted."""

from updyn.linalg.superlu import SuperLU


class Toy(SuperLU):
    """SuperLU under another name."""
