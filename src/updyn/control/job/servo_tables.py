"""``[servo]`` of a job file: the controller that is put on the plant, and what acts on it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, Strict

from updyn.errors import OptionError
from updyn.job.schema import Table, tables_of

if TYPE_CHECKING:
    from updyn.control.plant import Plant
    from updyn.control.servo.controller import Controller, Notch
    from updyn.control.servo.wind import Wind

__all__ = ["ControllerTable", "NonlinearTable", "NotchTable", "ServoTable", "WindTable"]

#: Keys of the controller that are of the rule by which it is sized.
_RULE = ("crossover", "ti_ratio", "kv_ratio")


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
        """Return the filter.

        Returns
        -------
        Notch

        Raises
        ------
        OptionError
            If a number is out of its range, or both ways to state the width are used.
        """
        from updyn.control.servo.controller import Notch

        dampings = {
            k: v for k in ("zero_damping", "pole_damping") if (v := getattr(self, k)) is not None
        }
        if self.width is None and self.depth is None:
            return Notch(self.frequency, **dampings)
        if dampings or self.width is None:
            raise OptionError(
                f"notch at {self.frequency:g} Hz: expected width with depth, or damping ratios",
                key=("depth",) if self.width is None else tuple(dampings)[:1],
            )
        return Notch.of_width(self.frequency, self.width, self.depth or 0.0)


class ControllerTable(Table):
    """``[servo.controller]``: gains as they are set, or sized by rule from the inertia of the plant."""

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
    notch: Annotated[
        tuple[NotchTable, ...], BeforeValidator(tables_of("servo.controller.notch")), Strict(False)
    ] = ()

    @property
    def settings(self) -> dict[str, Any]:
        """What is stated, as `Controller` takes it, the rule left out."""
        out = self.model_dump(exclude={"notch", *_RULE}, exclude_none=True)
        return out | {"notches": tuple(table.notch() for table in self.notch)}

    def check(self) -> None:
        """Check what can be known without the plant.

        Raises
        ------
        OptionError
            If a number is out of its range, or gains are both stated and sized by rule.
        """
        from updyn.control.servo.controller import Controller

        if (self.kp is None) == (self.crossover is None):
            raise OptionError(
                "controller: expected kp, or crossover to size it by rule; one of the two",
                key=("kp",),
            )
        given = self.settings
        if self.kp is None:
            given |= {"kp": 1.0} | ({"kv": 1.0} if "kv" not in given else {})
        else:
            ruled = next((key for key in _RULE if getattr(self, key) is not None), None)
            if ruled is not None:
                raise OptionError(
                    f"controller: {ruled} sizes a gain by rule; give crossover in place of kp",
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
        """Return the controller.

        Parameters
        ----------
        plant : Plant
            Of whose inertia gains are sized by rule.
        torque, velocity : str
            Names of its input and output.
        position : str or None
            Name of the output that the position loop reads; None: gains of a position loop are not
            sized by rule.

        Returns
        -------
        Controller

        Raises
        ------
        InputError
            If the plant has no inertia to size gains by, or a number is out of its range.
        """
        from updyn.control.servo.controller import Controller

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
            plant, self.crossover, torque=torque, velocity=velocity, **rule, **self.settings
        )


class WindTable(Table):
    """``wind`` of ``[servo]``: gusts by Davenport's spectrum, at the input ``disturbance``."""

    mean_speed: float
    coefficient: float
    roughness: float | None = None
    turbulence: float | None = None
    duration: float = 600.0
    dt: float | None = None
    seed: int = 0

    def wind(self) -> Wind:
        """Return the wind.

        Returns
        -------
        Wind

        Raises
        ------
        OptionError
            If a number is out of its range.
        """
        from updyn.control.servo.wind import Wind

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
        """Check that the keys are those of the kind.

        Raises
        ------
        OptionError
            If one is missing, or belongs to the other kind.
        """
        own = {"backlash": ("mesh", "gap"), "friction": ("level",)}[self.kind]
        others = {"backlash": ("level", "breakaway"), "friction": ("mesh", "gap", "frequency")}[
            self.kind
        ]
        for key in own:
            if getattr(self, key) is None:
                raise OptionError(f"nonlinear: kind {self.kind!r} needs {key}", key=("kind",))
        for key in others:
            if getattr(self, key) is not None:
                raise OptionError(
                    f"nonlinear: {key} does not belong to kind {self.kind!r}", key=(key,)
                )


class ServoTable(Table):
    """``[servo]``: which ports the loop uses, the controller, and what acts on it."""

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
