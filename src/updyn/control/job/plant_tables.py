"""Tables of a job file about control: ``[plant]``, what is handed to the servo designer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import PurePath
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, Strict, model_validator

from updyn.control.ports import Port
from updyn.errors import nearest, suggest
from updyn.frf import QUANTITIES
from updyn.job.schema import Pair, Table

__all__ = ["PLANT_FILES", "PLANT_SUFFIXES", "PlantTable", "PortTable", "SamplingTable"]

#: What a plant is written to where the job does not say, and the suffixes that there are.
PLANT_FILES = ("plant.mat", "plant.json", "plant.h")
PLANT_SUFFIXES = (".mat", ".json", ".h", ".npz")
#: Files of the folder that no plant may replace.
_TAKEN = ("control.json", "result.json", "compare.json")


def _quantities(given: Any) -> Any:
    names = [given] if isinstance(given, str) else given
    if (
        not isinstance(names, list | tuple)
        or not names
        or not all(isinstance(n, str) for n in names)
    ):
        raise ValueError(
            f"expected one of {', '.join(map(repr, QUANTITIES))}, or an array with one for each"
            " output"
        )
    for name in names:
        if name not in QUANTITIES:
            raise ValueError(
                suggest(name, QUANTITIES)
                if given == name
                else f"{name!r}: {suggest(name, QUANTITIES)}"
            )
    return given if isinstance(given, str) else tuple(names)


def _ports(what: str) -> Callable[[Any], Any]:
    """Return what turns labels and tables into tables of ports, and one of them into an array of one."""

    def several(given: Any) -> Any:
        items = [given] if isinstance(given, str | Mapping) else given
        if not isinstance(items, list | tuple) or not items:
            raise ValueError(
                f"expected {what}: labels such as '1:RZ', or tables {{ name = ..., dof = ... }}"
            )
        return tuple({"dof": item} if isinstance(item, str) else item for item in items)

    return several


def _files(given: Any) -> Any:
    names = [given] if isinstance(given, str) else given
    if not isinstance(names, list | tuple) or not all(isinstance(n, str) for n in names):
        raise ValueError("expected names of files, such as ['plant.mat', 'plant.h']")
    for name in names:
        suffix = PurePath(name).suffix.lower()
        if PurePath(name).name != name or name in _TAKEN:
            raise ValueError(f"{name!r}: expected the name of a file of its own, without a folder")
        if suffix not in PLANT_SUFFIXES:
            said = (
                f"did you mean {close[0]!r}?" if (close := nearest(suffix, PLANT_SUFFIXES)) else ""
            )
            raise ValueError(
                f"{name!r}: its suffix says the format: {', '.join(PLANT_SUFFIXES)}; {said}".rstrip(
                    "; "
                )
            )
    if len({name.casefold() for name in names}) < len(names):
        raise ValueError("a file stands twice")
    return tuple(names)


class PortTable(Table):
    """An input or output of the plant: one DOF, geared where there is a ratio; or weights by DOF, with a name."""

    name: str | None = None
    dof: str | None = None
    ratio: float | None = None
    weights: dict[str, float] | None = None
    rotation: bool | None = None

    @model_validator(mode="after")
    def _valid(self) -> PortTable:
        if (self.dof is None) == (self.weights is None):
            raise ValueError("expected dof, or weights by DOF; one of the two")
        if self.weights is not None and self.name is None:
            raise ValueError("weights without a name; give the port one")
        if self.dof is not None and self.rotation is not None:
            raise ValueError("rotation belongs to weights; a DOF says itself what it is")
        if self.ratio is not None and self.dof is None:
            raise ValueError("ratio belongs to dof; put it into the weights")
        self.port()
        return self

    def port(self) -> Port:
        """Return the port.

        Returns
        -------
        Port

        Raises
        ------
        InputError
            If a label or a number cannot be used.
        """
        if self.weights is not None:
            assert self.name is not None
            return Port(self.name, self.weights, self.rotation)
        assert self.dof is not None
        if self.ratio is not None:
            return Port.geared(self.dof, self.ratio, self.name)
        return Port.at(self.dof, self.name)


class SamplingTable(Table):
    """``sampling`` of ``[plant]``: the same plant behind a hold, for a digital controller."""

    dt: float = Field(gt=0)
    method: Literal["zoh", "tustin"] = "zoh"
    delay: float = Field(default=0.0, ge=0)


class PlantTable(Table):
    """``[plant]``: inputs, outputs and band of the plant, how exact it has to be, and where it is written to."""

    inputs: Annotated[tuple[PortTable, ...], BeforeValidator(_ports("inputs")), Strict(False)] = (
        Field(min_length=1)
    )
    outputs: Annotated[tuple[PortTable, ...], BeforeValidator(_ports("outputs")), Strict(False)] = (
        Field(min_length=1)
    )
    quantity: Annotated[str | tuple[str, ...], BeforeValidator(_quantities)] = "receptance"
    band: Pair | None = None
    tolerance: float = Field(default=0.02, ge=1e-9, le=0.5)
    route: Literal["auto", "modal", "complex", "biot"] = "auto"
    family: int = Field(default=0, ge=0)
    seed: int = Field(default=0, ge=0)
    sampling: SamplingTable | None = None
    files: Annotated[tuple[str, ...], BeforeValidator(_files)] = PLANT_FILES
    test: str | None = None

    @property
    def input_ports(self) -> tuple[Port, ...]:
        """The inputs."""
        return tuple(table.port() for table in self.inputs)

    @property
    def output_ports(self) -> tuple[Port, ...]:
        """The outputs."""
        return tuple(table.port() for table in self.outputs)

    @property
    def quantities(self) -> tuple[str, ...]:
        """What each output is."""
        return (
            (self.quantity,) * len(self.outputs)
            if isinstance(self.quantity, str)
            else self.quantity
        )

    @property
    def sampled_files(self) -> tuple[str, ...]:
        """Names of the files of the sampled plant; empty where none is asked for."""
        if self.sampling is None:
            return ()
        return tuple(f"{PurePath(n).stem}-sampled{PurePath(n).suffix}" for n in self.files)
