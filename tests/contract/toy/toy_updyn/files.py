"""Files of FRFs: a line of labels, then a line for each frequency."""

import numpy as np

from updyn.frf import FRF
from updyn.io.formats import Format


def read_frf(path, *, quantity=None, duplicates=None):
    """Read responses to one reference: Hz, then real and imaginary part of each response."""
    _, reference, *responses = path.read_text(encoding="utf-8").splitlines()[0].split()
    rows = np.loadtxt(path, skiprows=1, ndmin=2)
    values = rows[:, 1::2] + 1j * rows[:, 2::2]
    return FRF(rows[:, 0], values[:, :, None], responses, [reference], quantity or "receptance")


def write_frf(frf, path):
    """Write an FRF with one reference."""
    labels = [*frf.references.labels, *frf.responses.labels]
    parts = np.stack([frf.values[:, :, 0].real, frf.values[:, :, 0].imag], axis=-1)
    rows = np.column_stack([frf.freq, parts.reshape(len(frf.freq), -1)])
    np.savetxt(path, rows, fmt="%.17g", header="TOY " + " ".join(labels), comments="")


TOY = Format("toy", "toy_updyn.files", (".toy",), (b"TOY ",), ("read_frf", "write_frf"))
