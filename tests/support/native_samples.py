"""One small file of each native kind, how to read it, and its mutants by one flipped bit."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import io_samples
import updyn
from updyn.uncertainty.draws import Draws

#: The start of the last line of a native file; all before it is HDF5.
MARK = b"updyn-sha256 "


@dataclass(frozen=True)
class Native:
    """A kind of native file: its usual name, what it is a sample of, its writer and its reader."""

    name: str
    sample: Callable[[], Any]
    save: Callable[[Any, Path], None]
    read: Callable[[Path], Any]

    def write(self, path: Path) -> None:
        """Write the sample."""
        self.save(self.sample(), path)


def _draws() -> Draws:
    ones = np.ones(2)
    chains = np.random.default_rng(0).uniform(0.5, 1.0, (3, 4, 2))
    return Draws(
        "sampling", ("a.stiffness", "b.mass"), chains, ones, ones, ones, ones, ones > 0, {}, {}
    )  # fmt: skip


@functools.cache
def _result() -> updyn.UpdateResult:
    groups = {}
    for name, k in (("a", 1e4), ("b", 2e4)):
        groups[name] = updyn.Group(k * np.eye(2) + k / 2, np.eye(2), loss_factor=0.02)
    model = updyn.Model.from_groups(groups, ["1:X", "2:X"])
    true = model.scaled({"a": {"stiffness": 1.1}})
    frf = updyn.response(true, np.linspace(5.0, 60.0, 12), ["1:X", "2:X"], ["1:X"])
    noise = {"relative": 0.01, "floor": 0.0}
    return updyn.update(model, frf, updyn.parameters(model, stiffness=["a"]), noise=noise)


NATIVE = (
    Native("model.h5", io_samples.model, updyn.write_model, updyn.read_model),
    Native("frf.nc", io_samples.frf, updyn.write_frf, updyn.read_frf),
    Native("run.nc", _result, updyn.write_result, updyn.read_result),
    Native("uncertainty.nc", _draws, updyn.write_uncertainty, updyn.read_uncertainty),
)


def bit_flips(content: bytes, count: int, seed: int) -> Iterator[tuple[int, bytes]]:
    """Yield the place and the content of mutants by one flipped bit each."""
    rng = np.random.default_rng(seed)
    for bit in rng.choice(8 * len(content), count, replace=False).tolist():
        mutant = bytearray(content)
        mutant[bit // 8] ^= 1 << bit % 8
        yield bit // 8, bytes(mutant)
