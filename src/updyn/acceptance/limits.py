"""`AcceptanceLimits`: limits of the agreement between a model and measured modes."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

from updyn.errors import OptionError, suggest

__all__ = ["LIMIT_NAMES", "MODE_CLASSES", "AcceptanceLimits"]

#: Classes of modes, from the strictest limits to the laxest.
MODE_CLASSES = ("fundamental", "major", "other")
_TEXTS = ("name", "source", "changed")


@dataclass(frozen=True, slots=True)
class AcceptanceLimits:
    """Limits of the agreement between a model and measured modes; None: not required.

    Attributes
    ----------
    name : str
        The standard, or another name.
    frequency : float, optional
        Largest difference of a natural frequency of the model, as a share of the measured one.
    mac : float, optional
        Least MAC of a pair of modes; of close modes, that of their subspaces.
    frequency_major, mac_major : float, optional
        The same for major modes; by default those of all modes.
    frequency_fundamental, mac_fundamental : float, optional
        The same for fundamental modes; by default those of major modes.
    mac_off : float, optional
        Largest MAC of a measured mode with another mode of the model.
    cross, cross_off : float, optional
        Least cross-orthogonality of a pair, and largest one of a measured mode with another mode of
        the model.
    effective_mass : float, optional
        Share of the total mass above which the effective mass of a mode, in any direction, makes it
        a major mode. A major mode must be measured.
    mass_met : float, optional
        Least share of the total mass that the paired modes carry together, in every direction.
    source : str
        Origin of the limits.
    changed : tuple of str
        Limits that differ from those of the standard.

    Raises
    ------
    OptionError
        If a limit is not above 0 and at most 1, or limits of major modes have no `effective_mass`.

    Examples
    --------
    >>> limits = updyn.AcceptanceLimits(frequency=0.05, mac=0.9)
    >>> limits.of_class("frequency", "major"), limits.changed
    (0.05, ())
    """

    name: str = "own limits"
    frequency: float | None = None
    mac: float | None = None
    frequency_major: float | None = None
    mac_major: float | None = None
    frequency_fundamental: float | None = None
    mac_fundamental: float | None = None
    mac_off: float | None = None
    cross: float | None = None
    cross_off: float | None = None
    effective_mass: float | None = None
    mass_met: float | None = None
    source: str = ""
    changed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in LIMIT_NAMES:
            value = getattr(self, name)
            if value is not None and not 0.0 < value <= 1.0:
                raise OptionError(
                    f"{name} = {value:g}: expected a share above 0 and at most 1, such as 0.05 for"
                    " 5 %",
                    key=(name,),
                )
        needs = [name for name in ("frequency_major", "mac_major") if getattr(self, name)]
        if needs and self.effective_mass is None:
            raise OptionError(
                f"{needs[0]}: expected effective_mass too, the share of the total mass above which"
                " a mode is major",
                key=(needs[0],),
            )

    @property
    def stated(self) -> dict[str, float]:
        """The limits that are required, by name."""
        values = {name: getattr(self, name) for name in LIMIT_NAMES}
        return {name: value for name, value in values.items() if value is not None}

    def with_changes(self, **limits: Any) -> AcceptanceLimits:
        """Return the limits with some of them replaced, and their names in `changed`.

        Parameters
        ----------
        **limits : float or None
            Limits by name.

        Returns
        -------
        AcceptanceLimits

        Raises
        ------
        OptionError
            If there is no limit of a name, or a value is out of range.
        """
        for name in limits:
            if name not in LIMIT_NAMES:
                raise OptionError(f"{name}: no such limit; {suggest(name, LIMIT_NAMES)}")
        changed = tuple(name for name in LIMIT_NAMES if name in {*self.changed, *limits})
        return replace(self, **limits, changed=changed)

    def of_class(self, what: str, mode_class: str) -> float | None:
        """Return the limit of a class of modes, or else that of the next laxer class.

        Parameters
        ----------
        what : {"frequency", "mac"}
            The limited quantity.
        mode_class : {"fundamental", "major", "other"}
            Class of the mode.

        Returns
        -------
        float or None
        """
        for name in MODE_CLASSES[MODE_CLASSES.index(mode_class) :]:
            found: float | None = getattr(self, what if name == "other" else f"{what}_{name}")
            if found is not None:
                return found
        return None


#: Names of the limits.
LIMIT_NAMES = tuple(one.name for one in fields(AcceptanceLimits) if one.name not in _TEXTS)
