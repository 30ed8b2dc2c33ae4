"""The section of the report on how the result was made, with checksums of data and models."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import numpy as np

from updyn.frf import FRF
from updyn.model import Model
from updyn.report import formats as w
from updyn.report import markup as m
from updyn.report.plots import Figure
from updyn.report.section import Content, Section

__all__ = ["PROVENANCE", "data_checksum", "model_checksum"]


def data_checksum(frf: FRF) -> str:
    """Return the SHA-256 of the data: quantity, labels, lines (float64) and values (complex128), little-endian."""
    digest = hashlib.sha256()
    digest.update("\n".join([frf.quantity, *frf.responses.labels, *frf.references.labels]).encode())
    digest.update(np.ascontiguousarray(frf.freq, dtype="<f8").tobytes())
    digest.update(np.ascontiguousarray(frf.values, dtype="<c16").tobytes())
    return digest.hexdigest()


def model_checksum(model: Model) -> str:
    """Return the SHA-256 of a model: labels, then by group its name, damping and sparse matrices, little-endian."""
    digest = hashlib.sha256()
    digest.update("\n".join(model.dofs.labels).encode())
    for name, group in model.groups.items():
        digest.update(f"\n{name}\n{group.loss_factor!r}".encode())
        for what, value in group.damping.items():
            if what == "loss_table":
                digest.update(f"\n{what}".encode())
                for array in (value.freq, value.relative):
                    digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
            elif what != "loss_factor":
                digest.update(f"\n{what} {value!r}".encode())
        for what in ("stiffness", "mass", "viscous"):
            matrix = getattr(group, what)
            digest.update(f"\n{what}".encode())
            if matrix is not None:
                for array, dtype in (
                    (matrix.indptr, "<i8"),
                    (matrix.indices, "<i8"),
                    (matrix.data, "<f8"),
                ):
                    digest.update(np.ascontiguousarray(array, dtype=dtype).tobytes())
    return digest.hexdigest()


class Provenance(Section):
    """Options, lines, versions, checksums and time of the update."""

    anchor = "provenance"
    name = "How it was made"
    heading = "How it was made"
    place = 9000

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """How the result was made: options, lines, versions, checksums, time."""
        lines = ", ".join(f"{f:.6g}" for f in content.result.lines)
        options = [(str(k), w.plain(v)) for k, v in content.result.options.items()]
        about = [
            ("method", content.result.method),
            ("measured data", f"{content.result.frf.quantity}, {w.extent(content.result.frf)}"),
            ("source of the data", content.result.frf.source or "not stated"),
            (
                "model",
                f"{content.result.start.n_dofs} DOFs, groups: {', '.join(content.result.start.groups)}",
            ),
            ("responses fitted", ", ".join(content.result.fitted_responses) or "none"),
            ("held out", w.held_out(content.result) or "nothing"),
        ]
        sums = [
            ("measured data", data_checksum(content.result.frf)),
            ("start model", model_checksum(content.result.start)),
            ("updated model", model_checksum(content.result.model)),
        ]
        explained = (
            "SHA-256 of the numbers themselves, not of a file: of the quantity, labels, lines and"
            " values of the data, and of the labels, loss factors and matrices of each model."
        )
        seconds = [(k, f"{w.number(float(v), 3)} s") for k, v in content.result.timing_s.items()]
        return "".join(
            [
                m.definition_table(about),
                m.details(
                    "Options", m.definition_table(options) if options else m.paragraph("None.")
                ),
                m.details(
                    f"Lines used in the fit ({len(content.result.lines)}), in Hz",
                    m.paragraph(lines or "none"),
                ),
                m.details("Checksums", m.paragraph(explained) + m.definition_table(sums)),
                m.details(
                    "Versions",
                    m.definition_table(
                        [(str(k), str(v)) for k, v in content.result.versions.items()]
                    ),
                ),
                m.details("Time", m.definition_table(seconds)),
            ]
        )


PROVENANCE = Provenance()
