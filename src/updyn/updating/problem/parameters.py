"""Unknowns of an update: start, bounds, prior and drives of each, and their selection by name."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import BoolArray, NumberArray, RealArray
from updyn.errors import ParameterError, suggest
from updyn.group import GROUP_QUANTITIES, VALUES
from updyn.grouping import match_names
from updyn.model import Model
from updyn.nonlinear.parameters import list_parameters, parameter_unit
from updyn.text_table import format_count, printable, text_table
from updyn.updating.problem.settings import UNKNOWN_DEFAULTS

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "CHANNELS",
    "DEFAULT_BOUNDS",
    "Drive",
    "Parameter",
    "ParameterSet",
    "check_bounds",
    "check_finite",
    "collect_unknowns",
    "link",
    "no_unknowns",
    "parameters",
]

#: Unknowns of the measurement, not of the model: the factor of a sensor, with the kind of its
#: channels.
CHANNELS = {"calibration": "response", "force_calibration": "reference"}
_QUANTITIES = (*GROUP_QUANTITIES, *CHANNELS)


@dataclass(frozen=True, slots=True)
class Drive:
    """A quantity of a group on which an unknown acts.

    Parameters
    ----------
    group, quantity : str
        The group and its quantity; for a calibration factor (`updyn.calibration`) the label of the
        sensor. A value (loss factor, Rayleigh coefficient) is set to that of the unknown; any other
        quantity is multiplied by value**power.
    power : float
        The exponent; 1 for a value.
    of_element : bool
        Whether `group` is a nonlinear element, and `quantity` one of its parameters, a value.

    Raises
    ------
    ParameterError
        If the quantity is not known, the power is not a finite number other than 0, or the power of
        a value is not 1.
    """

    group: str
    quantity: str
    power: float = 1.0
    of_element: bool = False

    def __post_init__(self) -> None:
        if self.of_element:
            return
        if self.quantity not in _QUANTITIES:
            raise ParameterError(
                f"no quantity {self.quantity!r}; {suggest(str(self.quantity), _QUANTITIES)}"
            )
        object.__setattr__(self, "power", check_finite(self.power, f"{self.name!r}: power"))
        if self.power == 0.0 or (self.quantity in VALUES and self.power != 1.0):
            expected = "a number other than 0"
            if self.quantity in VALUES:
                expected = f"1, as a {self.quantity.replace('_', ' ')} is a value"
            raise ParameterError(f"{self.name!r}: power {self.power:g}; expected {expected}")

    @property
    def name(self) -> str:
        """``group.quantity``."""
        return f"{self.group}.{self.quantity}"


@dataclass(frozen=True, slots=True)
class Parameter:
    """One unknown.

    Parameters
    ----------
    group, quantity : str
        The changed quantity. ``stiffness``, ``mass`` and ``viscous`` are factors relative to the
        initial group; ``loss_factor``, ``mass_damping`` (1/s) and ``stiffness_damping`` (s) are
        values. For a linked unknown, the two parts of its name.
    start, lower, upper : float
        Start and bounds, in the unit of the unknown.
    prior_std : float, optional
        Standard deviation of a Gaussian prior about `start`, in the unit of the unknown; for a
        factor, that of its logarithm, so 0.3 means about 30 %.
    drives : tuple of Drive
        Quantities on which a linked unknown acts (`updyn.link`); empty: its own group and quantity.
    nominal : float, optional
        Physical value of a factor of 1 (a modulus, a thickness), in `unit`; reports show the
        product.
    unit : str
        Unit of `nominal`; of the unknown itself if it is a parameter of a nonlinear element.
    of_element : bool
        Whether the unknown is a parameter of a nonlinear element: a value, of which the logarithm
        is optimised if the bounds exclude 0.

    Raises
    ------
    ParameterError
        If the quantity is not known, a number is not finite, bounds are out of order or do not fit
        the quantity, the start lies outside the bounds, or the drives do not fit together.
    """

    group: str
    quantity: str
    start: float
    lower: float
    upper: float
    prior_std: float | None = None
    drives: tuple[Drive, ...] = ()
    nominal: float | None = None
    unit: str = ""
    of_element: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "drives", tuple(self.drives))
        self._check_drives()
        for what in ("start", "lower", "upper"):
            object.__setattr__(
                self, what, check_finite(getattr(self, what), f"unknown {self.name!r}: {what}")
            )
        if not self.lower < self.upper:
            raise ParameterError(
                f"unknown {self.name!r}: bounds ({self.lower:g}, {self.upper:g}); expected the"
                " lower one first",
                key=("bounds",),
            )
        if not self.lower <= self.start <= self.upper:
            raise ParameterError(
                f"unknown {self.name!r} starts at {self.start:g}, outside its bounds"
                f" ({self.lower:g}, {self.upper:g})",
                key=("start",),
            )
        if self.is_factor and self.lower <= 0:
            raise ParameterError(
                f"unknown {self.name!r} is a factor: its lower bound {self.lower:g} must be above"
                " 0",
                key=("bounds",),
            )
        if self.is_damping and self.lower < 0:
            raise ParameterError(
                f"unknown {self.name!r}: a {self._quantity_text} below 0 feeds energy in; lower"
                f" bound {self.lower:g}",
                key=("bounds",),
            )
        if self.prior_std is not None:
            object.__setattr__(
                self, "prior_std", check_finite(self.prior_std, f"unknown {self.name!r}: prior_std")
            )
            if self.prior_std <= 0:
                raise ParameterError(
                    f"unknown {self.name!r}: prior_std {self.prior_std:g}; expected a number"
                    " above 0",
                    key=("prior_std",),
                )
        elif self.is_channel:
            raise ParameterError(
                f"unknown {self.name!r}: a calibration factor needs a prior_std, such as 0.05",
                key=("prior_std",),
            )
        if self.nominal is not None:
            object.__setattr__(
                self, "nominal", check_finite(self.nominal, f"unknown {self.name!r}: nominal")
            )
            if not self.is_factor or self.nominal <= 0:
                expected = "a number above 0"
                if not self.is_factor:
                    expected = f"none, as a {self._quantity_text} is a value"
                raise ParameterError(
                    f"unknown {self.name!r}: nominal {self.nominal:g}; expected {expected}",
                    key=("nominal",),
                )

    def _check_drives(self) -> None:
        if self.of_element:
            return
        if not self.drives and self.quantity not in _QUANTITIES:
            raise ParameterError(
                f"no quantity {self.quantity!r}; {suggest(str(self.quantity), _QUANTITIES)}"
            )
        names = [d.name for d in self.drives]
        for name in names:
            if names.count(name) > 1:
                raise ParameterError(
                    f"unknown {self.name!r} acts on {name!r} twice; add the powers"
                )
        if len({d.quantity in CHANNELS for d in self.drives}) > 1:
            raise ParameterError(
                f"unknown {self.name!r} acts on sensors and on the model; use two unknowns"
            )
        quantities = {d.quantity for d in self.drives}
        values = quantities & VALUES.keys()
        if values and len(quantities) > 1:
            value = max(values).replace("_", " ")
            raise ParameterError(
                f"unknown {self.name!r} acts on {value}s and on other quantities; use two unknowns"
            )

    @property
    def name(self) -> str:
        """``group.quantity``."""
        return f"{self.group}.{self.quantity}"

    @property
    def acts_on(self) -> tuple[Drive, ...]:
        """Drives of the unknown; its own group and quantity if it is not linked."""
        return self.drives or (Drive(self.group, self.quantity, of_element=self.of_element),)

    @property
    def law(self) -> str:
        """Drives of a linked unknown, as ``"skin.stiffness, bend.stiffness^3"``; else empty."""
        laws = []
        for drive in self.drives:
            law = drive.name
            if drive.power != 1.0:
                law += f"^{drive.power:g}"
            laws.append(law)
        return ", ".join(laws)

    def physical(self, value: float, std: float = math.nan) -> str:
        """Return a value of the unknown as text in physical units; empty without `nominal`.

        Parameters
        ----------
        value, std : float
            Value and standard deviation in the unit of the unknown; the deviation may be nan or
            inf.
        """
        if self.nominal is None:
            return ""
        text = f"{value * self.nominal:.6g}"
        if math.isfinite(std):
            text += f" ± {std * self.nominal:.2g}"
        return f"{text} {self.unit}".rstrip()

    @property
    def is_factor(self) -> bool:
        """Whether the unknown is a positive factor, whose logarithm is optimised."""
        return self.value_of is None

    @property
    def is_damping(self) -> bool:
        """Whether the unknown is a loss factor or a Rayleigh coefficient."""
        return not (self.is_factor or self.of_element)

    @property
    def is_log(self) -> bool:
        """Whether the logarithm of the unknown, or of its magnitude, is optimised."""
        return self.is_factor or (self.of_element and self.lower * self.upper > 0.0)

    @property
    def scale(self) -> float:
        """Unit of the optimiser's coordinate of a parameter of an element that may be 0."""
        return 0.5 * (self.upper - self.lower)

    @property
    def is_channel(self) -> bool:
        """Whether the unknown is a calibration factor of sensors, not of the model."""
        return not self.of_element and self._first_quantity in CHANNELS

    @property
    def value_of(self) -> str | None:
        """``loss_factor``, ``mass_damping``, ``stiffness_damping``; None for a factor.

        Of a nonlinear element, the name of its parameter.
        """
        if self.of_element:
            return self.quantity
        quantity = self._first_quantity
        if quantity not in VALUES:
            return None
        return quantity

    @property
    def _first_quantity(self) -> str:
        """Quantity of the first of `acts_on`."""
        return self.drives[0].quantity if self.drives else self.quantity

    @property
    def value_unit(self) -> str:
        """Unit of the unknown itself; empty for factors and loss factors."""
        if self.of_element:
            return self.unit
        return VALUES.get(self.value_of or "", "")

    @property
    def _quantity_text(self) -> str:
        return (self.value_of or "factor").replace("_", " ")


@dataclass(frozen=True, slots=True)
class ParameterSet(Sequence[Parameter]):
    """An ordered, immutable set of unknowns.

    Parameters
    ----------
    items : tuple of Parameter
        The unknowns, each group and quantity once.

    Raises
    ------
    ParameterError
        If the set is empty, or an unknown occurs twice.
    """

    items: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "items", tuple(self.items))
        if not self.items:
            raise ParameterError("there is nothing to update: no unknown is chosen")
        name, count = Counter(self.names).most_common(1)[0]
        if count > 1:
            raise ParameterError(f"unknown {name!r} occurs twice")
        values: dict[str, str] = {}
        for p in self.items:
            for d in p.acts_on:
                if d.quantity in VALUES and values.setdefault(d.name, p.name) != p.name:
                    raise ParameterError(
                        f"{d.name!r} is set by two unknowns: {values[d.name]!r} and {p.name!r}"
                    )

    def __repr__(self) -> str:
        rows = []
        for p in self.items[: UNKNOWN_DEFAULTS.printed_rows]:
            prior = "" if p.prior_std is None else f"{p.prior_std:g}"
            notes = [p.law, f"in {p.value_unit}" if p.value_unit else "", p.physical(p.start)]
            bounds = f"{p.lower:g}", f"{p.upper:g}"
            remark = "; ".join(note for note in notes if note)
            rows.append((printable(p.name), f"{p.start:g}", *bounds, prior, printable(remark)))
        header = ("unknown", "start", "lower", "upper", "prior std", "note")
        keep = [i for i in range(len(header)) if i < 4 or any(row[i] for row in rows)]
        table = text_table(
            [header[i] for i in keep],
            [[row[i] for i in keep] for row in rows],
            left={at for at, i in enumerate(keep) if i in (0, 5)},
        )
        hidden = len(self) - len(rows)
        more = f"\n... and {hidden} more" if hidden else ""
        return f"ParameterSet({format_count(len(self), 'unknown')})\n{table}{more}"

    def __len__(self) -> int:
        return len(self.items)

    @overload
    def __getitem__(self, item: int) -> Parameter: ...
    @overload
    def __getitem__(self, item: slice) -> ParameterSet: ...
    def __getitem__(self, item: int | slice) -> Parameter | ParameterSet:
        if isinstance(item, slice):
            return ParameterSet(self.items[item])
        return self.items[item]

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.items)

    def __add__(self, other: ParameterSet) -> ParameterSet:
        return ParameterSet(self.items + other.items)

    @property
    def names(self) -> list[str]:
        """Names in order."""
        return [p.name for p in self.items]

    @property
    def start(self) -> RealArray:
        """Start values, shape (n,)."""
        return self._column("start")

    @property
    def lower(self) -> RealArray:
        """Lower bounds, shape (n,)."""
        return self._column("lower")

    @property
    def upper(self) -> RealArray:
        """Upper bounds, shape (n,)."""
        return self._column("upper")

    @property
    def is_factor(self) -> BoolArray:
        """Whether each unknown is a positive factor, not a damping value; shape (n,)."""
        return self._column("is_factor")

    @property
    def is_damping(self) -> BoolArray:
        """Whether each unknown is a damping value, which cannot be below 0; shape (n,)."""
        return self._column("is_damping")

    @property
    def is_log(self) -> BoolArray:
        """Whether the logarithm of each unknown is optimised; shape (n,)."""
        return self._column("is_log")

    def to_pandas(self) -> pd.DataFrame:
        """Return a table with a row for each unknown.

        Returns
        -------
        pandas.DataFrame
            Index: ``unknown``. Columns: ``group``, ``quantity``, ``start``, ``lower``, ``upper``,
            ``prior_std`` (nan without a prior) and ``unit``.
        """
        import pandas as pd

        names = ("group", "quantity", "start", "lower", "upper")
        columns: dict[str, object] = {
            name: [getattr(p, name) for p in self.items] for name in names
        }
        columns["prior_std"] = [
            math.nan if p.prior_std is None else p.prior_std for p in self.items
        ]
        columns["unit"] = [p.value_unit for p in self.items]
        return pd.DataFrame(columns, index=pd.Index(self.names, name="unknown"))

    def _column(self, attribute: str) -> NumberArray:
        """Return an attribute of all unknowns, shape (n,)."""
        return np.array([getattr(p, attribute) for p in self.items])

    def with_start(self, values: ArrayLike | Mapping[str, float]) -> ParameterSet:
        """Return a copy with other start values.

        Parameters
        ----------
        values : array_like of float, shape (n,), or mapping of str to float
            New start values; a mapping may name only some unknowns.

        Returns
        -------
        ParameterSet
            The same unknowns with the same bounds.

        Raises
        ------
        ParameterError
            If a name is not in the set, the length is wrong, or a value lies outside its bounds.
        """
        if isinstance(values, Mapping):
            names = self.names
            for name in values.keys() - set(names):
                raise ParameterError(f"no unknown {name!r}; {suggest(str(name), names)}")
            starts = dict(zip(names, self.start.tolist(), strict=True)) | dict(values)
            new = list(starts.values())
        else:
            new = self._vector(values, "start values").tolist()
        items = []
        for p, start in zip(self.items, new, strict=True):
            items.append(replace(p, start=start))
        return ParameterSet(tuple(items))

    def with_nominal(self, nominal: Mapping[str, float], unit: str) -> ParameterSet:
        """Return a copy with physical values for some factors.

        Parameters
        ----------
        nominal : mapping of str to float
            Physical value of a factor of 1, by unknown.
        unit : str
            Unit of these values.

        Returns
        -------
        ParameterSet
            The same unknowns.

        Raises
        ------
        ParameterError
            If a name is not in the set, or a number is not above 0.
        """
        for name in nominal.keys() - set(self.names):
            raise ParameterError(f"no unknown {name!r}; {suggest(str(name), self.names)}")
        items = list(self.items)
        for i, p in enumerate(items):
            if p.name in nominal:
                items[i] = replace(p, nominal=nominal[p.name], unit=unit)
        return ParameterSet(tuple(items))

    def apply(self, model: Model, values: ArrayLike) -> Model:
        """Return `model` with the unknowns at `values`; calibration factors have no effect.

        Parameters
        ----------
        model : Model
            The initial model, to which factors are relative.
        values : array_like of float, shape (n,)
            The unknowns, in order. Their bounds are not checked.

        Returns
        -------
        Model
            The changed copy.

        Raises
        ------
        ParameterError
            If the length is wrong.
        ModelError
            If the model lacks a group or a quantity, or a value is not finite.
        """
        return model.scaled(self.changes(values))

    def at_start(self, model: Model) -> Model:
        """Return `model` with the unknowns at their start values.

        Parameters
        ----------
        model : Model
            The model of a test; it may lack groups and quantities.

        Returns
        -------
        Model
            `model` itself if every unknown starts at its value in the model.
        """
        changes: dict[str, dict[str, float]] = {}
        for name, change in self.changes(self.start).items():
            local = model.nonlinear.get(name)
            if local is not None:
                known = list_parameters(local.element)
                other = {q: v for q, v in change.items() if v != known.get(q, v)}
                if other:
                    changes[name] = other
                continue
            group = model.groups.get(name)
            if group is None:
                continue
            for quantity, value in change.items():
                now = getattr(group, quantity) if quantity in VALUES else 1.0
                if group.has(quantity) and value != now:
                    changes.setdefault(name, {})[quantity] = value
        return model.scaled(changes) if changes else model

    def changes(self, values: ArrayLike) -> dict[str, dict[str, float]]:
        """Return the changes of each group at `values`, as the argument of `Model.scaled`.

        Parameters
        ----------
        values : array_like of float, shape (n,)
            The unknowns, in order.

        Returns
        -------
        dict of str to dict of str to float
            By group and quantity: factors, and values of damping.

        Raises
        ------
        ParameterError
            If the length is wrong.
        """
        changes: dict[str, dict[str, float]] = {}
        for parameter, value in zip(self.items, self._vector(values, "values"), strict=True):
            if parameter.is_channel:
                continue
            for d in parameter.acts_on:
                change = changes.setdefault(d.group, {})
                if d.of_element or d.quantity in VALUES:
                    change[d.quantity] = float(value)
                else:
                    change[d.quantity] = change.get(d.quantity, 1.0) * float(value) ** d.power
        return changes

    def _vector(self, values: ArrayLike, what: str) -> RealArray:
        try:
            array = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ParameterError(f"{what}: expected {len(self)} numbers ({error})") from error
        if array.shape != (len(self),):
            raise ParameterError(f"{what}: expected {len(self)}, found shape {array.shape}")
        return array


def check_finite(given: Any, what: str) -> float:
    """Return user input as a float; raise for anything but a finite number, naming `what`."""
    is_number = isinstance(given, int | float | np.floating | np.integer)
    if not is_number or isinstance(given, bool) or not np.isfinite(given):
        raise ParameterError(f"{what}: expected a finite number, found {given!r}")
    return float(given)


#: Default bounds. Factors may change a hundredfold; a loss factor of 10 is beyond any material, and
#: so are Rayleigh coefficients equivalent to it at 10 kHz (mass) or at 0.1 Hz (stiffness).
DEFAULT_BOUNDS = {
    "stiffness": (0.01, 100.0),
    "mass": (0.01, 100.0),
    "viscous": (0.001, 1000.0),
    "loss_factor": (0.0, 10.0),
    "mass_damping": (0.0, 6e5),
    "stiffness_damping": (0.0, 16.0),
}


def no_unknowns() -> ParameterSet:
    """Return a set without unknowns, for a model that is used as it is."""
    out = object.__new__(ParameterSet)
    object.__setattr__(out, "items", ())
    return out


def collect_unknowns(items: Iterable[Parameter]) -> ParameterSet:
    """Return a set of unknowns, which may be empty."""
    found = tuple(items)
    return ParameterSet(found) if found else no_unknowns()


def parameters(
    model: Model,
    *,
    stiffness: str | Iterable[str] = (),
    mass: str | Iterable[str] = (),
    loss_factor: str | Iterable[str] = (),
    viscous: str | Iterable[str] = (),
    mass_damping: str | Iterable[str] = (),
    stiffness_damping: str | Iterable[str] = (),
    nonlinear: str | Iterable[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    prior_std: Mapping[str, float] | None = None,
) -> ParameterSet:
    """Choose the unknowns of a model by group and quantity.

    Parameters
    ----------
    model : Model
        The model to update.
    stiffness, mass, loss_factor, viscous, mass_damping, stiffness_damping : str or iterable of str
        Group names, globs (``"gear*"``), ranges of the integer in the name (``"PSHELL 1-4"``), or
        ``"all"``. Globs and ranges select the matching groups that have the quantity, ``"all"``
        every group that has it. Stiffness, mass and viscous unknowns are factors relative to the
        initial group (1 = unchanged). The others are values and start at those of the group: loss
        factors and stiffness damping (s) relative to the updated stiffness, mass damping (1/s) to
        the updated mass.
    nonlinear : str or iterable of str
        Parameters of nonlinear elements: ``"joint.slip_force"``, globs over these
        (``"joint.*"``), names of elements, or ``"all"``. They are values in SI units and start at
        those of the element. The default bounds are a hundredth and a hundredfold of the start,
        with its sign; a parameter that starts at 0 needs `bounds`.
    bounds : mapping of str to (float, float), optional
        By quantity (``"stiffness"``), by unknown (``"shaft.stiffness"``) or by glob over unknowns.
        The most specific key has precedence: the unknown, then the first matching glob, then the
        quantity. A damping value outside its bounds starts on the nearer bound.
    prior_std : mapping of str to float, optional
        Standard deviation of a prior about the start, by the same keys.

    Returns
    -------
    ParameterSet
        Ordered by group, then mass, stiffness, loss factor, viscous, mass damping, stiffness
        damping.

    Raises
    ------
    ParameterError
        If a glob matches no group, a group lacks the quantity, a key of `bounds` or `prior_std`
        matches no unknown, or nothing is selected.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> unknowns = updyn.parameters(chain.build(), stiffness="all", loss_factor=["part1"])
    >>> unknowns.names[-1], len(unknowns)
    ('part4.stiffness', 5)
    """
    wanted = {"mass": mass, "stiffness": stiffness, "loss_factor": loss_factor, "viscous": viscous}
    wanted |= {"mass_damping": mass_damping, "stiffness_damping": stiffness_damping}
    chosen = {
        quantity: _select_groups(model, quantity, patterns) for quantity, patterns in wanted.items()
    }
    items = []
    for name, group in model.groups.items():
        for quantity in wanted:
            if name in chosen[quantity]:
                low, high = DEFAULT_BOUNDS[quantity]
                start = group.value(quantity)
                items.append(Parameter(name, quantity, start, low, max(high, 2 * start)))
    items += _select_elements(model, nonlinear, bounds)
    bounds = _check_keys("bounds", bounds, items)
    prior_std = _check_keys("prior_std", prior_std, items)
    out = []
    for p in items:
        pair = _most_specific(bounds, p)
        if pair is not None:
            low, high = check_bounds(pair, f"bounds of {p.name!r}")
            start = p.start
            if p.value_of is not None and low < high:
                # The user's bounds have precedence over the value of the group.
                start = min(max(start, low), high)
            with _start_is_stated(False):
                p = replace(p, start=start, lower=low, upper=high)
        out.append(replace(p, prior_std=_most_specific(prior_std, p)))
    return ParameterSet(tuple(out))


def _select_elements(
    model: Model, patterns: str | Iterable[str], bounds: Mapping[str, object] | None
) -> list[Parameter]:
    """Return the chosen parameters of nonlinear elements, within their default bounds."""
    known: dict[str, tuple[str, str]] = {}
    for name, local in model.nonlinear.items():
        known |= {f"{name}.{q}": (name, q) for q in list_parameters(local.element)}
    chosen: dict[str, None] = {}
    for pattern in [patterns] if isinstance(patterns, str) else patterns:
        if not isinstance(pattern, str):
            raise ParameterError(f"nonlinear: expected a parameter or a glob, found {pattern!r}")
        whole = f"{pattern}.*" if pattern in model.nonlinear else pattern
        found = list(known) if pattern == "all" else match_names(list(known), whole)
        if not found:
            raise ParameterError(
                f"nonlinear: no parameter {pattern!r} of a nonlinear element;"
                f" {suggest(pattern, [*known, *model.nonlinear])}"
            )
        chosen |= dict.fromkeys(found)
    items = []
    for key in (key for key in known if key in chosen):
        name, quantity = known[key]
        local = model.nonlinear[name]
        start = list_parameters(local.element)[quantity]
        unit = parameter_unit(local.element, quantity, rotates=local.rotates)
        ratio = UNKNOWN_DEFAULTS.element_ratio
        low, high = sorted((start / ratio, start * ratio)) if start else (-1.0, 1.0)
        unknown = Parameter(name, quantity, start, low, high, unit=unit, of_element=True)
        if not start and _most_specific(bounds or {}, unknown) is None:
            raise ParameterError(
                f"unknown {key!r} starts at 0, where its size is unknown; give its bounds",
                key=("bounds",),
            )
        items.append(unknown)
    return items


def link(
    model: Model,
    name: str,
    drives: Mapping[str, float] | Iterable[str],
    *,
    start: float | None = None,
    bounds: tuple[float, float] | None = None,
    prior_std: float | None = None,
    nominal: float | None = None,
    unit: str = "",
) -> ParameterSet:
    """Return one unknown that acts on several groups by given power laws.

    A thickness scales membrane stiffness and mass in proportion, and bending stiffness with its
    cube; a modulus scales all stiffnesses of its material; a symmetric pair shares one stiffness.
    The model stays affine in the coefficients of its groups, so the derivatives stay exact.

    Parameters
    ----------
    model : Model
        The model to update.
    name : str
        Name of the unknown with one dot, such as ``"dish.thickness"``.
    drives : mapping of str to float, or iterable of str
        ``group.quantity``, or a glob or range over these, and the power of the unknown:
        ``{"skin.stiffness": 1, "bend.stiffness": 3, "skin.mass": 1}``. Without a mapping, all
        powers are 1. If several unknowns drive a quantity, it is multiplied by all of them.
    start : float, optional
        Start value; by default 1, and for loss factors and Rayleigh coefficients the common value
        of the groups.
    bounds : (float, float), optional
        Bounds of the unknown; by default 0.1 to 10 for factors, 0 to 10 for loss factors, and for
        others as in `updyn.parameters`.
    prior_std : float, optional
        Standard deviation of a prior about the start; of the logarithm for a factor.
    nominal : float, optional
        Physical value of a factor of 1 (2e-3 for a thickness of 2 mm in m); reports show the
        product.
    unit : str
        Unit of `nominal`.

    Returns
    -------
    ParameterSet
        A set of one unknown; sets are joined with ``+``.

    Raises
    ------
    ParameterError
        If a name matches nothing in the model, the drives do not fit together, or a number is not
        usable.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> drives = {"part1.stiffness": 3, "part1.mass": 1}
    >>> updyn.link(chain.build(), "part1.thickness", drives).names
    ['part1.thickness']
    """
    stem, quantity = "", ""
    if isinstance(name, str) and not set(name) & set("*?[]\n\t"):
        stem, _, quantity = name.rpartition(".")
    if not stem.strip() or not quantity.strip():
        raise ParameterError(
            f"unknown {name!r}: expected a name of two parts, such as 'dish.thickness'",
            key=("name",),
        )
    if isinstance(drives, str):
        drives = [drives]
    powers = drives if isinstance(drives, Mapping) else dict.fromkeys(drives, 1.0)
    acts: list[Drive] = []
    for key, power in powers.items():
        acts += _find_drives(model, name, key, power)
    if not acts:
        raise ParameterError(f"unknown {name!r} acts on nothing: drives is empty", key=("drives",))
    first, limits = 1.0, UNKNOWN_DEFAULTS.linked_bounds
    kinds = sorted({d.quantity for d in acts} & set(VALUES))
    if kinds:
        starts = set()
        for drive in acts:
            if drive.quantity == kinds[0]:
                starts.add(model.group(drive.group).value(drive.quantity))
        values = sorted(starts)
        if start is None and len(values) > 1:
            raise ParameterError(
                f"unknown {name!r}: its {kinds[0].replace('_', ' ')}s start at {values}; give start"
            )
        first, limits = values[0], DEFAULT_BOUNDS[kinds[0]]
    if bounds is not None:
        limits = check_bounds(bounds, f"bounds of {name!r}")
    if start is not None:
        first = check_finite(start, f"unknown {name!r}: start")
    with _start_is_stated(start is not None):
        unknown = Parameter(stem, quantity, first, *limits, prior_std, tuple(acts), nominal, unit)
    return ParameterSet((unknown,))


@contextmanager
def _start_is_stated(stated: bool) -> Iterator[None]:
    """Attribute an error of a default start value to the bounds, which the user gave."""
    try:
        yield
    except ParameterError as error:
        if not stated and error.key == ("start",):
            error.key = ("bounds",)
        raise


def _find_drives(model: Model, name: str, key: str, power: float) -> list[Drive]:
    available = []
    for group_name, group in model.groups.items():
        available += [f"{group_name}.{q}" for q in GROUP_QUANTITIES if group.has(q)]
    found = []
    if isinstance(key, str):
        found = match_names(available, key)
    if not found:
        raise ParameterError(
            f"unknown {name!r}: the model has no {key!r}; {suggest(str(key), available)}",
            key=("drives",),
        )
    drives = []
    for full_name in found:
        group_name, _, quantity = full_name.rpartition(".")
        drives.append(Drive(group_name, quantity, power))
    return drives


def _select_groups(model: Model, quantity: str, patterns: str | Iterable[str]) -> set[str]:
    available = [name for name, group in model.groups.items() if group.has(quantity)]
    if isinstance(patterns, str) and patterns == "all":
        if not available:
            raise ParameterError(f"no group of the model has {quantity}")
        return set(available)
    if not isinstance(patterns, Iterable):
        raise ParameterError(
            f"{quantity}: expected group names, globs or 'all', found {patterns!r}"
        )
    if isinstance(patterns, str):
        patterns = [patterns]
    found: set[str] = set()
    for pattern in patterns:
        if not isinstance(pattern, str):
            raise ParameterError(f"{quantity}: expected a group name or a glob, found {pattern!r}")
        matching = match_names(model.groups, pattern)
        if not matching:
            raise ParameterError(
                f"{quantity}: no group {pattern!r}; {suggest(pattern, model.groups)}"
            )
        lacking = [f for f in matching if f not in available]
        if lacking and (pattern in model.groups or len(lacking) == len(matching)):
            raise ParameterError(
                f"{quantity}: group {lacking[0]!r} has no {GROUP_QUANTITIES[quantity]};"
                f" {suggest(pattern, available)}"
            )
        found |= set(matching) & set(available)
    return found


def _most_specific(table: Mapping[str, object], parameter: Parameter) -> Any:
    if parameter.name in table:
        return table[parameter.name]
    for key, value in table.items():
        if key not in GROUP_QUANTITIES and match_names([parameter.name], key):
            return value
    return table.get(parameter.quantity)


def _check_keys(
    what: str, given: Mapping[str, object] | None, items: Sequence[Parameter]
) -> Mapping[str, Any]:
    """Return `given` after checking that each key matches an unknown."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise ParameterError(
            f"{what}: expected a mapping by quantity, unknown or glob, found {given!r}"
        )
    names = [p.name for p in items]
    known = dict.fromkeys([p.quantity for p in items] + names)
    for key in given:
        if key in known or (isinstance(key, str) and match_names(names, key)):
            continue
        raise ParameterError(
            f"{what}: {key!r} is neither a quantity nor an unknown that is chosen;"
            f" {suggest(str(key), known)}"
        )
    return given


def check_bounds(given: object, what: str) -> tuple[float, float]:
    """Return user input as two bounds; raise for anything else, naming `what`."""
    if isinstance(given, str) or not isinstance(given, Sequence | np.ndarray) or len(given) != 2:
        raise ParameterError(f"{what}: expected (lower, upper), found {given!r}", key=("bounds",))
    return check_finite(given[0], what), check_finite(given[1], what)
