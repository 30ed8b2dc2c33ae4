"""`PlantFamily`: a nominal plant and plants at draws from the uncertainty of an update."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.control.build import plant
from updyn.control.lines import sweep
from updyn.control.plant import Plant
from updyn.control.ports import Port, as_ports
from updyn.control.settings import PLANT_FAMILY
from updyn.control.shared import SharedPlantBasis
from updyn.control.structure import CompiledStructure
from updyn.control.target import CandidateSelection
from updyn.dofs import Dof
from updyn.dynamics.affine import State
from updyn.engines import Engine, opened_engine
from updyn.errors import ModelError, OptionError, SolverError, suggest
from updyn.frf import check_lines
from updyn.model import Model
from updyn.population.result import PopulationResult
from updyn.sensitivity import Unknowns
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.gaussian import draw_normal, draw_values, name_undetermined
from updyn.uncertainty.restored import AT_MINIMUM
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.result import JointResult, UpdateResult, find_result

if TYPE_CHECKING:
    from distributed import Client


__all__ = ["PlantFamily", "plant_families", "plant_family"]


#: By error measure, the route used if that of the nominal plant fails for a member.
_FALLBACK_ROUTES = {"relative": "rational", "peak": "complex"}


@dataclass(frozen=True, slots=True, eq=False)
class PlantFamily:
    """A nominal plant and plants at draws of the parameters, with equal ports and quantities.

    `nominal` is the plant at the estimate; `values`, shape (n, n_unknowns), are the draws by
    member, in the unit of each parameter; `facts` is the provenance. The number of modes may
    differ. Raises ModelError without members, or if ports or shapes do not agree.
    """

    nominal: Plant
    members: tuple[Plant, ...]
    names: tuple[str, ...] = ()
    values: RealArray = field(default_factory=lambda: np.zeros((0, 0)))
    facts: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "members", tuple(self.members))
        object.__setattr__(self, "names", tuple(self.names))
        if not self.members:
            raise ModelError("a family needs at least one member besides the nominal plant")
        for number, member in enumerate(self.members):
            for what in ("inputs", "outputs", "quantities", "dt", "delay"):
                member_value, nominal = getattr(member, what), getattr(self.nominal, what)
                if member_value != nominal:
                    raise ModelError(
                        f"member {number}: {what} {member_value!r}; the nominal plant has"
                        f" {nominal!r}"
                    )
        values = np.array(self.values, dtype=np.float64)
        if values.size == 0:
            values = values.reshape(len(self.members), 0)
        if values.shape != (len(self.members), len(self.names)):
            raise ModelError(
                f"values has shape {values.shape}; expected {(len(self.members), len(self.names))},"
                " a row per member and a column per unknown"
            )
        values.flags.writeable = False
        object.__setattr__(self, "values", values)

    def __len__(self) -> int:
        return len(self.members)

    def __repr__(self) -> str:
        return f"PlantFamily({len(self)} members of {len(self.names)} unknowns at {self.nominal!r})"

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return self.nominal.inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return self.nominal.outputs

    @property
    def error(self) -> float:
        """Largest error of a plant of the family against its model, as `Plant.error`."""
        return max(p.error for p in (self.nominal, *self.members))

    def response(self, freq: ArrayLike) -> ComplexArray:
        """Return the responses of the members at lines in Hz, shape (n, n_f, n_y, n_u)."""
        lines = check_lines(np.atleast_1d(np.asarray(freq)))
        if (
            lines[0] == 0.0 or self.nominal.dt is not None
        ):  # may lie on a pole, or above half the sampling rate: `Plant.response` reports it
            return np.array([member.response(lines).values for member in self.members])
        return np.array([sweep(member, lines) for member in self.members])

    def spread(self, freq: ArrayLike) -> tuple[RealArray, RealArray]:
        """Return the smallest and largest magnitude over all plants at lines in Hz."""
        size = np.abs(
            np.concatenate([self.nominal.response(freq).values[None], self.response(freq)])
        )
        return size.min(axis=0), size.max(axis=0)

    def summary(self) -> str:
        """Return source, errors and range of the natural frequencies as text."""
        lines = [
            f"Family: {len(self)} members of {len(self.names)} unknowns,"
            f" {self.facts.get('source', 'given')}"
        ]
        lines += [
            f"Largest error of a plant against its model: {self.error:.2g} (tolerance:"
            f" {self.nominal.tolerance:g})"
        ]
        modes = [p.modes for p in self.members]
        if len({len(m) for m in (self.nominal.modes, *modes)}) == 1 and len(self.nominal.modes):
            low, high = np.min(modes, axis=0), np.max(modes, axis=0)
            lines.append(f"{'mode':>6}{'nominal Hz':>14}{'lowest':>14}{'highest':>14}")
            rows = enumerate(zip(self.nominal.modes, low, high, strict=True), 1)
            lines += [f"{i:>6}{f:>14.6g}{a:>14.6g}{b:>14.6g}" for i, (f, a, b) in rows]
        else:
            counts = [p.n_states for p in (self.nominal, *self.members)]
            text = str(min(counts))
            if max(counts) > min(counts):
                text += f" to {max(counts)}"
            lines.append(f"The plants have {text} states.")
        cut = self.facts.get("cut", {})
        for name, share in cut.items():
            lines.append(f"{100 * share:.0f} % of the draws of {name} lie on its bound.")
        return "\n".join([*lines, *filter(None, [self.facts.get("note", "")])])

    def channel(self, output: str, input: str) -> PlantFamily:
        """Return the family between two named ports; raises OptionError for an unknown name."""
        return self.each(lambda plant: plant.channel(output, input))

    def each(self, change: Callable[[Plant], Plant]) -> PlantFamily:
        """Return the family with a function applied to every plant."""
        members = tuple(map(change, self.members))
        return replace(self, nominal=change(self.nominal), members=members)


def plant_family(
    result: UpdateResult | JointResult | PopulationResult,
    inputs: Iterable[str | Dof | Port] | str | Dof | Port,
    outputs: Iterable[str | Dof | Port] | str | Dof | Port,
    band: Sequence[float],
    tolerance: float = 0.02,
    *,
    quantity: str | Sequence[str] = "receptance",
    route: str = "auto",
    error: str = "relative",
    tier: str | None = None,
    backend: str | None = None,
    n: int = 20,
    seed: int = 0,
    draws: Draws | None = None,
    test: str | None = None,
    engine: int | Client | Engine | None = None,
) -> PlantFamily:
    """Make the plant of an update and plants at draws of its parameters.

    Parameters
    ----------
    result : UpdateResult, JointResult or PopulationResult
        An update that ended at a minimum. A population (`updyn.update_population`): the nominal
        plant is at the mean, and members are further structures of the design.
    inputs, outputs, band, tolerance, quantity, route, error, tier, backend
        As for `updyn.plant`. Every plant holds the tolerance against its own model with structural
        damping; all are made by one route. Members keep the modes of the nominal plant, or as many
        states of a rational approximation, and others only if these do not hold the tolerance.
        Without `tier` one basis serves all: it is made at the estimate and enriched at separate
        draws; a member for which its error is too large is made separately.
    n : int
        Number of members.
    seed : int
        Seed of the draws; member i does not depend on `n` or on the engine.
    draws : Draws, optional
        Draws of a bootstrap or a sampling (`updyn.bootstrap`, `updyn.sample`), of which `n` equally
        spaced ones are used. By default draws from the covariance of the update, or from the
        prediction of a population.
    test : str, optional
        Name of the test, or specimen, whose model is used, if there are several models.
    engine : None, int, dask.distributed Client or Engine
        Engine that makes the members, as for `updyn.update`; it does not affect them.

    Returns
    -------
    PlantFamily
        `facts` hold ``source`` (``"covariance"``, ``"population"``, ``"bootstrap"``,
        ``"sampling"``), ``n``, ``seed``, ``route``, ``status`` of the update, ``cut`` (by
        parameter, the share of draws that were clipped at a bound) and ``note``.

    Raises
    ------
    OptionError
        If an option is invalid, the update did not end at a minimum, the data do not determine a
        parameter of the model (the message gives advice), or there are fewer draws than `n` or
        draws of another update.
    ModelError, SolverError, DofError
        As `updyn.plant`; the message names the member and its parameter values.

    Notes
    -----
    The covariance is that of a Gaussian in the coordinates of the fit: logarithms of factors, and
    loss factors without a transformation. Draws beyond a bound are clipped to it: a loss factor
    that cannot be distinguished from 0 is 0 in half of the members, as in a bootstrap. Given draws
    need neither the clipping nor a Gaussian likelihood.

    The spread is the uncertainty due to the data. It does not include the error of a wrong model
    (`UpdateResult.adequacy`).

    Unknowns of a population follow Student's distribution in their own units, as
    `PopulationResult.prediction_intervals`: the scatter over structures and the error of the mean.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> family = updyn.plant_family(result, ["12:X"], ["12:X"], (0.5, 6.0), n=3)
    >>> len(family)
    3
    """
    _check_numbers(n, seed)
    ports = as_ports(inputs, "input"), as_ports(outputs, "output")
    if isinstance(result, PopulationResult):
        if draws is not None:
            raise OptionError("plant_family: draws are those of an update, not of a population")
        test_result = _find_mean(result, test)
        drawn = _draw_from_population(result, int(n), seed)
    else:
        test_result = _check_ended(find_result(result, test))
        if draws is None:
            drawn = _draw_from_covariance(test_result, int(n), seed)
        else:
            drawn = _thin_draws(result, draws, int(n))
    options = {"quantity": quantity, "error": error, "tier": tier, "backend": backend}
    with opened_engine(engine) as opened:
        making = _PlantMaker(
            test_result.start, test_result.parameters, *ports, band, tolerance, options
        )
        return making.family(test_result, drawn, route, opened, seed)


def plant_families(
    updates: Sequence[UpdateResult],
    inputs: Iterable[str | Dof | Port] | str | Dof | Port,
    outputs: Iterable[str | Dof | Port] | str | Dof | Port,
    band: Sequence[float],
    tolerance: float,
    *,
    route: str,
    n: int,
    seed: int,
    engine: int | Client | Engine | None,
    options: Mapping[str, Any],
) -> tuple[PlantFamily, ...]:
    """Return a family of plants of each update, all at the same draws of the first one's unknowns.

    The others have some or all of its unknowns; `options` are quantity, error, tier and backend of
    `plant_family`.
    """
    _check_numbers(n, seed)
    first = _check_ended(updates[0])
    ports = as_ports(inputs, "input"), as_ports(outputs, "output")
    drawn = _draw_from_covariance(first, int(n), seed)
    families = []
    with opened_engine(engine) as opened:
        for one in updates:
            making = _PlantMaker(one.start, one.parameters, *ports, band, tolerance, options)
            columns = [first.parameters.names.index(name) for name in one.parameters.names]
            families.append(making.family(one, drawn.select(columns), route, opened, seed))
    return tuple(families)


def _check_numbers(n: object, seed: object) -> None:
    """Raise OptionError for an invalid number of members or seed."""
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
        raise OptionError(f"plant_family: n = {n!r}; expected a number of members from 1 up")
    most = PLANT_FAMILY.most_members
    if n > most:
        raise OptionError(f"plant_family: n = {n}; expected at most {most:,} members")
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise OptionError(f"plant_family: seed = {seed!r}; expected a whole number from 0 up")


@dataclass(frozen=True, slots=True, eq=False)
class _ParameterDraws:
    """Draws of the parameters of the members, shape (n, n_unknowns), with their method.

    `training` are draws that enrich the basis of all members, independent of n and the seed; `cut`
    are the shares that were clipped at a bound, by parameter.
    """

    values: RealArray
    training: RealArray
    source: str
    note: str = ""
    cut: Mapping[str, float] = field(default_factory=dict)

    def select(self, columns: Sequence[int]) -> _ParameterDraws:
        """Return the draws of some parameters."""
        at = list(columns)
        return replace(self, values=self.values[:, at], training=self.training[:, at])


@dataclass(frozen=True, slots=True, eq=False)
class _FamilyBasis:
    """The basis shared by all members, and the states of the model."""

    plants: SharedPlantBasis
    estimate: State
    states: tuple[State, ...]
    holds: BoolArray


def _share_basis(result: UpdateResult, making: _PlantMaker, drawn: _ParameterDraws) -> _FamilyBasis:
    """Return the basis of all members, and for which of them it is accurate."""
    structure = CompiledStructure.of(result)
    unknowns = Unknowns.find(structure.system, result.parameters)
    states = [unknowns.state(structure.system, row) for row in drawn.values]
    training = [unknowns.state(structure.system, row) for row in drawn.training]
    plants, holds = SharedPlantBasis.of(
        structure,
        (training, states),
        making.inputs,
        making.outputs,
        making.band,
        making.tolerance,
        making.options["quantity"],
        making.options["error"],
        making.options["backend"],
    )
    return _FamilyBasis(plants, structure.system.start, tuple(states), holds)


@dataclass(frozen=True, slots=True, eq=False)
class _PlantMaker:
    """The inputs of every member: the start model, its parameters, ports and options."""

    start: Model
    parameters: ParameterSet
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    band: Sequence[float]
    tolerance: float
    options: Mapping[str, Any]

    def family(
        self, result: UpdateResult, drawn: _ParameterDraws, route: str, engine: Engine, seed: int
    ) -> PlantFamily:
        """Return the plant of an update and those of draws, with their provenance."""
        shared = None if self.options["tier"] is not None else _share_basis(result, self, drawn)
        nominal, members = self.plants(result.model, shared, drawn.values, route, engine)
        facts = {
            "source": drawn.source,
            "n": len(members),
            "seed": seed,
            "route": nominal.route,
            "status": result.status,
            "cut": drawn.cut,
            "note": drawn.note,
        }
        names = tuple(self.parameters.names)
        return PlantFamily(nominal, members, names, drawn.values, facts)

    def plant(self, model: Model, route: str) -> Plant:
        """Return the plant of a model without the shared basis."""
        return plant(
            model, self.inputs, self.outputs, self.band, self.tolerance, route=route, **self.options
        )

    def plants(
        self,
        model: Model,
        shared: _FamilyBasis | None,
        values: RealArray,
        route: str,
        engine: Engine,
    ) -> tuple[Plant, tuple[Plant, ...]]:
        """Return the plant of the estimate and those of the members, by one route."""
        # A conversion that suffices for the nominal plant may not suffice for all members.
        nominal, kept = self._nominal(model, shared, route)
        try:
            return nominal, self._members(shared, values, nominal.route, kept, engine)
        except ModelError:
            closest = _FALLBACK_ROUTES[self.options["error"]]
            if route != "auto" or nominal.route == closest:
                raise
        nominal, kept = self._nominal(model, shared, closest)
        return nominal, self._members(shared, values, closest, kept, engine)

    def _nominal(
        self, model: Model, shared: _FamilyBasis | None, route: str
    ) -> tuple[Plant, CandidateSelection | None]:
        if shared is None:
            return self.plant(model, route), None
        return shared.plants.member(shared.estimate, route)

    def _members(
        self,
        shared: _FamilyBasis | None,
        values: RealArray,
        route: str,
        kept: CandidateSelection | None,
        engine: Engine,
    ) -> tuple[Plant, ...]:
        items: list[tuple[int, RealArray, State | None]] = []
        for number, row in enumerate(values):
            state = None
            if shared is not None and shared.holds[number]:
                state = shared.states[number]
            items.append((number, row, state))
        plants = None if shared is None else shared.plants
        return tuple(engine.map(_member, (self, plants, route, kept), items))


def _member(
    about: tuple[_PlantMaker, SharedPlantBasis | None, str, CandidateSelection | None],
    item: tuple[int, RealArray, State | None],
) -> Plant:
    """Return a member, with the shared basis if it is accurate, else without."""
    (making, shared, route, kept), (number, values, state) = about, item
    try:
        if shared is not None and state is not None:
            return shared.member(state, route, kept)[0]
        return making.plant(making.parameters.apply(making.start, values), route)
    except (ModelError, SolverError) as error:
        named = zip(making.parameters.names, values, strict=True)
        at = ", ".join(f"{name} = {value:.6g}" for name, value in named)
        raise type(error)(f"member {number} of the family ({at}): {error}") from error


def _check_ended(result: UpdateResult) -> UpdateResult:
    """Return a result after a check that the fit ended at a minimum."""
    if result.status not in AT_MINIMUM:
        raise OptionError(
            f"plant_family: the update ended as {result.status!r}, not at a minimum:"
            f" {result.message}"
        )
    return result


def _draw_from_covariance(result: UpdateResult, n: int, seed: int) -> _ParameterDraws:
    parameters = result.parameters
    unsure = name_undetermined(result)
    if unsure:
        raise OptionError(
            f"plant_family: the data do not determine {unsure}, so the error of the plant is"
            f" unknown. {result.identifiability.advice} Or give draws= of a sampling, in which"
            " priors and bounds limit them."
        )
    drawn, clipped = draw_values(result, draw_normal(len(parameters), n, seed))
    cut = _name_shares(parameters, clipped)
    size = len(parameters)
    training = np.random.default_rng(0).standard_normal((_count_training(size), size))
    wide = draw_values(result, PLANT_FAMILY.training_spread * training)[0]
    return _ParameterDraws(drawn, wide, "covariance", cut=cut)


def _find_mean(population: PopulationResult, name: str | None) -> UpdateResult:
    """Return the result of a specimen with values and model of the mean of the population."""
    results = {key: specimen.result for key, specimen in population.specimens.items()}
    first = next(iter(results.values()))
    if name is None and any(one.start is not first.start for one in results.values()):
        raise OptionError(
            "plant_family: the specimens have several models; test= names the specimen whose model"
            f" is used, such as {next(iter(results))!r}"
        )
    if name is not None and name not in results:
        raise OptionError(f"plant_family: no specimen {name!r}; {suggest(name, results)}")
    one = first if name is None else results[name]
    parameters = population.parameters
    model = parameters.apply(one.start, list(population.mean.values()))
    return replace(
        one,
        parameters=parameters,
        values=population.mean,
        std=population.std,
        covariance=population.covariance,
        model=model,
        kept_basis=None,
    )


def _draw_from_population(population: PopulationResult, n: int, seed: int) -> _ParameterDraws:
    """Return draws of the unknowns of further structures of a design."""
    parameters, freedom = population.parameters, len(population.specimens) - 1
    mean = np.array(list(population.mean.values()))
    size, axes = np.linalg.eigh(population.covariance + population.mean_covariance)
    root = (axes * np.sqrt(np.maximum(size, 0.0))) @ axes.T
    drawn = np.empty((n, len(mean)))
    for number in range(n):
        rng = np.random.default_rng((seed, number))
        z = rng.standard_normal(len(mean))
        drawn[number] = mean + root @ z * np.sqrt(freedom / rng.chisquare(freedom))
    values = np.clip(drawn, parameters.lower, parameters.upper) + 0.0
    cut = _name_shares(parameters, values != drawn)
    training = np.random.default_rng(0).standard_normal((_count_training(len(mean)), len(mean)))
    wide = mean + PLANT_FAMILY.training_spread * training @ root
    wide = np.clip(wide, parameters.lower, parameters.upper) + 0.0
    return _ParameterDraws(values, wide, "population", cut=cut)


def _name_shares(parameters: ParameterSet, clipped: BoolArray) -> dict[str, float]:
    """Return the share of draws that were clipped at a bound, by parameter, if above 0."""
    shares = zip(parameters.names, clipped.mean(axis=0).tolist(), strict=True)
    return {name: share for name, share in shares if share > 0.0}


def _count_training(n_unknowns: int) -> int:
    """Return the number of draws that enrich the basis of all members."""
    wanted = int(np.ceil(PLANT_FAMILY.draws_per_parameter * n_unknowns))
    return max(PLANT_FAMILY.least_training_draws, wanted)


def _thin_draws(result: UpdateResult | JointResult, draws: Draws, n: int) -> _ParameterDraws:
    if not isinstance(draws, Draws):
        raise OptionError(
            "plant_family: expected draws of a bootstrap or a sampling, found"
            f" {type(draws).__name__}"
        )
    known = draws.of(result)
    if len(known) < n:
        raise OptionError(
            f"plant_family: {n} members of {len(known)} draws; make more draws, or ask for fewer"
            " members"
        )
    some = []
    for count in (n, min(_count_training(len(known.names)), len(known))):
        some.append(known.values[np.linspace(0, len(known) - 1, count).round().astype(np.intp)])
    return _ParameterDraws(some[0], some[1], known.kind, known.message)
