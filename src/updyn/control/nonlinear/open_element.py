"""`open_element`: a model without one nonlinear element, and the port at which it acts."""

from __future__ import annotations

from dataclasses import dataclass, replace

from updyn.control.ports import Port
from updyn.dofs import Dof
from updyn.errors import ModelError, OptionError, suggest
from updyn.model import Model
from updyn.nonlinear.element import NonlinearElement
from updyn.updating.result import UpdateResult

__all__ = ["OpenElement", "open_element"]


@dataclass(frozen=True, slots=True, eq=False)
class OpenElement:
    """A model without a nonlinear element, the port at which this acts, and the element.

    `port` is both an input (the force of the element) and an output (its deformation or velocity)
    of the plant. Other nonlinear elements stay in `model`.
    """

    model: Model
    port: Port
    element: NonlinearElement


def open_element(model: Model | UpdateResult, element: str, *, name: str = "gap") -> OpenElement:
    """Return a model without one nonlinear element, and the port at which it acts.

    An identified element acts in the loop of a servo through this port::

        mesh = updyn.open_element(result, "mesh")
        plant = updyn.plant(
            mesh.model,
            ["1:RZ", mesh.port],
            [Port.at("1:RZ", "speed"), "7:RZ", mesh.port],
            band,
            quantity=["mobility", "receptance", "receptance"],
        )
        cycles = updyn.limit_cycles(plant, controller, mesh.element, "gap")

    Parameters
    ----------
    model : Model or UpdateResult
        The structure, or an update result of it with the estimated parameters of its elements.
    element : str
        Name of the nonlinear element.
    name : str
        Name of the port.

    Returns
    -------
    OpenElement
        ``model``, ``port`` and ``element``.

    Raises
    ------
    ModelError
        If the model has no such element.
    OptionError
        If `model` is of another type.

    See Also
    --------
    updyn.opened : The same of a linear mesh, which gets a gap.
    updyn.limit_cycles : Limit cycles of a loop with the element.
    updyn.simulate : The loop in time.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> gap = updyn.Backlash(1e6, gap=1e-4)
    >>> model = chain.build().with_elements({"stop": (gap, ["11:X", "12:X"])})
    >>> found = updyn.open_element(model, "stop")
    >>> found.port.name, dict(found.port.weights), found.element == gap, found.model.nonlinear
    ('gap', {'11:X': 1.0, '12:X': -1.0}, True, mappingproxy({}))
    """
    given = model.model if isinstance(model, UpdateResult) else model
    if not isinstance(given, Model):
        raise OptionError(
            f"open_element: expected a Model or an UpdateResult, found {type(model).__name__}"
        )
    if element not in given.nonlinear:
        known = suggest(str(element), given.nonlinear) if given.nonlinear else "there is none"
        raise ModelError(f"nonlinear element {element!r}: not in the model; {known}")
    local = given.nonlinear[element]
    others = {key: value for key, value in given.nonlinear.items() if key != element}
    turns = all(Dof.parse(label).direction.startswith("R") for label in local.weights)
    port = Port(name, dict(local.weights), rotation=turns)
    return OpenElement(replace(given, nonlinear=others), port, local.element)
