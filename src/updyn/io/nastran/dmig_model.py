"""DMIG files (``.pch``, ``.dmig``) as models: with the TOML file beside them, see `updyn.io.nastran.matrices`."""

from __future__ import annotations

from pathlib import Path

from updyn.io.nastran.matrices import read_beside, write_beside
from updyn.model import Model

__all__ = ["read_model", "write_model"]


def read_model(path: str | Path) -> Model:
    """Read a model from the TOML file beside its matrices; see `updyn.io.nastran.matrices.read_beside`."""
    return read_beside(path)


def write_model(model: Model, path: str | Path) -> None:
    """Write a model's matrices, and the TOML file beside them; see `updyn.io.nastran.matrices.write_beside`."""
    write_beside(model, path, "dmig")
