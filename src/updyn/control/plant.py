"""`Plant`: a real state-space model of a structure for control design. Pure data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import ComplexArray, NumberArray, RealArray
from updyn.control.antiresonances import ZeroShift
from updyn.control.ports import Port, find_index
from updyn.errors import DataError, ModelError
from updyn.frf import FRF, check_force_quantity, check_lines
from updyn.notebook import PlotCurve, card, curves, table

__all__ = ["Plant", "PlantResponse"]


#: Number of channels in a notebook, and of lines of their curves.
_DRAWN, _DRAWN_LINES = 8, 300


@dataclass(frozen=True, slots=True, eq=False)
class PlantResponse:
    """The frequency response of a plant at lines in Hz, values (n_f, n_outputs, n_inputs)."""

    freq: RealArray
    values: ComplexArray
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NumberArray:
        return np.array(self.values, dtype=dtype, copy=copy)

    def __getitem__(self, item: Any) -> Any:
        """Return part of the values, as of an array."""
        return self.values[item]

    def frf(self, quantity: str = "receptance") -> FRF:
        """Return the response as an `FRF`; raises DofError if a name is not the label of a DOF."""
        return FRF(self.freq, self.values, self.outputs, self.inputs, quantity, source="plant")


@dataclass(frozen=True, slots=True, eq=False)
class Plant:
    """A real, causal, stable state-space model, with rigid-body motion as poles at 0.

        x' = A x + B u,   y = C x + D u            (with `dt`: x[k+1] = A x[k] + B u[k])

    Attributes
    ----------
    A, B, C, D : ndarray of float, shapes (n, n), (n, n_u), (n_y, n), (n_y, n_u)
        In SI units, time in s.
    input_ports, output_ports : tuple of Port
        The ports of u and y.
    quantities : tuple of str
        Quantity of each output: ``"receptance"`` (a displacement), ``"mobility"`` (a velocity) or
        ``"accelerance"``.
    band : (float, float)
        Frequency range of the plant in Hz.
    tolerance : float
        Tolerance of `relative_error`; if ``facts["error"]`` is ``"peak"``, and in plants of earlier
        versions, of `error` and `peak_error`.
    error : float
        Largest error of a channel in the band, as a share of its peak, relative to the model with
        its structural damping.
    peak_error : float
        Largest relative error of the height of a resonance in the band, from a tenth of the
        channel's peak up; if rigid-body motion hides resonances, `facts` contain this error for the
        accelerations.
    route : str
        Conversion of the damping.
    rigid : int
        Number of rigid-body modes.
    modes : ndarray of float, shape (n_modes,)
        Natural frequencies of its modes in Hz, ascending.
    dt : float or None
        Sampling interval in s; None for a continuous plant.
    delay : int
        Delay of the input of a sampled plant in intervals, with its states in A.
    facts : dict
        Provenance.
    relative_error : float
        Largest error of a channel in the band as a share of its magnitude at each line, |dH| / |H|;
        at an antiresonance as a share of the magnitude one half-power width away. nan for a plant
        in a file of an earlier version.
    zero_shift : tuple of ZeroShift
        The antiresonances of each channel in the band: shift in percent, and depths in dB.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> made = updyn.plant(chain.build(), ["12:X"], ["12:X"], (0.5, 12.0), quantity="mobility")
    >>> made.A.shape == (made.n_states, made.n_states)
    True
    >>> made.at(2j * 3.14 * 5.0).shape  # one line, outputs, inputs
    (1, 1, 1)
    """

    A: RealArray
    B: RealArray
    C: RealArray
    D: RealArray
    input_ports: tuple[Port, ...]
    output_ports: tuple[Port, ...]
    quantities: tuple[str, ...]
    band: tuple[float, float]
    tolerance: float
    error: float
    peak_error: float
    route: str
    rigid: int = 0
    modes: RealArray = field(default_factory=lambda: np.zeros(0))
    dt: float | None = None
    delay: int = 0
    facts: Mapping[str, Any] = field(default_factory=dict)
    relative_error: float = float("nan")
    zero_shift: tuple[ZeroShift, ...] = ()

    def __post_init__(self) -> None:
        n, n_u, n_y = len(self.A), len(self.input_ports), len(self.output_ports)
        for name, shape in (
            ("A", (n, n)),
            ("B", (n, n_u)),
            ("C", (n_y, n)),
            ("D", (n_y, n_u)),
            ("modes", None),
        ):
            array = np.array(getattr(self, name), dtype=np.float64)
            if shape is not None and array.shape != shape:
                raise ModelError(f"plant: {name} has shape {array.shape}; expected {shape}")
            if not np.isfinite(array).all():
                raise ModelError(f"plant: {name} contains a number that is not finite")
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if len(self.quantities) != n_y:
            raise ModelError(f"plant: {len(self.quantities)} quantities for {n_y} outputs")
        for quantity in self.quantities:
            check_force_quantity(quantity)
        if self.dt is not None and not 0.0 < self.dt < np.inf:
            raise ModelError(
                f"plant: sampling interval {self.dt!r} s; expected a finite number above 0, or None"
            )

    def __repr__(self) -> str:
        sampled = "" if self.dt is None else f", sampled every {self.dt:g} s"
        error = f"error {self.error:.2g}"
        if not np.isnan(self.relative_error):
            error = f"relative error {self.relative_error:.2g}"
        return (
            f"Plant({self.n_states} states, {len(self.inputs)} inputs, {len(self.outputs)} outputs,"
            f" {error} from {self.band[0]:g} to {self.band[1]:g} Hz{sampled})"
        )

    def _repr_html_(self) -> str:
        rows = [
            ("input", p.name, unit)
            for p, unit in zip(self.input_ports, self.input_units, strict=True)
        ]
        rows += [
            ("output", p.name, unit)
            for p, unit in zip(self.output_ports, self.output_units, strict=True)
        ]
        facts = {
            "states": self.n_states,
            "rigid-body modes": self.rigid or "",
            "band": f"{self.band[0]:g} to {self.band[1]:g} Hz",
            "largest error": self._largest_error(),
            "route": self.route,
            "sampled every": "" if self.dt is None else f"{self.dt:g} s",
        }
        ports = table(("", "name", "unit"), rows, left=(0, 1, 2))
        return card("Plant", facts, self._picture(), ports)

    def _largest_error(self) -> str:
        of_peak = f"{100.0 * self.error:.2g} % of the peak"
        if np.isnan(self.relative_error):
            return of_peak
        return f"{100.0 * self.relative_error:.2g} % of |H| at each line, {of_peak}"

    def _picture(self) -> str:
        """Return the magnitudes over the band as a picture, limited to a number of channels."""
        top = self.band[1] if self.dt is None else min(self.band[1], 0.5 / self.dt)
        low = max(self.band[0], 1e-3 * top)
        in_band = self.modes[(self.modes > low) & (self.modes < top)]
        freq = np.unique(np.concatenate([np.geomspace(low, top, _DRAWN_LINES), in_band]))
        try:
            values = self.response(freq).values
        except DataError:  # a pole on a line
            return ""
        pairs = list(np.ndindex(values.shape[1:]))
        shown = [
            PlotCurve(f"{self.outputs[i]} / {self.inputs[j]}", np.abs(values[:, i, j]))
            for i, j in pairs
        ]
        title = "magnitude (output over input, in their units)"
        if len(pairs) > _DRAWN:
            title += f": {_DRAWN} of {len(pairs)} channels"
            shown = shown[:_DRAWN]
        return curves(freq, shown, ("frequency (Hz)", title), log_x=True)

    @property
    def n_states(self) -> int:
        """Order n."""
        return len(self.A)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return tuple(p.name for p in self.input_ports)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(p.name for p in self.output_ports)

    @property
    def input_units(self) -> tuple[str, ...]:
        """Units of the inputs."""
        return tuple(p.force_unit for p in self.input_ports)

    @property
    def output_units(self) -> tuple[str, ...]:
        """Units of the outputs."""
        return tuple(
            p.motion_unit(q) for p, q in zip(self.output_ports, self.quantities, strict=True)
        )

    @property
    def poles(self) -> ComplexArray:
        """Eigenvalues of A, shape (n,), in rad/s (z if sampled); 0 (1) for rigid-body motion."""
        return np.asarray(np.linalg.eigvals(self.A), dtype=np.complex128)

    def response(self, freq: ArrayLike) -> PlantResponse:
        """Compute the frequency response.

        Parameters
        ----------
        freq : array_like of float, shape (n_f,)
            Lines in Hz, increasing; for a sampled plant at most half the sampling rate.

        Returns
        -------
        PlantResponse

        Raises
        ------
        DataError
            If a line is negative, not finite, out of order, above half the sampling rate, or on a
            pole, such as 0 Hz with rigid-body motion.
        """
        lines = check_lines(np.atleast_1d(np.asarray(freq)))
        if self.dt is not None and lines[-1] > 0.5 / self.dt * (1 + 1e-12):
            raise DataError(
                f"line {lines[-1]:g} Hz lies above half the sampling rate of the plant,"
                f" {0.5 / self.dt:g} Hz"
            )
        points = 2j * np.pi * lines
        if self.dt is not None:
            points = np.exp(points * self.dt)
        return PlantResponse(lines, self.at(points), self.outputs, self.inputs)

    def at(self, s: ArrayLike) -> ComplexArray:
        """Return C (s I - A)^-1 B + D.

        Parameters
        ----------
        s : array_like of complex, shape (n_f,)
            Points in rad/s (z for a sampled plant).

        Returns
        -------
        ndarray of complex, shape (n_f, n_outputs, n_inputs)

        Raises
        ------
        DataError
            If one of them is a pole.
        """
        points = np.atleast_1d(np.asarray(s, dtype=np.complex128))
        out = np.empty((len(points), len(self.C), self.B.shape[1]), dtype=np.complex128)
        eye = np.eye(self.n_states)
        for i, point in enumerate(points):
            try:
                out[i] = self.C @ np.linalg.solve(point * eye - self.A, self.B) + self.D
            except np.linalg.LinAlgError as error:
                raise DataError(
                    f"the plant has a pole at s = {point:.6g}: its response is not finite"
                ) from error
        return out

    def channel(self, output: str, input: str) -> Plant:
        """Return the plant between one input and one output, with all states.

        Parameters
        ----------
        output, input : str
            Names.

        Returns
        -------
        Plant

        Raises
        ------
        OptionError
            If a name is unknown; the nearest is named.
        """
        i = find_index(output, self.outputs, "output")
        j = find_index(input, self.inputs, "input")
        return replace(
            self,
            B=self.B[:, [j]],
            C=self.C[[i]],
            D=self.D[[i]][:, [j]],
            input_ports=(self.input_ports[j],),
            output_ports=(self.output_ports[i],),
            quantities=(self.quantities[i],),
            zero_shift=tuple(z for z in self.zero_shift if (z.output, z.input) == (output, input)),
        )
