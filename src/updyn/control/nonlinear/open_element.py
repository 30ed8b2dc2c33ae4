"""`open_element`: a model without one nonlinear element, and the port at which it acts."""

from __future__ import annotations

from dataclasses import dataclass, replace

from updyn.control.ports import Port
from updyn.dofs import Dof
from updyn.errors import ModelError, OptionError, suggest
from updyn.model import Model
from updyn.nonlinear.element import NonlinearElement
from updyn.uncertainty.gaussian import draw_normal, draw_values, name_undetermined
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["OpenElement", "open_element"]


@dataclass(frozen=True, slots=True, eq=False)
class OpenElement:
    """A model without a nonlinear element, the port at which this acts, and the element.

    `port` is both an input (the force of the element) and an output (its deformation or velocity)
    of the plant. Other nonlinear elements stay in `model`. `members` are the same at draws of the
    unknowns of an update from their covariance, for the intervals of `limit_cycles`.
    """

    model: Model
    port: Port
    element: NonlinearElement
    members: tuple[OpenElement, ...] = ()


def open_element(
    model: Model | UpdateResult | JointResult,
    element: str,
    *,
    name: str = "gap",
    n: int = 0,
    seed: int = 0,
) -> OpenElement:
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
    model : Model, UpdateResult or JointResult
        The structure, or an update result of it with the estimated parameters of its elements.
    element : str
        Name of the nonlinear element.
    name : str
        Name of the port.
    n : int
        Number of members: draws of the unknowns of an update from their covariance.
    seed : int
        Seed of the draws; member i does not depend on `n`.

    Returns
    -------
    OpenElement
        ``model``, ``port``, ``element`` and ``members``.

    Raises
    ------
    ModelError
        If the model has no such element.
    OptionError
        If `model` is of another type, the tests of an update have several models, or members are
        wanted without an update that determines all unknowns.

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
    if isinstance(model, Model):
        if n:
            raise OptionError(f"open_element: n = {n}: members need an update; expected its result")
        return _open(model, element, name)
    if not isinstance(model, UpdateResult | JointResult):
        raise OptionError(
            f"open_element: expected a Model or an UpdateResult, found {type(model).__name__}"
        )
    result = model.first
    if any(one.start is not result.start for one in model.results.values()):
        raise OptionError(
            "open_element: the tests have several models; expected the result of one of them"
        )
    members = [_open(one, element, name) for one in _draw_models(result, n, seed)]
    return replace(_open(result.model, element, name), members=tuple(members))


def _draw_models(result: UpdateResult, n: int, seed: int) -> list[Model]:
    """Return the models at draws of the unknowns."""
    if isinstance(n, bool) or not isinstance(n, int) or n < 0:
        raise OptionError(f"open_element: n = {n!r}; expected a number of members from 0 up")
    unsure = name_undetermined(result)
    if n and unsure:
        raise OptionError(
            f"open_element: the data do not determine {unsure}, so members cannot be drawn."
            f" {result.identifiability.advice}"
        )
    values, _ = draw_values(result, draw_normal(len(result.parameters), n, seed))
    return [result.parameters.apply(result.start, row) for row in values]


def _open(given: Model, element: str, name: str) -> OpenElement:
    """Return a model without an element, its port and the element."""
    if element not in given.nonlinear:
        known = suggest(str(element), given.nonlinear) if given.nonlinear else "there is none"
        raise ModelError(f"nonlinear element {element!r}: not in the model; {known}")
    local = given.nonlinear[element]
    others = {key: value for key, value in given.nonlinear.items() if key != element}
    turns = all(Dof.parse(label).direction.startswith("R") for label in local.weights)
    port = Port(name, dict(local.weights), rotation=turns)
    return OpenElement(replace(given, nonlinear=others), port, local.element)
