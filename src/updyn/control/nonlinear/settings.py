"""Numbers that decide how limit cycles are predicted, simulated and classified."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class HarmonicBalanceSettings:
    """Numbers of the prediction of limit cycles by describing functions."""

    #: [lines] Lines over the band at which the phase is scanned for roots, in addition to those
    #: around poles; more find cycles closer together. Effort: a rule of thumb.
    scan_lines: int = 3000
    #: [half gaps] Amplitude below which a cycle of backlash is doubtful. Why: harmonic balance
    #: deviated there by 10 % from simulation, in amplitude or frequency.
    least_twist: float = 2.0
    #: [1] Third harmonic, as a share of the first, above which a cycle of friction is doubtful.
    #: Why: harmonic balance deviated there by 10 % from simulation, in amplitude or frequency.
    largest_third: float = 0.3


@dataclass(frozen=True)
class MeshSettings:
    """Numbers of the mesh that backlash opens."""

    #: [1] Flexibility across the mesh, as a share of that of the mesh, below which it is 0.
    #: Rounding: rounding of the direct feed-through of a plant.
    least_flexibility: float = 1e-9
    #: [1] Largest deviation of the matrix of a mesh from rank 1, as a share of its largest entry.
    #: Rounding: rounding of the entries of a matrix.
    rank_one_deviation: float = 1e-9


@dataclass(frozen=True)
class OscillationEndSettings:
    """Numbers that classify the end of a simulated oscillation."""

    #: [1] Last share of the time that is classified. Why: a rule of thumb; the first 60 % are the
    #: transient.
    evaluated_share: float = 0.4
    #: [periods] Least number of periods of a limit cycle; up to four times as many are compared.
    #: Why: a rule of thumb.
    least_periods: int = 5
    #: [1] Largest spread of amplitudes and periods of a limit cycle, and least change of a series
    #: that decays or grows. Why: a rule of thumb.
    steady_spread: float = 0.01
    #: [1] Share of the largest amplitude below which an oscillation has decayed. Why: a rule of
    #: thumb.
    decayed_share: float = 0.2


@dataclass(frozen=True)
class LoopSimulationSettings:
    """Numbers of the simulation of a loop with backlash or friction."""

    #: [steps] Steps per period of the fastest oscillation. Why: each step is exact; only contacts
    #: that begin and end within one step are missed (a fortieth of a period).
    steps_per_period: int = 40
    #: [steps] Least number of steps of a simulation. Why: a curve without visible corners.
    least_steps: int = 400
    #: [steps] Largest number of steps of a simulation. Effort: memory; the states of each are kept.
    most_steps: int = 2_000_000
    #: [steps] Halvings of a step that locate a switch. Rounding: 2^-44 of a step is rounding of the
    #: time after a few hundred steps.
    switch_halvings: int = 44
    #: [steps] Steps whose matrix powers are stored and that are computed at once. Effort: a rule of
    #: thumb for speed.
    block_steps: int = 64
    #: [switches] Switches within one step that count as chatter. Effort: a rule of thumb.
    chatter_switches: int = 200


HARMONIC_BALANCE = HarmonicBalanceSettings()
MESH = MeshSettings()
OSCILLATION_END = OscillationEndSettings()
LOOP_SIMULATION = LoopSimulationSettings()
