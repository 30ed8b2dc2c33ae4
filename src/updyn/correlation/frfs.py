"""Correlation of FRFs: criteria on arrays (lines, responses, references), and `correlate_frfs`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import BoolArray, ComplexArray, NumberArray, RealArray
from updyn.correlation.figures import FIGURE_NAMES, SHORT_NAMES, figure_text
from updyn.correlation.shapes import ratio
from updyn.dofs import DofSet
from updyn.errors import DataError
from updyn.frf import FRF
from updyn.model import Model
from updyn.notebook import card, table
from updyn.positions import warn_of_labels
from updyn.settings import ROUNDING

__all__ = [
    "Correlation",
    "correlate_frfs",
    "csac",
    "csf",
    "db_error",
    "fdac",
    "frac",
    "frf_correlation",
    "nonzero_lines",
    "relative_residual",
]

Array = RealArray


@dataclass(frozen=True, slots=True, eq=False)
class Correlation:
    """The correlation of a computed and a measured FRF.

    Attributes
    ----------
    computed, measured : FRF
        Both FRFs, on the lines and DOFs of the measured one and with the same quantity.
    frac, frf_correlation, relative_residual : ndarray of float, shape (n_responses, n_references)
        See `frac`, `frf_correlation` and `relative_residual`.
    csac, csf : ndarray of float, shape (n_f,)
        See `csac` and `csf`.
    db_error : ndarray of float, shape (n_f, n_responses, n_references)
        See `db_error`, in dB.
    """

    computed: FRF
    measured: FRF
    frac: Array
    frf_correlation: Array
    relative_residual: Array
    csac: Array
    csf: Array
    db_error: Array

    def __repr__(self) -> str:
        return "Correlation(" + ", ".join(f"{k} {v:.3g}" for k, v in self.figures().items()) + ")"

    def _repr_html_(self) -> str:
        figures = [
            [FIGURE_NAMES[name], figure_text(name, value)] for name, value in self.figures().items()
        ]
        names = [name for name in SHORT_NAMES if name in self.figures()]
        rows = []
        for label, values in self.by_response().items():
            rows.append([label, *(figure_text(name, values[name]) for name in names)])
        facts = {
            "responses": len(self.responses),
            "references": len(self.references),
            "lines": f"{len(self.freq)} from {self.freq[0]:g} to {self.freq[-1]:g} Hz",
        }
        header = ("response", *(SHORT_NAMES[name] for name in names))
        return card(
            "Correlation of FRFs", facts, table(("agreement", ""), figures), table(header, rows)
        )

    @property
    def freq(self) -> Array:
        """Lines in Hz, shape (n_f,)."""
        return self.measured.freq

    @property
    def responses(self) -> DofSet:
        """Responses, in the order of the arrays."""
        return self.measured.responses

    @property
    def references(self) -> DofSet:
        """References, in the order of the arrays."""
        return self.measured.references

    def fdac(self, lines: ArrayLike | None = None) -> Array:
        """Compute `fdac` between lines.

        Parameters
        ----------
        lines : array_like of float, optional
            Lines of the data in Hz; by default all, which needs memory for n_f^2 numbers.

        Returns
        -------
        ndarray of float, shape (n, n)
            Rows: lines of the computed FRF; columns: lines of the measured FRF.

        Raises
        ------
        DataError
            If a line is not in the data.
        """
        at = slice(None) if lines is None else self.measured.find_lines(lines)
        return fdac(self.measured.values[at], self.computed.values[at])

    def figures(self) -> dict[str, float]:
        """Return figures of the whole FRF.

        FRAC and correlation (median, min), relative residual (median, max), CSAC and CSF (mean),
        dB error (median, 95th percentile). Channels that are not `heard` are ignored, and so are,
        in CSAC and CSF, lines on which both FRFs are zero, such as accelerances at 0 Hz.
        """
        channels = _select_heard(np.ones(self.frac.shape, dtype=bool), self.heard)
        is_nonzero = nonzero_lines(self.measured.values, self.computed.values)
        lines = is_nonzero if is_nonzero.any() else np.ones_like(is_nonzero)
        return {
            **self._figures_of(channels),
            "csac_mean": float(self.csac[lines].mean()),
            "csf_mean": float(self.csf[lines].mean()),
            **_summarise_levels(self.db_error[:, channels]),
        }

    def by_response(self) -> Mapping[str, dict[str, float]]:
        """Return figures by response.

        FRAC and correlation (median, min), relative residual (median, max), dB error (median, 95th
        percentile). Channels that are not `heard` are ignored if the response has others.
        """
        out, heard = {}, self.heard
        for i, label in enumerate(self.responses.labels):
            is_response = np.zeros(self.frac.shape, dtype=bool)
            is_response[i] = True
            channels = _select_heard(is_response, heard)
            out[label] = {
                **self._figures_of(channels),
                **_summarise_levels(self.db_error[:, channels]),
            }
        return out

    @property
    def heard(self) -> BoolArray:
        """Mask of channels above rounding error, shape (n_responses, n_references).

        The rms of the channel, measured or computed, exceeds 1e-11 of that of the largest measured
        channel. Channels that vanish by symmetry are below this limit.
        """
        level, other = (
            np.sqrt(np.mean(np.abs(frf.values) ** 2, axis=0))
            for frf in (self.measured, self.computed)
        )
        return np.asarray(np.maximum(level, other) > ROUNDING.receptance_share * level.max())

    def _figures_of(self, channels: BoolArray) -> dict[str, float]:
        """Return median and worst value over given channels of the figures of each channel."""
        frac, correlation = self.frac[channels], self.frf_correlation[channels]
        residual = self.relative_residual[channels]
        return {
            "frac_median": float(np.median(frac)),
            "frac_min": float(frac.min()),
            "correlation_median": float(np.median(correlation)),
            "correlation_min": float(correlation.min()),
            "residual_median": float(np.median(residual)),
            "residual_max": float(residual.max()),
        }


def correlate_frfs(model_or_frf: Model | FRF, frf: FRF) -> Correlation:
    """Compare a model, or a computed FRF, with a measured FRF; see `updyn.correlate`."""
    if not isinstance(frf, FRF):
        raise DataError(f"correlate: expected a measured FRF, found {type(frf).__name__}")
    if isinstance(model_or_frf, Model):
        from updyn.dynamics.response import response_like
        from updyn.dynamics.zero_line import leave_out_zero_line

        warn_of_labels(model_or_frf, frf)
        frf = leave_out_zero_line(model_or_frf, frf)
        computed = response_like(model_or_frf, frf)
    elif isinstance(model_or_frf, FRF):
        computed = _align(model_or_frf, frf)
    else:
        raise DataError(
            f"correlate: expected a Model or an FRF, found {type(model_or_frf).__name__}"
        )
    hx, ha = frf.values, computed.values
    measures = (frac, frf_correlation, relative_residual, csac, csf, db_error)
    parts = [measure(hx, ha) for measure in measures]
    for array in parts:
        array.flags.writeable = False
    return Correlation(computed, frf, *parts)


def _align(computed: FRF, measured: FRF) -> FRF:
    a, x = computed.freq, measured.freq
    if len(a) != len(x):
        raise DataError(
            f"the two FRFs differ in lines: {_describe_lines(a)} and {_describe_lines(x)};"
            " select the same lines of both"
        )
    off = np.abs(a - x) > 1e-9 * x
    if off.any():
        i = int(np.flatnonzero(off)[0])
        raise DataError(
            f"the two FRFs differ in lines: line {i + 1} is {a[i]:.9g} Hz and {x[i]:.9g} Hz"
        )
    if computed.decay != measured.decay:
        raise DataError(
            "the two FRFs differ in the decay of their exponential windows:"
            f" {computed.decay:g} and {measured.decay:g} 1/s"
        )
    for what, dofs, other in (
        ("response", computed.responses, measured.responses),
        ("reference", computed.references, measured.references),
    ):
        for dofs_1, dofs_2, name in ((dofs, other, "second"), (other, dofs, "first")):
            missing = [str(d) for d in dofs_1 if d not in dofs_2]
            if missing:
                raise DataError(
                    f"the two FRFs differ: {what} {missing[0]} is not in the {name} ({len(missing)}"
                    f" such); select the same {what}s of both"
                )
    return computed.select(responses=measured.responses, references=measured.references).converted(
        measured.quantity
    )


def _describe_lines(freq: Array) -> str:
    return f"{len(freq)} lines, {freq[0]:g}-{freq[-1]:g} Hz"


def _select_heard(channels: BoolArray, heard: BoolArray) -> BoolArray:
    both = channels & heard
    return both if both.any() else channels


def _summarise_levels(error: Array) -> dict[str, float]:
    # The percentile is one of the values, because interpolation between two infinite values gives
    # nan.
    return {
        "db_error_median": float(np.median(error)),
        "db_error_p95": float(np.percentile(error, 95, method="inverted_cdf")),
    }


def frac(HX: ArrayLike, HA: ArrayLike) -> Array:
    """Frequency response assurance criterion over lines (Heylen & Lammens 1996).

    |sum conj(h_X) h_A|^2 / (sum |h_X|^2 sum |h_A|^2) for each response and reference.

    Parameters
    ----------
    HX, HA : array_like of complex, shape (n_f, n_responses, n_references)
        Measured and computed, same quantity and unit.

    Returns
    -------
    ndarray of float, shape (n_responses, n_references)
        Between 0 and 1; independent of a constant factor. 0 if either function is zero at all
        lines.

    Raises
    ------
    DataError
        If the shapes differ or a number is not finite.
    """
    hx, ha = _check_functions(HX, HA)
    above = np.abs(np.sum(hx.conj() * ha, axis=0)) ** 2
    return ratio(above, np.sum(np.abs(hx) ** 2, axis=0) * np.sum(np.abs(ha) ** 2, axis=0))


def frf_correlation(HX: ArrayLike, HA: ArrayLike) -> Array:
    """Signed correlation coefficient over lines, of real and imaginary parts in one vector.

    Re(sum conj(h_X) h_A) / sqrt(sum |h_X|^2 sum |h_A|^2) for each response and reference; no mean
    is subtracted. `frac` is the squared modulus of the same quotient before the real part is
    taken. The square of this coefficient is therefore at most FRAC.

    Parameters
    ----------
    HX, HA : array_like of complex, shape (n_f, n_responses, n_references)
        Measured and computed, same quantity and unit.

    Returns
    -------
    ndarray of float, shape (n_responses, n_references)
        Between -1 and 1: -1 for a wrong sign, 0 for a phase error of 90 degrees. Independent of a
        positive factor only. 0 if either function is zero at all lines.

    Raises
    ------
    DataError
        As `frac`.
    """
    hx, ha = _check_functions(HX, HA)
    above = np.sum(hx.conj() * ha, axis=0).real
    below = np.linalg.norm(hx, axis=0) * np.linalg.norm(ha, axis=0)
    return np.asarray(np.copysign(ratio(np.abs(above), below), above))


def relative_residual(HX: ArrayLike, HA: ArrayLike) -> Array:
    """Norm of the complex residual over lines, relative to that of the measured function.

    sqrt(sum |h_A - h_X|^2 / sum |h_X|^2) for each response and reference: the root of the
    normalised mean square error. With r the `frf_correlation` and g the quotient of the norms of
    h_A and h_X, its square is 1 - 2 r g + g^2: it depends on shape, level, sign and phase.

    Parameters
    ----------
    HX, HA : array_like of complex, shape (n_f, n_responses, n_references)
        Measured and computed, same quantity and unit.

    Returns
    -------
    ndarray of float, shape (n_responses, n_references)
        Not negative: 0 for equal functions, 1 for a computed function that is zero, 2 for a wrong
        sign. If the measured function is zero at all lines: 0 if the computed one is, too, else
        inf.

    Raises
    ------
    DataError
        As `frac`.
    """
    hx, ha = _check_functions(HX, HA)
    residual, level = np.linalg.norm(ha - hx, axis=0), np.linalg.norm(hx, axis=0)
    out = np.where(residual > 0, np.inf, 0.0)
    np.divide(residual, level, out=out, where=level > 0)
    return out


def nonzero_lines(HX: ComplexArray, HA: ComplexArray) -> BoolArray:
    """Return a mask, shape (n_f,), of the lines on which at least one of two FRFs is not zero."""
    return np.asarray((HX != 0).any(axis=(1, 2)) | (HA != 0).any(axis=(1, 2)))


def csac(HX: ArrayLike, HA: ArrayLike) -> Array:
    """Cross signature assurance criterion chi_s at each line (Grafe 1998).

    |h_X^H h_A|^2 / (h_X^H h_X h_A^H h_A).

    Parameters
    ----------
    HX, HA : array_like of complex, shape (n_f, n_responses, n_references)
        Measured and computed; at each line all pairs of response and reference form one vector.

    Returns
    -------
    ndarray of float, shape (n_f,)
        Between 0 and 1; independent of a factor common to a line. 0 if either vector is zero.

    Raises
    ------
    DataError
        As `frac`.
    """
    hx, ha = (h.reshape(len(h), -1) for h in _check_functions(HX, HA))
    above = np.abs(np.sum(hx.conj() * ha, axis=1)) ** 2
    return ratio(above, np.sum(np.abs(hx) ** 2, axis=1) * np.sum(np.abs(ha) ** 2, axis=1))


def csf(HX: ArrayLike, HA: ArrayLike) -> Array:
    """Cross signature scale factor chi_a at each line (Grafe 1998).

    2 |h_X^H h_A| / (h_X^H h_X + h_A^H h_A).

    Parameters
    ----------
    HX, HA : array_like of complex, shape (n_f, n_responses, n_references)
        As `csac`.

    Returns
    -------
    ndarray of float, shape (n_f,)
        Between 0 and 1; 1 only for vectors that are equal up to a common phase. 0 if both are
        zero.

    Raises
    ------
    DataError
        As `frac`.
    """
    hx, ha = (h.reshape(len(h), -1) for h in _check_functions(HX, HA))
    above = 2.0 * np.abs(np.sum(hx.conj() * ha, axis=1))
    return ratio(above, np.sum(np.abs(hx) ** 2, axis=1) + np.sum(np.abs(ha) ** 2, axis=1))


def fdac(HX: ArrayLike, HA: ArrayLike) -> Array:
    """Frequency domain assurance criterion (Pascual et al. 1997).

    It is chi_s between every computed and every measured line.

    Parameters
    ----------
    HX : array_like of complex, shape (n_x, n_responses, n_references)
        Measured.
    HA : array_like of complex, shape (n_a, n_responses, n_references)
        Computed; its lines may differ.

    Returns
    -------
    ndarray of float, shape (n_a, n_x)
        Between 0 and 1. Rows: lines of the computed FRF; columns: lines of the measured FRF. A
        ridge off the diagonal shows a frequency shift. 0 if either vector is zero.

    Raises
    ------
    DataError
        If responses or references differ, or a number is not finite.
    """
    hx, ha = _check_functions(HX, HA, same_lines=False)
    x, a = hx.reshape(len(hx), -1), ha.reshape(len(ha), -1)
    above = np.abs(a.conj() @ x.T) ** 2
    return ratio(above, np.outer(np.sum(np.abs(a) ** 2, axis=1), np.sum(np.abs(x) ** 2, axis=1)))


def db_error(HX: ArrayLike, HA: ArrayLike) -> Array:
    """Difference of level, |20 log10 (|h_A| / |h_X|)| in dB, at each line, response and reference.

    Parameters
    ----------
    HX, HA : array_like of complex, shape (n_f, n_responses, n_references)
        Measured and computed, same quantity and unit.

    Returns
    -------
    ndarray of float, shape (n_f, n_responses, n_references)
        Not negative. 0 if both are zero, inf if one of them is.

    Raises
    ------
    DataError
        As `frac`.
    """
    hx, ha = _check_functions(HX, HA)
    x, a = np.abs(hx), np.abs(ha)
    out = np.full(x.shape, np.inf)
    both = (x > 0) & (a > 0)
    # A difference of logarithms: the quotient of a tiny and a huge number would overflow or
    # underflow.
    out[both] = np.abs(20.0 * (np.log10(a[both]) - np.log10(x[both])))
    out[(x == 0) & (a == 0)] = 0.0
    return out


def _check_functions(
    HX: ArrayLike, HA: ArrayLike, *, same_lines: bool = True
) -> tuple[NumberArray, NumberArray]:
    arrays = []
    for name, given in (("HX", HX), ("HA", HA)):
        array = np.asarray(given, dtype=np.complex128)
        if array.ndim != 3 or 0 in array.shape:
            raise DataError(
                f"{name}: expected (lines, responses, references), found an array of shape"
                f" {array.shape}"
            )
        if not np.isfinite(array).all():
            line, row, column = np.argwhere(~np.isfinite(array))[0]
            raise DataError(
                f"{name}: line {line + 1}, response {row + 1}, reference {column + 1} is not finite"
            )
        arrays.append(array)
    x, a = arrays
    if x.shape[1:] != a.shape[1:] or (same_lines and len(x) != len(a)):
        raise DataError(
            f"HX has shape {x.shape}, HA {a.shape}; expected the same lines, responses and"
            " references"
        )
    return x, a
