"""`plant`: a state-space model of a structure with the smallest order that holds a tolerance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from updyn.control.choice import check_route, choose_route
from updyn.control.measured import select_measurement
from updyn.control.options import Ports, check_band, check_error, check_quantities, check_tolerance
from updyn.control.passivity import collocated_channels
from updyn.control.plant import Plant
from updyn.control.ports import Port, as_ports
from updyn.control.rational import SlowMotion
from updyn.control.rational_fit import Approximation
from updyn.control.rational_states import find_fewest_states
from updyn.control.realised import measure_errors, realise
from updyn.control.structure import CompiledStructure
from updyn.control.task import build_task
from updyn.errors import OptionError, ToleranceError
from updyn.frf import FRF, QUANTITIES
from updyn.model import Model
from updyn.updating.result import UpdateResult

__all__ = ["plant"]


def plant(
    model: Model | UpdateResult | FRF,
    inputs: Ports,
    outputs: Ports,
    band: Sequence[float],
    tolerance: float = 0.02,
    *,
    quantity: str | Sequence[str] = "receptance",
    route: str = "auto",
    error: str = "relative",
    tier: str | None = None,
    backend: str | None = None,
) -> Plant:
    """Make a real, causal, stable state-space model of a structure.

    Rigid-body motion is kept exactly. Modes above the band are represented by residual flexibility:
    as feed-through of displacements, as modes above the band for velocities and accelerations.

    Parameters
    ----------
    model : Model or UpdateResult or FRF
        The structure, or an update result (its updated model); or measured FRFs of all DOFs of the
        ports, with variance or coherence if available.
    inputs, outputs : iterable of str, Dof or Port
        Forces and motions: signed DOFs, or ports (several DOFs, gear ratio, names).
    band : (float, float)
        Lowest and highest frequency in Hz at which it must agree with the structure.
    tolerance : float
        Tolerance of the errors selected by `error`.
    quantity : str or sequence of str
        Quantity of all outputs, or of each: ``"receptance"`` (displacements), ``"mobility"``
        (velocities), ``"accelerance"`` (accelerations).
    route : {"auto", "modal", "complex", "rational", "biot"}
        Conversion of structural damping to poles. ``"modal"``: real modes with the full modal
        damping matrix, passive. ``"complex"``: poles and residues of the damped structure, most
        accurate for strong local damping; the outputs are fitted to the structure's response if
        these alone do not hold the tolerance. ``"rational"``: a rational approximation of the
        response with the fewest states; rigid-body motion exact, collocated channels passive.
        ``"biot"``: internal variables, passive, slightly different static stiffness. ``"auto"``:
        modal, or complex if modal does not hold the tolerance; for a relative error rational if it
        needs fewer states.
    error : {"relative", "peak"}
        Error measure of the tolerance. ``"relative"``: the error of a channel as a share of its
        magnitude at each line, which is relevant for a loop; at an antiresonance as a share of the
        magnitude one half-power width away. ``"peak"``: its largest error as a share of its peak in
        the band, and the height of its resonances.
    tier, backend : str, optional
        Solver of the structure's response, as for `updyn.response`; by default exact up to 300
        DOFs, and a reduced model certified to 1e-8 above.

    Returns
    -------
    Plant
        With `relative_error` (or `error` and `peak_error`) within the tolerance, computed from its
        matrices. For a model, ``facts["causal error"]`` is a lower bound on that error for any
        stable plant whose gain outside the band is at most ten times the largest of the structure
        there; 0 without structural damping.

    Raises
    ------
    OptionError
        If an option is invalid; a route that converts the damping at one frequency or by modal
        damping ratios is refused, with the error that it would have.
    ModelError
        If the structure is not statically stable.
    ToleranceError
        If no order holds the tolerance; the message states the error reached, and whether causality
        prevents a smaller one.
    DofError
        If the model lacks a DOF of a port.
    SolverError
        If the structure has no finite response at a line: undamped, at a resonance.

    Notes
    -----
    For measured FRFs the plant is a rational approximation of the data, with the poles of modes
    identified in the band as a start. Differences within three standard deviations of a value count
    as within the tolerance, and errors are relative to this. Rigid-body motion is that of the data.

    Full modal damping matrix: C_rs = phi_r^T D phi_s / sqrt(omega_r omega_s); see
    `updyn.control.real_modes`, `complex_modes` and `biot` for the routes.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> made = updyn.plant(chain.build(), ["12:X"], ["12:X"], (0.5, 12.0), quantity="mobility")
    >>> made.inputs, made.output_units
    (('12:X',), ('m/s',))
    >>> made.relative_error <= made.tolerance
    True
    """
    ports = as_ports(inputs, "input"), as_ports(outputs, "output")
    if isinstance(model, FRF):
        if route not in ("auto", "rational") or error != "relative":
            raise OptionError(
                f"plant: route {route!r}, error {error!r}; a measurement requires route"
                " 'rational' with error 'relative'"
            )
        return _plant_of_measurement(model, ports, band, tolerance, quantity)
    structure = CompiledStructure.of(model)
    check_error(error)
    task, quantities = build_task(structure, *ports, band, quantity, tier, backend, error)
    check_tolerance(tolerance)
    found = choose_route(task, check_route(route, task, error), tolerance)
    realised = realise(task, found, structure.model.title, quantities, tolerance)
    return replace(realised, facts={**realised.facts, "causal error": task.least(found)})


def _plant_of_measurement(
    frf: FRF,
    ports: tuple[tuple[Port, ...], tuple[Port, ...]],
    band: Sequence[float],
    tolerance: float,
    quantity: str | Sequence[str],
) -> Plant:
    limits = check_band(band)
    inputs, outputs = ports
    quantities = check_quantities(quantity, len(outputs))
    check_tolerance(tolerance)
    data = select_measurement(frf, inputs, outputs, quantities, limits)
    target = replace(data.target, reference=data.reference(tolerance))
    powers = np.array([QUANTITIES[q] for q in quantities], dtype=np.intp)
    slow = SlowMotion.none(len(outputs), len(inputs))
    pairs = collocated_channels(outputs, inputs)
    approximation = Approximation(target, slow, powers, data.poles, pairs)
    found = find_fewest_states(approximation, tolerance)
    if not found.holds:
        raise ToleranceError(
            f"plant: no order holds a tolerance of {tolerance:g} from {limits[0]:g} to"
            f" {limits[1]:g} Hz of the measurement; reached: {found.error:.3g}. Allow a larger"
            " tolerance, or narrow the band"
        )
    facts = {
        "title": frf.source,
        "source": "measurement",
        "lines": len(target.freq),
        "error": "relative",
        "noise": data.noise,
    }
    A, B, C, D = found.conversion.matrices(found.mask)
    errors = float(found.errors[1]), float(found.errors[2])
    modes = np.sort(found.conversion.frequency)
    realised = Plant(
        A,
        B,
        C,
        D,
        inputs,
        outputs,
        quantities,
        limits,
        float(tolerance),
        *errors,
        found.conversion.name,
        0,
        modes,
        facts=facts,
    )
    return measure_errors(realised, target)
