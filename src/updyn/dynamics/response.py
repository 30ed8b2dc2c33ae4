"""The frequency response functions of a model."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Literal, overload

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import RealArray
from updyn.dofs import Dof, DofSet
from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.excitation import DrivenSolver, Excitation, find_channels, find_excitation
from updyn.dynamics.fields import FieldSolver, LineSolver, split_into_blocks
from updyn.dynamics.periodic.response import (
    PeriodicResponse,
    SineExcitation,
    respond_at_level,
)
from updyn.dynamics.periodic.settings import BALANCE
from updyn.dynamics.random_response import RandomResponse, respond_at_random
from updyn.dynamics.reduction import Reduction
from updyn.dynamics.settings import REDUCTION
from updyn.errors import OptionError, SolverError, suggest
from updyn.frf import EXCITATIONS, FRF, check_lines
from updyn.linalg.solver import check_backend
from updyn.model import Model

__all__ = ["response", "response_like"]


@overload
def response(
    model: Model,
    freq: ArrayLike,
    responses: Iterable[str | Dof],
    references: Iterable[str | Dof],
    quantity: str = "receptance",
    *,
    tier: str | None = None,
    backend: str | None = None,
    accuracy: float = REDUCTION.accuracy,
    decay: float = 0.0,
    base: Iterable[str | Dof] | None = None,
    force: str | Dof | None = None,
    level: None = None,
    amplitude: None = None,
    harmonics: int = BALANCE.harmonics,
    samples: int = BALANCE.samples,
    sweep: str = "up",
) -> FRF: ...
@overload
def response(
    model: Model,
    freq: ArrayLike,
    responses: Iterable[str | Dof],
    references: Iterable[str | Dof],
    quantity: str = "receptance",
    *,
    tier: str | None = None,
    backend: str | None = None,
    accuracy: float = REDUCTION.accuracy,
    level: float,
    harmonics: int = BALANCE.harmonics,
    samples: int = BALANCE.samples,
    sweep: str = "up",
    excitation: Literal["sine"] = "sine",
) -> PeriodicResponse: ...
@overload
def response(
    model: Model,
    freq: ArrayLike,
    responses: Iterable[str | Dof],
    references: Iterable[str | Dof],
    quantity: str = "receptance",
    *,
    tier: str | None = None,
    backend: str | None = None,
    accuracy: float = REDUCTION.accuracy,
    level: float | None = None,
    excitation: Literal["random"],
    spectrum: ArrayLike | None = None,
) -> RandomResponse: ...
@overload
def response(
    model: Model,
    freq: ArrayLike,
    responses: Iterable[str | Dof],
    references: Iterable[str | Dof],
    quantity: str = "receptance",
    *,
    tier: str | None = None,
    backend: str | None = None,
    accuracy: float = REDUCTION.accuracy,
    amplitude: float,
    control: str | Dof | None = None,
    harmonics: int = BALANCE.harmonics,
    samples: int = BALANCE.samples,
    sweep: str = "up",
) -> PeriodicResponse: ...
def response(
    model: Model,
    freq: ArrayLike,
    responses: Iterable[str | Dof],
    references: Iterable[str | Dof],
    quantity: str = "receptance",
    *,
    tier: str | None = None,
    backend: str | None = None,
    accuracy: float = REDUCTION.accuracy,
    decay: float = 0.0,
    base: Iterable[str | Dof] | None = None,
    force: str | Dof | None = None,
    level: float | None = None,
    amplitude: float | None = None,
    control: str | Dof | None = None,
    harmonics: int = BALANCE.harmonics,
    samples: int = BALANCE.samples,
    sweep: str = "up",
    excitation: str = "sine",
    spectrum: ArrayLike | None = None,
) -> FRF | PeriodicResponse | RandomResponse:
    """Compute frequency response functions exactly, with one full factorisation per line.

    With ``tier="reduced"`` they are computed by a reduced model of proven accuracy. It needs only a
    few real factorisations for any number of lines. With ``level=``, the periodic response of a
    model with nonlinear elements to a force of that amplitude is computed instead, or with
    ``excitation="random"`` its FRFs under a random force of that RMS.

    Parameters
    ----------
    model : Model
        The structure.
    freq : array_like of float, shape (n_f,)
        Lines in Hz, increasing.
    responses, references : iterable of str or Dof
        Signed DOFs of sensors and forces; of a transmissibility, the sensor whose motion divides.
    quantity : {"receptance", "mobility", "accelerance", "transmissibility"}
        Motion over force, or response over the motion of the reference.
    tier : {"dense", "sparse", "reduced"}, optional
        The way of solving; by default an exact tier chosen by size.
    backend : str, optional
        Sparse factorisation.
    accuracy : float
        For the reduced tier, the largest error relative to the largest receptance of its line.
    decay : float
        Rate in 1/s of an exponential window exp(-decay t) on the records. The result is then H at
        i omega + decay.
    base : iterable of str or Dof, optional
        Of a transmissibility: DOFs that move together as the rigid base, the reference among them;
        all other DOFs respond. A sign reverses the motion of a DOF.
    force : str or Dof, optional
        Of a transmissibility without `base`: DOF of the only force.
    level : float, optional
        Force amplitude in N (N m), for models with nonlinear elements: one force after another. Of
        a random force the RMS.
    amplitude : float, optional
        Amplitude of a response instead, as a controller holds it: the first harmonic of `control`,
        in the unit of its quantity, such as m/s2 for an accelerance. The force is sinusoidal; its
        amplitude at each line is `PeriodicResponse.level`. Expects one reference.
    control : str or Dof, optional
        With `amplitude`: the response that is held; by default the first.
    harmonics : int
        With `level` or `amplitude`: the highest harmonic of the balance.
    samples : int
        With `level` or `amplitude`: samples of a period for the forces of elements.
    sweep : {"up", "down"}
        With `level` or `amplitude`: direction of the sweep, which decides between several solutions
        at a line.
    excitation : {"sine", "random"}
        With `level`: a sine, or a Gaussian random force with a constant one-sided spectral density
        in the band of `freq`, level^2 / (freq[-1] - freq[0]) in N^2/Hz, and none outside.
    spectrum : array_like of float, shape (n_s, 2), optional
        Of a random force, in place of `level`: frequencies in Hz and one-sided power spectral
        density in N^2/Hz ((N m)^2/Hz), linear in between and zero outside.

    Returns
    -------
    FRF, PeriodicResponse or RandomResponse
        Values of shape (n_f, n_responses, n_references), in m/N, m/s/N or m/s2/N (rad and N m for
        rotations); a transmissibility has no unit. With `level` or `amplitude`, a
        `PeriodicResponse`: the first harmonic over the force, all harmonics, stability, and all
        branches. With a random force, a `RandomResponse`: the FRFs of the linearised model, and the
        motion, stiffness and damping of each element.

    Raises
    ------
    DataError
        If a line is not finite, negative or out of order, the decay is negative, or a
        transmissibility has no base or force, several references, or a base without its reference.
    DofError
        If a DOF is not in the model.
    ModelError
        If the model has nonlinear elements but there is no level or amplitude, or vice versa.
    OptionError
        If an option cannot be used, or not with a level.
    SolverError
        If the dynamic stiffness is singular at a line, no reduced model of this accuracy was found,
        the periodic response cannot be followed to the last line, or the statistical linearisation
        does not settle.

    Notes
    -----
    H = Z^-1 with Z = K + i D - omega^2 M (Bao, Wang & Cheng 2010, eqs. 2, 3). With base excitation,
    T = -Z_ff^-1 Z_fb d for the free DOFs f and a unit motion d of the base b; with one force at k,
    T_ij = H_ik / H_jk (Maia, Silva & Ribeiro, Mech. Syst. Signal Process. 15 (2001) 129).

    Under a random force each element is replaced by the spring and the damper whose force has the
    least mean-square error for a Gaussian motion with the variances that follow from the FRFs
    (Caughey, J. Acoust. Soc. Am. 35 (1963) 1706; Roberts & Spanos, Random Vibration and Statistical
    Linearization, 1990, chapters 4 and 5). For elements with memory, the motion is assumed to have
    a narrow band.

    Examples
    --------
    >>> import numpy as np
    >>> from updyn.demos import chain
    >>> frf = updyn.response(chain.build(), [1.0, 2.0], ["12:X"], ["1:X"], "accelerance")
    >>> frf.values.shape
    (2, 1, 1)
    >>> model = chain.build().with_elements({"stop": (updyn.CubicSpring(1e9), "12:X")})
    >>> found = updyn.response(model, [1.0, 2.0], ["12:X"], ["1:X"], level=10.0)
    >>> bool(found.stable.all()), found.harmonics.shape
    (True, (2, 8, 1, 1))
    >>> lines = np.linspace(0.5, 20.0, 40)
    >>> options = {"level": 5.0, "excitation": "random"}
    >>> found = updyn.response(model, lines, ["12:X"], ["12:X"], **options)
    >>> found.values.shape, found.stiffness.shape
    ((40, 1, 1), (1, 1))
    """
    if excitation != "sine":
        _check_random(excitation, level, spectrum, (amplitude, control, base, force), decay)
        if (harmonics, samples, sweep) != (BALANCE.harmonics, BALANCE.samples, "up"):
            raise OptionError(
                "excitation: expected no harmonics, samples or sweep; they are of a sine"
            )
        return respond_at_random(
            model,
            freq,
            responses,
            references,
            level,
            spectrum,
            quantity,
            tier=tier,
            backend=backend,
            accuracy=accuracy,
        )
    if spectrum is not None:
        raise OptionError(
            'spectrum: of a random force; expected excitation="random" with it', key=("spectrum",)
        )
    if level is not None or amplitude is not None:
        sine = _choose_excitation(level, amplitude, control)
        if decay or base is not None or force is not None:
            raise OptionError(
                f"{sine.name}: expected no decay, base or force; they are of linear FRFs"
            )
        return respond_at_level(
            model,
            freq,
            responses,
            references,
            sine,
            quantity,
            harmonics=harmonics,
            samples=samples,
            sweep=sweep,
            tier=tier,
            backend=backend,
            accuracy=accuracy,
        )
    lines = check_lines(np.atleast_1d(freq) if np.isscalar(freq) else freq)
    rows, columns = DofSet(responses), DofSet(references)
    zeros = np.zeros((len(lines), len(rows), len(columns)))
    like = FRF(lines, zeros, rows, columns, quantity, decay=decay, base=base, force=force)
    return response_like(model, like, tier=tier, backend=backend, accuracy=accuracy)


def _check_random(
    excitation: object, level: object, spectrum: object, others: tuple[object, ...], decay: float
) -> None:
    """Raise OptionError for an unknown excitation, or options that a random force cannot have."""
    if excitation not in EXCITATIONS:
        raise OptionError(
            f"excitation {excitation!r}: {suggest(str(excitation), EXCITATIONS)}",
            key=("excitation",),
        )
    if level is None and spectrum is None:
        raise OptionError(
            f"excitation {excitation!r}: of a level; expected level=, the RMS of the force in N, or"
            " its spectrum=",
            key=("excitation",),
        )
    if decay or any(other is not None for other in others):
        raise OptionError(
            f"excitation {excitation!r}: expected no amplitude, control, decay, base or force"
        )


def _choose_excitation(
    level: float | None, amplitude: float | None, control: str | Dof | None
) -> SineExcitation:
    """Return the excitation by a level or by an amplitude; OptionError if both are stated."""
    if level is None:
        assert amplitude is not None
        return SineExcitation(amplitude, True, control)
    if amplitude is not None:
        raise OptionError("level and amplitude are stated; expected one of the two")
    if control is not None:
        raise OptionError(
            "control: of a response that is held at an amplitude; expected amplitude= with it",
            key=("control",),
        )
    return SineExcitation(level)


def response_like(
    model: Model,
    frf: FRF,
    freq: RealArray | None = None,
    *,
    tier: str | None = None,
    backend: str | None = None,
    accuracy: float = REDUCTION.accuracy,
) -> FRF:
    """Return the FRF of a model in the channels, quantity and excitation of a measurement.

    `freq` are other lines than those of the measurement, in Hz. Options and errors are those of
    `response`.
    """
    lines = frf.freq if freq is None else check_lines(freq)
    blank = np.zeros((len(lines), *frf.values.shape[1:]))
    frf = frf.with_level(None)
    frf = replace(frf, freq=lines, values=blank, coherence=None, variance=None, averages=None)
    model.dofs.match(frf.references, "reference")
    system = AffineSystem.compile(model).with_decay(frf.decay)
    solver, source = _solver(system, frf, tier, backend, accuracy)
    channels = find_channels(solver, frf)
    # By symmetry, the forces can act on the side with fewer DOFs.
    loaded, read = channels.columns, channels.rows
    swap = len(read) < len(loaded)
    if swap:
        loaded, read = read, loaded
    values = np.empty(frf.values.shape, dtype=np.complex128)
    omega, start = 2.0 * np.pi * lines, solver.system.start
    pencil = solver.pencil(start, lines)
    if pencil is not None and tier != "reduced":  # a reduced model has larger errors
        pencil = replace(pencil, refines=True)
    for block in split_into_blocks(len(lines), solver.block_size(len(loaded))):
        c = solver.system.coefficients(start, omega[block])
        X = solver.solve(c, loaded, lines[block], pencil)
        X = solver.at(X, read).transpose(1, 0, 2)
        if swap:
            X = X.transpose(0, 2, 1)
        values[block] = X
    values *= channels.sign
    values *= (frf.s**frf.power)[:, None, None]
    return replace(
        frf,
        values=values,
        geometry=model.geometry,
        source=source,
    )


def _solver(
    system: AffineSystem,
    frf: FRF,
    tier: str | None,
    backend: str | None,
    accuracy: float,
) -> tuple[FieldSolver, str]:
    """Return the solver, and a description of it as the source of the FRF."""
    excitation = find_excitation(system.dofs, frf)
    if excitation is not None:
        system = excitation.hold(system, float(frf.freq[-1]))
    if tier == "reduced":
        solver, source = _reduce(system, frf, excitation, backend, accuracy)
    else:
        solver, source = LineSolver.choose(system, tier, backend), "model"
    return (solver if excitation is None else DrivenSolver(solver, excitation)), source


def _reduce(
    system: AffineSystem,
    frf: FRF,
    excitation: Excitation | None,
    backend: str | None,
    accuracy: float,
) -> tuple[FieldSolver, str]:
    """Return the solver of a reduced model, and its description."""
    rows, columns = (system.dofs.match(dofs).index for dofs in (frf.responses, frf.references))
    if excitation is not None:
        rows, columns = np.union1d(rows, excitation.moved), excitation.forced
    band = float(frf.freq[0]), float(frf.freq[-1])
    reduction = Reduction(system, rows, columns, band, check_backend(backend), accuracy)
    reduction.build(system.start)
    largest = 1.0
    if excitation is not None:  # a ratio multiplies the error of a receptance
        solver = DrivenSolver(reduction.solver(), excitation)
        c = system.coefficients(system.start, 2.0 * np.pi * frf.freq)
        T = solver.at(solver.solve(c, solver.drive, frf.freq), rows)
        largest = max(largest, float(np.abs(T).max()))
        reduction.accuracy /= largest
    found = reduction.certify(system.start, frf.freq)
    error = largest * found.error
    if error > accuracy:
        raise SolverError(
            f"tier 'reduced': {found.size} basis vectors reach an error of {error:.1g} of the"
            f" largest receptance of a line, not {accuracy:g}; use tier 'sparse', or a larger"
            " accuracy="
        )
    return (
        reduction.solver(),
        f"model, reduced to {found.size} basis vectors, error at most {error:.1g}",
    )
