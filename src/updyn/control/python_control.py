"""Conversion of a plant to objects of python-control and scipy.signal."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from updyn.control.plant import Plant
from updyn.errors import OptionError

if TYPE_CHECKING:
    import control
    import scipy.signal

__all__ = ["to_control", "to_frd", "to_scipy"]


def to_control(plant: Plant) -> control.StateSpace:
    """Return a plant as a ``StateSpace`` of python-control, with names of inputs and outputs.

    Parameters
    ----------
    plant : Plant
        A continuous or sampled plant.

    Returns
    -------
    control.StateSpace
        ``dt`` is 0 for a continuous plant and the sampling interval in s for a sampled one,
        independent of the default of python-control; no state is removed. python-control permits no
        dots in names: each becomes ``_``.

    Raises
    ------
    OptionError
        If python-control is not installed, or two names differ only by such a dot.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> made = updyn.plant(chain.build(), ["12:X"], ["12:X"], (0.5, 12.0), quantity="mobility")
    >>> system = updyn.to_control(made)
    >>> system.nstates == made.n_states, system.input_labels
    (True, ['12:X'])
    """
    library = _library()
    return library.StateSpace(
        *(np.array(m) for m in (plant.A, plant.B, plant.C, plant.D)),
        remove_useless_states=False,
        **_signals(plant),
    )


def to_frd(plant: Plant, freq: ArrayLike) -> control.FrequencyResponseData:
    """Return the frequency response of a plant as ``FrequencyResponseData`` of python-control.

    Parameters
    ----------
    plant : Plant
        A continuous or sampled plant.
    freq : array_like of float, shape (n_f,)
        Lines in Hz, increasing; rad/s in the result.

    Returns
    -------
    control.FrequencyResponseData
        Of shape (n_outputs, n_inputs, n_f), with names and ``dt`` as in `to_control`.

    Raises
    ------
    OptionError
        If python-control is not installed, or two names differ only by a dot.
    DataError
        If a line is invalid, see `Plant.response`.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> made = updyn.plant(chain.build(), ["12:X"], ["12:X"], (0.5, 12.0), quantity="mobility")
    >>> updyn.to_frd(made, [1.0, 5.0]).frdata.shape  # outputs, inputs, lines
    (1, 1, 2)
    """
    library = _library()
    found = plant.response(freq)
    return library.FrequencyResponseData(
        np.moveaxis(found.values, 0, -1).copy(), 2 * np.pi * found.freq, **_signals(plant)
    )


def to_scipy(plant: Plant) -> scipy.signal.StateSpace:
    """Return a plant as a ``StateSpace`` of scipy.signal, which has no names.

    Parameters
    ----------
    plant : Plant
        A continuous or sampled plant.

    Returns
    -------
    scipy.signal.StateSpace
        An ``lti`` for a continuous plant, a ``dlti`` with ``dt`` in s for a sampled one.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> made = updyn.plant(chain.build(), ["12:X"], ["12:X"], (0.5, 12.0), quantity="mobility")
    >>> updyn.to_scipy(made).A.shape == made.A.shape
    True
    """
    from scipy.signal import StateSpace

    timing = {} if plant.dt is None else {"dt": plant.dt}
    return StateSpace(*(np.array(m) for m in (plant.A, plant.B, plant.C, plant.D)), **timing)


def _library() -> ModuleType:
    try:
        import control
    except ImportError as error:
        raise OptionError('this needs python-control: pip install "updyn[control]"') from error
    module: ModuleType = control
    return module


def _signals(plant: Plant) -> dict[str, object]:
    return {
        "inputs": _names(plant.inputs, "inputs"),
        "outputs": _names(plant.outputs, "outputs"),
        "dt": 0 if plant.dt is None else plant.dt,
    }


def _names(names: Sequence[str], what: str) -> list[str]:
    out = [name.replace(".", "_") for name in names]
    for i, name in enumerate(out):
        if name in out[:i]:
            raise OptionError(
                f"{what} {names[out.index(name)]!r} and {names[i]!r} become the same name in"
                " python-control, which permits no dots in names; rename one of the ports"
            )
    return out
