"""Numbers that decide what commands print and how long they wait."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DescriptionSettings:
    """Limits of what commands print."""

    #: [items] Number of names, keys or DOFs that a line lists. Drawing: chosen for one line of
    #: text.
    listed_items: int = 8
    #: [DOFs] Largest model whose natural frequencies are computed. Effort: a few seconds.
    most_mode_dofs: int = 20_000
    #: [modes] Number of natural frequencies. Drawing: chosen for one line of text.
    natural_frequencies: int = 8
    #: [groups] Largest model without a hint on merging groups. Why: a rule of thumb; with two
    #: unknowns a group, a larger model has more than 60.
    many_groups: int = 30
    #: [families] Families of groups in the hint. Drawing: chosen for one line of text.
    merging_examples: int = 2
    #: [rows] Rows of a table of pairs of DOFs, the worst first. Drawing: chosen for one screen.
    table_rows: int = 20
    #: [1] Lines with a coherence below this limit are counted. Why: a common limit in modal
    #: testing.
    low_coherence: float = 0.9
    #: [bytes] Start of a file that identifies it. Effort: longer than the headers of all formats.
    start_bytes: int = 4096


@dataclass(frozen=True)
class LayoutSettings:
    """Layout of what commands print after their work."""

    #: [lines] Most lines of the outcome of a run. Why: with the prompt and the command, half of a
    #: common window of 50 lines; a rule of thumb.
    outcome_lines: int = 20
    #: [rows] Rows of a table of an outcome, the largest or worst first. Why: chosen for one glance.
    outcome_rows: int = 5
    #: [rows] Rows of a table that is the outcome: modes, methods. Drawing: the outcome of such a
    #: command is at most 25 lines.
    table_rows: int = 15
    #: [combinations] Undetermined combinations that are printed before a fit. Drawing: each has as
    #: many terms as there are unknowns, and takes several lines.
    combinations: int = 2
    #: [lines] Notes on a further result such as a plant, and lines on one before a fit. Drawing:
    #: chosen for one glance.
    notes: int = 3
    #: [dB] Level differences below this are printed as a limit. Why: those of exact fits are
    #: rounding; no measurement is as accurate.
    least_level: float = 1e-4
    #: [columns] Least width that is assumed of a terminal. Drawing: numbers need three columns next
    #: to a name; narrower terminals break lines themselves.
    least_width: int = 40
    #: [columns] Least width to which sentences in a table are wrapped. Drawing: a few words a line;
    #: a rule of thumb.
    least_text_width: int = 24


@dataclass(frozen=True)
class WaitingSettings:
    """Times that commands wait."""

    #: [s] Longest wait for the answer of a Dask scheduler. Effort: a rule of thumb for networks.
    scheduler_time: float = 10.0
    #: [s] Time for the process to end by itself after a second signal. Effort: a running
    #: factorisation cannot be interrupted.
    grace_time: float = 3.0
    #: [s] Delay of the answer to a signal while its handler has not run. Effort: short enough to
    #: seem immediate.
    answer_time: float = 0.2
    #: [s] Delay before a lost signal is sent again. Effort: longer than a destructor or callback.
    resend_time: float = 0.02
    #: [objects] New objects after which unreachable ones are searched for. Effort: with Python's
    #: 700, the search takes a tenth of the import of all modules, which free nothing.
    new_objects: int = 20_000


DESCRIPTION = DescriptionSettings()
LAYOUT = LayoutSettings()
WAITING = WaitingSettings()
