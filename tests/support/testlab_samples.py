"""Files of the layout that Simcenter Testlab exports for MATLAB."""

from __future__ import annotations

import numpy as np
import scipy.io

N = 6
ACCELERANCE = {"MASS": -1}
MOBILITY = {"MASS": -1, "TIME": 1}
RECEPTANCE = {"MASS": -1, "TIME": 2}
DIMENSIONS = ("LENGTH", "ANGLE", "MASS", "TIME", "CURRENT", "TEMPERATURE")
RNG = np.random.default_rng(5)


def quantity(label, terms, factor=1.0, info="Data saved by Test.Lab in MKS"):
    return {
        "label": label,
        "unit_transformation": {"offset": 0.0, "factor": factor, "log_reference": 1.0},
        "quantity_terms": [
            {"num": float(terms.get(name, 0)), "den": 1.0, "quantity": name} for name in DIMENSIONS
        ],
        "info": info,
    }


def export(
    responses,
    references,
    unit="(m/s^2)/N",
    terms=ACCELERANCE,
    kind="FRF",
    values=None,
    axis=(1.0, 0.5),
    **options,
):
    """A struct of functions; one reference, or as many as responses."""
    n = len(responses)
    references = references if isinstance(references, list) else [references] * n
    if values is None:
        values = RNG.standard_normal((N, n)) + 1j * RNG.standard_normal((N, n))
    return {
        "x_values": {
            "start_value": axis[0],
            "increment": axis[1],
            "number_of_values": float(len(values)),
            "quantity": quantity("Hz", {"TIME": -1}),
        },
        "y_values": {"values": values, "quantity": quantity(unit, terms, **options)},
        "function_record": {
            "type": kind,
            "primary_channel": {"id": np.arange(1.0, n + 1), "label": responses},
            "reference_channel": {"id": np.full(n, 9.0), "label": references},
            "average": {"nr_of_averages": np.full(n, 54.0), "type": ["LINAVERAGE"] * n},
        },
    }


def _storable(item):
    if isinstance(item, dict):
        return {key: _storable(value) for key, value in item.items()}
    if isinstance(item, list) and isinstance(item[0], dict):
        out = np.empty((1, len(item)), dtype=[(key, object) for key in item[0]])
        for i, entry in enumerate(item):
            out[0, i] = tuple(entry.values())
        return out
    if isinstance(item, list):
        return np.array(item, dtype=object)[None, :]
    return item


def save_5(path, variables):
    scipy.io.savemat(path, _storable(variables))
