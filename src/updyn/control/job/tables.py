"""Control tables of a job file: ``[plant]`` and ``[servo]``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import PurePath
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, Strict, model_validator

from updyn.control.plant import Plant
from updyn.control.ports import Port
from updyn.control.servo.controller import Controller, Notch
from updyn.control.servo.wind import Wind
from updyn.errors import OptionError, nearest, suggest
from updyn.frf import QUANTITIES
from updyn.job.schema import Pair, Table, tables_of
from updyn.outputs.manifest import MANIFEST

__all__ = [
    "PLANT_FILES",
    "PLANT_SUFFIXES",
    "ControllerTable",
    "NonlinearTable",
    "NotchTable",
    "PlantTable",
    "PortTable",
    "SamplingTable",
    "ServoTable",
    "WindTable",
]

#: Default files of a plant.
PLANT_FILES = ("plant.mat", "plant.json", "plant.h")
#: Suffixes of plant files.
PLANT_SUFFIXES = (".mat", ".json", ".h", ".npz")
#: File names that a plant may not use.
_TAKEN = ("control.json", "result.json", "compare.json", MANIFEST)
#: Keys of the rule that sizes the controller.
_RULE = ("crossover", "ti_ratio", "kv_ratio")


def _texts(given: object) -> list[str]:
    """Return a text or an array of texts as a list; an empty list for other values."""
    if isinstance(given, str):
        return [given]
    if isinstance(given, list | tuple) and all(isinstance(text, str) for text in given):
        return list(given)
    return []


def _quantities(given: object) -> object:
    names = _texts(given)
    if not names:
        raise ValueError(
            f"expected one of {', '.join(map(repr, QUANTITIES))}, or an array with one for each"
            " output"
        )
    for name in names:
        if name not in QUANTITIES:
            which = "" if given == name else f"{name!r}: "
            raise ValueError(which + suggest(name, QUANTITIES))
    if isinstance(given, str):
        return given
    return tuple(names)


def _ports(what: str) -> Callable[[object], object]:
    """Return a validator that converts labels and tables, or one of them, to tables of ports."""

    def several(given: object) -> object:
        items = [given] if isinstance(given, str | Mapping) else given
        if not isinstance(items, list | tuple) or not items:
            raise ValueError(
                f"expected {what}: labels such as '1:RZ', or tables {{ name = ..., dof = ... }}"
            )
        return tuple({"dof": item} if isinstance(item, str) else item for item in items)

    return several


def _files(given: object) -> object:
    names = _texts(given)
    if not names and given not in ([], ()):
        raise ValueError("expected names of files, such as ['plant.mat', 'plant.h']")
    for name in names:
        suffix = PurePath(name).suffix.lower()
        if PurePath(name).name != name or name in _TAKEN:
            raise ValueError(f"{name!r}: expected the name of another file, without a folder")
        if suffix not in PLANT_SUFFIXES:
            message = f"{name!r}: expected one of the suffixes {', '.join(PLANT_SUFFIXES)}"
            close = nearest(suffix, PLANT_SUFFIXES)
            if close:
                message += f"; did you mean {close[0]!r}?"
            raise ValueError(message)
    if len({name.casefold() for name in names}) < len(names):
        raise ValueError("two of the files have the same name")
    return tuple(names)


class PortTable(Table):
    """An input or output of the plant: a DOF with an optional gear ratio, or weights by DOF."""

    name: str | None = None
    dof: str | None = None
    ratio: float | None = None
    weights: dict[str, float] | None = None
    rotation: bool | None = None

    @model_validator(mode="after")
    def _valid(self) -> PortTable:
        if (self.dof is None) == (self.weights is None):
            raise ValueError("expected either dof or weights by DOF")
        if self.weights is not None and self.name is None:
            raise ValueError("weights without a name; give the port a name")
        if self.dof is not None and self.rotation is not None:
            raise ValueError("rotation belongs to weights; the label of a DOF implies it")
        if self.ratio is not None and self.dof is None:
            raise ValueError("ratio belongs to dof; include it in the weights")
        self.port()
        return self

    def port(self) -> Port:
        """Return the port; raises InputError for an invalid label or number."""
        if self.weights is not None:
            assert self.name is not None
            return Port(self.name, self.weights, self.rotation)
        assert self.dof is not None
        if self.ratio is not None:
            return Port.geared(self.dof, self.ratio, self.name)
        return Port.at(self.dof, self.name)


class SamplingTable(Table):
    """``sampling`` of ``[plant]``: the plant with a hold, for a digital controller."""

    dt: float = Field(gt=0)
    method: Literal["zoh", "tustin"] = "zoh"
    delay: float = Field(default=0.0, ge=0)


class PlantTable(Table):
    """``[plant]``: inputs, outputs, band, tolerance and files of the plant."""

    inputs: Annotated[tuple[PortTable, ...], BeforeValidator(_ports("inputs")), Strict(False)] = (
        Field(min_length=1)
    )
    outputs: Annotated[tuple[PortTable, ...], BeforeValidator(_ports("outputs")), Strict(False)] = (
        Field(min_length=1)
    )
    quantity: Annotated[str | tuple[str, ...], BeforeValidator(_quantities)] = "receptance"
    band: Pair | None = None
    tolerance: float = Field(default=0.02, ge=1e-9, le=0.5)
    error: Literal["relative", "peak"] = "relative"
    route: Literal["auto", "modal", "complex", "rational", "biot"] = "auto"
    family: int = Field(default=0, ge=0)
    seed: int = Field(default=0, ge=0)
    sampling: SamplingTable | None = None
    files: Annotated[tuple[str, ...], BeforeValidator(_files)] = PLANT_FILES
    test: str | None = None

    @property
    def input_ports(self) -> tuple[Port, ...]:
        """The input ports."""
        return tuple(table.port() for table in self.inputs)

    @property
    def output_ports(self) -> tuple[Port, ...]:
        """The output ports."""
        return tuple(table.port() for table in self.outputs)

    @property
    def quantities(self) -> tuple[str, ...]:
        """The quantity of each output."""
        if isinstance(self.quantity, str):
            return (self.quantity,) * len(self.outputs)
        return self.quantity

    @property
    def sampled_files(self) -> tuple[str, ...]:
        """Names of the files of the sampled plant; empty without one."""
        if self.sampling is None:
            return ()
        return tuple(f"{PurePath(n).stem}-sampled{PurePath(n).suffix}" for n in self.files)


def _not_zero(given: float) -> float:
    if given == 0:
        raise ValueError("expected a number other than 0")
    return given


class NotchTable(Table):
    """``[[servo.controller.notch]]``: a notch filter, by damping ratios, or by width and depth."""

    frequency: float
    zero_damping: float | None = None
    pole_damping: float | None = None
    width: float | None = None
    depth: float | None = None

    def notch(self) -> Notch:
        """Return the filter; raises OptionError for conflicting keys or an invalid number."""
        dampings = self.model_dump(include={"zero_damping", "pole_damping"}, exclude_none=True)
        if self.width is None and self.depth is None:
            return Notch(self.frequency, **dampings)
        if dampings or self.width is None:
            raise OptionError(
                f"notch at {self.frequency:g} Hz: expected width with depth, or damping ratios",
                key=("depth",) if self.width is None else tuple(dampings)[:1],
            )
        return Notch.of_width(self.frequency, self.width, self.depth or 0.0)


class ControllerTable(Table):
    """``[servo.controller]``: stated gains, or gains sized by rule from the plant's inertia."""

    kp: float | None = None
    ti: float | None = None
    kv: float | None = None
    crossover: float | None = None
    ti_ratio: float | None = None
    kv_ratio: float | None = None
    low_pass: float | None = None
    low_pass_damping: float | None = None
    feed_forward: float = 0.0
    dead_time: float = 0.0
    ratio: float | None = None
    notch: Annotated[
        tuple[NotchTable, ...], BeforeValidator(tables_of("servo.controller.notch")), Strict(False)
    ] = ()

    @property
    def settings(self) -> dict[str, Any]:
        """The stated settings as arguments of `Controller`, without those of the rule."""
        out = self.model_dump(exclude={"notch", *_RULE}, exclude_none=True)
        return out | {"notches": tuple(table.notch() for table in self.notch)}

    def check(self) -> None:
        """Raise OptionError for an invalid number, or for gains both stated and sized by rule."""
        if (self.kp is None) == (self.crossover is None):
            raise OptionError(
                "controller: expected either kp, or crossover to size it by rule",
                key=("kp",),
            )
        given = self.settings
        if self.kp is None:
            given["kp"] = 1.0
            given.setdefault("kv", 1.0)
        else:
            ruled = next((key for key in _RULE if getattr(self, key) is not None), None)
            if ruled is not None:
                raise OptionError(
                    f"controller: {ruled} sizes a gain by rule; give crossover instead of kp",
                    key=(ruled,),
                )
        for key in _RULE:
            value = getattr(self, key)
            if value is not None and value <= 0:
                raise OptionError(
                    f"controller: {key} is {value!r}; expected a number above 0", key=(key,)
                )
        Controller(**given)

    def controller(
        self, plant: Plant, torque: str, velocity: str, position: str | None
    ) -> Controller:
        """Return the controller, sized by the inertia of the plant if the table states a crossover.

        Without a `position` output, the gain of the position loop is not sized.
        """
        if self.crossover is None:
            return Controller(**self.settings)
        rule: dict[str, Any] = {}
        if self.ti_ratio is not None:
            rule["ti_ratio"] = self.ti_ratio
        if self.kv_ratio is not None:
            rule["kv_ratio"] = self.kv_ratio
        elif position is None:
            rule["kv_ratio"] = None
        return Controller.tuned(
            plant,
            self.crossover,
            torque=torque,
            velocity=velocity,
            position=position,
            **rule,
            **self.settings,
        )


class WindTable(Table):
    """``wind`` of ``[servo]``: gusts with Davenport's spectrum, at the input ``disturbance``."""

    mean_speed: float
    coefficient: float
    roughness: float | None = None
    turbulence: float | None = None
    duration: float = 600.0
    dt: float | None = None
    seed: int = 0

    def wind(self) -> Wind:
        """Return the wind; raises OptionError for an invalid number."""
        return Wind(**self.model_dump())


class NonlinearTable(Table):
    """``[[servo.nonlinear]]``: backlash in a mesh, or dry friction at a DOF."""

    kind: Literal["backlash", "friction"]
    at: str
    mesh: str | None = None
    gap: float | None = Field(default=None, gt=0)
    frequency: float | None = Field(default=None, gt=0)
    level: float | None = Field(default=None, gt=0)
    breakaway: float | None = Field(default=None, gt=0)
    duration: float | None = Field(default=None, gt=0)

    def check(self) -> None:
        """Raise OptionError if a key of the kind is missing, or one belongs to the other kind."""
        if self.kind == "backlash":
            kind_keys: tuple[str, ...] = ("mesh", "gap")
            others: tuple[str, ...] = ("level", "breakaway")
        else:
            kind_keys = ("level",)
            others = ("mesh", "gap", "frequency")
        for key in kind_keys:
            if getattr(self, key) is None:
                raise OptionError(f"nonlinear: kind {self.kind!r} needs {key}", key=("kind",))
        for key in others:
            if getattr(self, key) is not None:
                raise OptionError(
                    f"nonlinear: {key} does not belong to kind {self.kind!r}", key=(key,)
                )


class ServoTable(Table):
    """``[servo]``: ports of the loop, controller and disturbances."""

    torque: str | None = None
    velocity: str | None = None
    position: str | None = None
    disturbance: str | None = None
    pointing: str | None = None
    motor: str | None = None
    load: str | None = None
    ratio: float | None = None
    step: Annotated[float, AfterValidator(_not_zero)] = 1.0
    disturbance_step: Annotated[float, AfterValidator(_not_zero)] = 1.0
    duration: float | None = Field(default=None, gt=0)
    wind: WindTable | None = None
    controller: ControllerTable | None = None
    nonlinear: Annotated[
        tuple[NonlinearTable, ...], BeforeValidator(tables_of("servo.nonlinear")), Strict(False)
    ] = ()
