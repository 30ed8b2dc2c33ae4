"""Numbers that decide how tests are planned."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PlanSettings:
    """Defaults, limits and extent of a plan."""

    #: [lines] Default number of lines. Default: about those of a usual test; the layout depends
    #: little on it (a rule of thumb).
    lines: int = 200
    #: [lines] Largest number of lines. Effort: the model is solved at each, and all sensitivities
    #: are in memory.
    most_lines: int = 100_000
    #: [draws] Default number of draws of the start of the parameters. Effort: a rule of thumb.
    starts: int = 4
    #: [draws] Largest number of draws of the start. Effort: the plan is computed at each.
    most_starts: int = 1_000
    #: [DOFs] Number of further sensors and forces with a stated gain. Drawing: enough to decide on
    #: more of them (a rule of thumb).
    further_items: int = 5
    #: [1] Number of parts of the band with a stated gain. Drawing: a resolution of a tenth of the
    #: band.
    band_parts: int = 10
    #: [items] Largest number of parameters in a message, and of further sensors in a summary.
    #: Drawing: more names are hard to read.
    named_items: int = 3


@dataclass(frozen=True)
class InformationSettings:
    """Numbers of the information of all pairs of candidates."""

    #: [bytes] Largest memory for the information of all pairs. Effort: available on any computer.
    most_bytes: int = 2**30
    #: [bytes] Memory for the derivatives that are processed at a time. Effort: about the size of
    #: the cache of a processor.
    chunk_bytes: int = 32 * 2**20
    #: [1] Number of pieces into which the lines are divided, for workers and for stopping. Effort:
    #: a stop takes a sixteenth of the time of a point.
    pieces: int = 16
    #: [1] Level of a channel over that of the largest one of its unit below which it is rounding.
    #: Rounding: above the rounding of a solution.
    rounding: float = 1e-9


@dataclass(frozen=True)
class LayoutSearchSettings:
    """Numbers of the search for the best layout."""

    #: [references] Number of references, those with the best separate scores, from each of which a
    #: layout is searched. Effort: a rule of thumb.
    starts: int = 6


@dataclass(frozen=True)
class ScreeningSettings:
    """Numbers of the screening of candidates."""

    #: [pairs] Number of pairs of candidates above which they are screened. Effort: a rule of thumb.
    most_pairs: int = 40_000
    #: [lines] Number of lines at which candidates are screened. Effort: a rule of thumb.
    lines: int = 16
    #: [DOFs] Number of translations, and of rotations, in a sample of the candidates. Effort: a
    #: rule of thumb.
    sampled_dofs: int = 40
    #: [DOFs] Least number of kept responses. Effort: a rule of thumb.
    least_responses: int = 96
    #: [DOFs] Least number of kept references. Effort: a rule of thumb.
    least_references: int = 24
    #: [1] Number of kept candidates for each selected one. Effort: more change the layout little (a
    #: rule of thumb).
    kept_per_selected: int = 6
    #: [references] Number of references that each start a layout whose responses are kept. Effort:
    #: a rule of thumb.
    layouts: int = 8


@dataclass(frozen=True)
class CandidateReductionSettings:
    """Numbers of the reduced model of the candidates."""

    #: [DOFs] Number of DOFs above which models are reduced. Effort: smaller ones are solved
    #: quickly.
    most_exact_dofs: int = 600
    #: [1] Largest error, relative to the largest receptance of a line. Effort: above it, the
    #: model itself is solved; it is below the noise of a test.
    most_error: float = 1e-2
    #: [states] Least number of states of a basis, each solved at another shift. Effort: a rule of
    #: thumb.
    least_states: int = 6
    #: [1] Shifts, in squares of the highest frequency, one for each state in turn. Effort:
    #: distributed over the band (a rule of thumb).
    shifts: tuple[float, ...] = (0.2, 0.5, 0.8)
    #: [moments] Number of moments of the fields at a shift. Effort: fields change smoothly with
    #: frequency between the shifts (a rule of thumb).
    depth: int = 4
    #: [vectors] Number of random combinations of the responses at a shift. Effort: a rule of thumb.
    combinations: int = 8
    #: [1] Square root of the share of the energy of the fields that may be dropped. Rounding: a
    #: hundredth of the accepted error.
    dropped_energy_root: float = 1e-4
    #: [lines] Number of lines at which the error is certified. Effort: a rule of thumb.
    certified_lines: int = 40


PLANNING = PlanSettings()
INFORMATION = InformationSettings()
LAYOUT_SEARCH = LayoutSearchSettings()
SCREENING = ScreeningSettings()
CANDIDATE_REDUCTION = CandidateReductionSettings()
