"""The section of the report on provenance, with checksums of data and models."""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import ArrayLike

from updyn.frf import FRF
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.report.formats import extent, number, option_words, validation_words
from updyn.report.section import PageContent, ReportSection

__all__ = ["PROVENANCE", "data_checksum", "model_checksum"]


def data_checksum(data: FRF | ModeSet) -> str:
    """Return the SHA-256 of the data as hexadecimal digits."""
    # FRFs: quantity, labels, lines (float64) and values (complex128), little-endian. Modes:
    # labels, frequencies, shapes and loss factors.
    digest = hashlib.sha256()
    if isinstance(data, ModeSet):
        digest.update("\n".join(["modes", *data.dofs.labels]).encode())
        digest.update(_to_bytes(data.frequency, "<f8"))
        digest.update(_to_bytes(data.shapes, "<c16"))
        digest.update(_to_bytes(data.loss_factor, "<f8"))
        return digest.hexdigest()
    frf = data
    digest.update("\n".join([frf.quantity, *frf.responses.labels, *frf.references.labels]).encode())
    digest.update(_to_bytes(frf.freq, "<f8"))
    digest.update(_to_bytes(frf.values, "<c16"))
    return digest.hexdigest()


def model_checksum(model: Model) -> str:
    """Return the SHA-256 of a model: labels, then name, damping and matrices of each group."""
    # Sparse matrices are hashed as little-endian CSR arrays.
    digest = hashlib.sha256()
    digest.update("\n".join(model.dofs.labels).encode())
    for name, group in model.groups.items():
        digest.update(f"\n{name}\n{group.loss_factor!r}".encode())
        for what, value in group.damping.items():
            if what == "loss_table":
                digest.update(f"\n{what}".encode())
                digest.update(_to_bytes(value.freq, "<f8"))
                digest.update(_to_bytes(value.relative, "<f8"))
            elif what != "loss_factor":
                digest.update(f"\n{what} {value!r}".encode())
        for what in ("stiffness", "mass", "viscous"):
            matrix = getattr(group, what)
            digest.update(f"\n{what}".encode())
            if matrix is not None:
                digest.update(_to_bytes(matrix.indptr, "<i8"))
                digest.update(_to_bytes(matrix.indices, "<i8"))
                digest.update(_to_bytes(matrix.data, "<f8"))
    return digest.hexdigest()


def _to_bytes(array: ArrayLike, dtype: str) -> bytes:
    return np.ascontiguousarray(array, dtype=dtype).tobytes()


class ProvenanceSection(ReportSection):
    """Options, lines, versions, checksums and times of the update."""

    anchor = "provenance"
    name = "Provenance"
    heading = "Provenance"
    place = 9000
    template = "updyn.report/provenance.html"

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the names and values of each table."""
        result = content.result
        data, start = result.data, result.start
        kind, fitted = "modes", "modes fitted at"
        if isinstance(data, FRF):
            kind, fitted = data.quantity, "responses fitted"
        return {
            "about": [
                ("method", result.method),
                ("measured data", f"{kind}, {extent(data)}"),
                ("source of the data", data.source or "not stated"),
                ("model", f"{start.n_dofs} DOFs, groups: {', '.join(start.groups)}"),
                (fitted, ", ".join(result.fitted_responses) or "none"),
                ("held out", validation_words(result) or "nothing"),
            ],
            "options": [(name, option_words(value)) for name, value in result.options.items()],
            "lines": [f"{freq:.6g}" for freq in result.lines],
            "checksums": [
                ("measured data", data_checksum(data)),
                ("start model", model_checksum(start)),
                ("updated model", model_checksum(result.model)),
            ],
            "versions": list(result.versions.items()),
            "seconds": [(k, f"{number(float(v), 3)} s") for k, v in result.timing_s.items()],
        }


PROVENANCE = ProvenanceSection()
