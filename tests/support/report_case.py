"""A fit as the report gets it: a chain of masses and springs, measured with noise, one combination left open."""

from __future__ import annotations

import dataclasses

import numpy as np

import updyn
from updyn.dynamics.response import response
from updyn.frf import FRF
from updyn.model import Group, Model
from updyn.remedy import Remedy
from updyn.report.section import PageContent, select_sections
from updyn.updating.fit.monitor import Iteration
from updyn.updating.judge.adequacy import Suspect, add_suspects, assess_residual
from updyn.updating.judge.identifiability import Identifiability
from updyn.updating.judge.modal_table import compare_modes
from updyn.updating.problem.parameters import Parameter, ParameterSet, parameters
from updyn.updating.result import UpdateResult


def all_figures(result):
    """Every figure of a page."""
    content = PageContent(result)
    out = {}
    for section in select_sections(content):
        out |= section.figures(content)
    return out


def chain(n=12, k=2.0e6, m=1.5, title=""):
    """Masses in a row, each tied to the next by a spring; the first to the ground."""
    labels = [f"{i + 1}:Z" for i in range(n)]
    groups = {}
    for i in range(n):
        K = np.zeros((n, n))
        K[i, i] = k
        if i:
            K[i - 1, i - 1] = k
            K[i - 1, i] = K[i, i - 1] = -k
        M = np.zeros((n, n))
        M[i, i] = m
        groups[f"bay {i + 1}"] = Group(stiffness=K, mass=M, loss_factor=0.01)
    return Model.from_groups(groups, labels, title=title)


def measured(
    model,
    *,
    n_lines=800,
    band=(4.0, 420.0),
    responses=None,
    references=None,
    noise=0.02,
    coherence=True,
):
    """Accelerance of the model with noise proportional to the level and a floor."""
    rng = np.random.default_rng(7)
    freq = np.linspace(*band, n_lines)
    responses = responses or ["1:Z", "4:Z", "6:-Z", "9:Z", "12:Z"]
    references = references or ["3:Z", "12:Z"]
    H = response(model, freq, responses, references, "accelerance").values
    floor = 0.002 * np.sqrt(np.mean(np.abs(H) ** 2, axis=0))
    sigma = np.sqrt((noise * np.abs(H)) ** 2 + floor**2)
    values = H + sigma * (
        rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)
    ) / np.sqrt(2)
    power = np.abs(H) ** 2
    gamma2 = np.clip(power / (power + 8 * sigma**2), 0.0, 1.0) if coherence else None
    return FRF(
        freq,
        values,
        responses,
        references,
        "accelerance",
        coherence=gamma2,
        averages=8,
        source="impact test 3",
    )


def figures(frac, db):
    return {"frac_median": frac, "db_error_median": db, "csac_mean": frac - 0.03}


def realistic(**changes):
    """A result that settled with one undetermined combination, one response and one band held out, one unknown at a bound."""
    start = chain(title="chain")
    truth = {
        "bay 2": {"stiffness": 0.72, "loss_factor": 0.03},
        "bay 5": {"stiffness": 1.3, "mass": 1.1},
        "bay 8": {"stiffness": 0.6},
        "bay 11": {"mass": 1.2, "loss_factor": 0.022},
    }
    frf = measured(start.scaled(truth))
    chosen = parameters(
        start,
        stiffness=["bay 2", "bay 5", "bay 8"],
        mass=["bay 5", "bay 11"],
        loss_factor=["bay 2", "bay 11"],
        bounds={
            "bay 8.stiffness": (0.6, 1.6),
            "stiffness": (0.4, 2.5),
            "loss_factor": (0.001, 0.2),
        },
        prior_std={"bay 5.mass": 0.3},
    )
    ends = {p.name: truth[p.group][p.quantity] for p in chosen}
    std = {name: abs(v) * 0.004 * (1 + i) for i, (name, v) in enumerate(ends.items())}
    for name in ("bay 5.stiffness", "bay 5.mass"):
        std[name] = np.inf
    sigma = np.array([std[n] for n in chosen.names])
    with np.errstate(invalid="ignore"):
        mix = 0.3 ** np.abs(np.subtract.outer(np.arange(len(chosen)), np.arange(len(chosen))))
        covariance = mix * np.outer(sigma, sigma)
    covariance[~np.isfinite(sigma)] = np.inf
    covariance[:, ~np.isfinite(sigma)] = np.inf
    result = UpdateResult(
        status="not-identifiable",
        message=(
            "The fit converged, but one combination of unknowns changes nothing that was measured."
        ),
        steps=(Remedy("A sensor at 5:Z, or lines around 210 Hz, would determine what is open."),),
        method="maximum-likelihood",
        options={"max_iterations": 50, "tolerance": 1e-8, "tier": "dense", "backend": None},
        start=start,
        model=chosen.apply(start, [ends[n] for n in chosen.names]),
        data=frf,
        lines=frf.freq[10:500:4],
        fitted_responses=("1:Z", "4:Z", "6:-Z", "12:Z"),
        validation_responses=("9:Z",),
        validation_band=(300.0, 420.0),
        parameters=chosen,
        values=ends,
        std=std,
        covariance=covariance,
        at_bound={"bay 8.stiffness": "lower"},
        identifiability=Identifiability(
            rank=len(chosen) - 1,
            n_parameters=len(chosen),
            condition=4.2e15,
            singular_values=(1.9, 1.4, 1.1, 0.8, 0.4, 0.09, 3e-16),
            null_directions=[{"bay 5.stiffness": 1.0, "bay 5.mass": -0.62}],
            determined_directions=[{"bay 5.stiffness": 0.62, "bay 5.mass": 1.0}],
            collinearity=3.3e15,
            advice="A sensor at 5:Z, or lines around 210 Hz, would determine what is open.",
        ),
        history=history(chosen, ends),
        noise={
            "kind": "coherence",
            "relative": 0.02,
            "floor": 0.002,
            "chi_square": 1.08,
            "inflation": 1.0,
        },
        correlation={
            "before": figures(0.41, 7.9),
            "after": figures(0.9973, 0.21),
            "validation": {"before": figures(0.35, 9.2), "after": figures(0.991, 0.3)},
        },
        timing_s={"log": 0.8, "maximum-likelihood": 1.9, "total": 2.9},
        versions={"updyn": "0.1.0", "numpy": np.__version__, "python": "3.11"},
        title="Mast, test 3",
        adequacy=left_over(),
    )
    return dataclasses.replace(result, **changes)


def left_over():
    """What is left of four fitted responses by two references: noise, and in one channel a smooth misfit."""
    rng = np.random.default_rng(11)
    freq = np.linspace(20.0, 220.0, 123)
    e = rng.standard_normal((123, 4, 2)) + 1j * rng.standard_normal((123, 4, 2))
    e[60:80, 2, 1] += 6.0 * np.exp(0.1j * np.arange(20))
    e[:, 0, 0] *= 1.9
    H = sum(1.0 / (f0**2 - freq**2 + 0.02j * f0**2) for f0 in (45.0, 95.0, 140.0, 190.0))
    at = ("1:Z", "4:Z", "6:-Z", "12:Z"), ("3:Z", "12:Z")
    found = assess_residual(
        e, H[:, None, None] * np.ones((4, 2)), freq, *at, n_unknowns=7, absolute=True
    )
    suspects = [
        Suspect("bay 9", "stiffness", 0.93, 0.2, 0.4, confirmed=True),
        Suspect("bay 9", "loss_factor", 0.2, -0.01, 0.4, confirmed=True),
    ]
    return add_suspects(found, suspects)


def history(chosen, ends, stages=("log", "maximum-likelihood"), n=9):
    """Steps that come down in two stages, each with a refused one."""
    out, at = [], np.array(chosen.start)
    goal = np.array([ends[p.name] for p in chosen])
    for number in range(n):
        accepted = number not in (3, 7)
        if accepted and number:
            at = at + 0.55 * (goal - at)
        stage = stages[0] if number < 5 else stages[1]
        cost = (3e5 if number < 5 else 6e3) * 0.3**number + 800.0 + (0 if accepted else 4e3)
        out.append(
            Iteration(
                stage,
                number,
                cost,
                0.5**number,
                1e4,
                accepted,
                dict(zip(chosen.names, at, strict=True)),
            )
        )
    return tuple(out)


def smallest():
    """One channel, few lines, one unknown, no history, nothing held out, no noise model, no coherence."""
    start = chain(2)
    frf = measured(
        start.scaled({"bay 1": {"stiffness": 1.2}}),
        n_lines=12,
        responses=["1:Z"],
        references=["2:Z"],
        coherence=False,
    )
    chosen = parameters(start, stiffness=["bay 1"])
    ident = Identifiability(1, 1, 1.0, (1.0,), [], [], 1.0, "")
    return realistic(
        start=start,
        model=chosen.apply(start, [1.2]),
        data=frf,
        lines=frf.freq,
        fitted_responses=("1:Z",),
        validation_responses=(),
        validation_band=None,
        parameters=chosen,
        values={"bay 1.stiffness": 1.2},
        std={"bay 1.stiffness": 0.01},
        covariance=np.array([[1e-4]]),
        at_bound={},
        identifiability=ident,
        history=(),
        noise={},
        correlation={"before": {}, "after": {}},
        status="converged",
        message="",
        steps=(),
        title="",
        adequacy=None,
    )


def largest(n_responses=100, n_references=10, n_lines=2000, n_unknowns=100):
    """As many channels, lines and unknowns as a report has to bear; two unknowns open.

    Its modes are given: to find those of 1,000 channels would take most of the time.
    """
    start = chain(n_responses)
    labels = start.dofs.labels
    frf = measured(
        start,
        n_lines=n_lines,
        responses=labels,
        references=labels[:: n_responses // n_references][:n_references],
    )
    items = tuple(
        Parameter(
            f"bay {i // 2 + 1}",
            ("stiffness", "loss_factor")[i % 2],
            (1.0, 0.01)[i % 2],
            0.001,
            10.0,
        )
        for i in range(n_unknowns)
    )
    chosen = ParameterSet(items)
    rng = np.random.default_rng(3)
    ends = {p.name: p.start * float(np.exp(0.2 * rng.standard_normal())) for p in chosen}
    std = {p.name: p.start * 0.05 for p in chosen}
    std[chosen.names[0]] = std[chosen.names[1]] = np.inf
    covariance = np.diag([std[n] ** 2 for n in chosen.names])
    covariance[:2] = covariance[:, :2] = np.inf
    ident = Identifiability(
        n_unknowns - 2,
        n_unknowns,
        np.inf,
        (*np.geomspace(3, 1e-3, n_unknowns - 2).tolist(), 0.0, 0.0),
        [dict.fromkeys(chosen.names[:40], 1.0)],
        [],
        np.inf,
        "",
    )
    modes = updyn.modes(start, 6)
    measured_modes = updyn.ModeSet(modes.frequency, modes.shapes, start.dofs)
    return realistic(
        start=start,
        model=chosen.apply(start, [ends[n] for n in chosen.names]),
        data=frf,
        modes=compare_modes(start, None, measured_modes),
        lines=frf.freq,
        fitted_responses=tuple(labels),
        validation_responses=(),
        validation_band=None,
        parameters=chosen,
        values=ends,
        std=std,
        covariance=covariance,
        at_bound={},
        identifiability=ident,
        history=history(chosen, ends),
    )


HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>\"' &amp; <!--"


def hostile():
    name = "</script><b onmouseover=alert(3)>@after"
    start = chain(2)
    start = Model.from_groups(
        {name: start.groups["bay 1"], "bay 2": start.groups["bay 2"]}, start.dofs
    )
    chosen = ParameterSet(
        (
            Parameter(name, "stiffness", 1.0, 0.5, 2.0),
            Parameter("bay 2", "stiffness", 1.0, 0.5, 2.0),
        )
    )
    frf = dataclasses.replace(
        measured(start, n_lines=20, responses=["1:Z", "2:Z"], references=["2:Z"]), source=HOSTILE
    )
    values = {f"{name}.stiffness": 1.1, "bay 2.stiffness": 1.0}
    return realistic(
        start=start, model=start, data=frf, lines=frf.freq, fitted_responses=("1:Z", "2:Z"), validation_responses=(),
        validation_band=None, parameters=chosen, values=values, std=dict.fromkeys(values, 0.1),
        covariance=np.eye(2) * 0.01, at_bound={}, history=(), title=HOSTILE, message=HOSTILE, steps=(Remedy(HOSTILE),),
        options={HOSTILE: HOSTILE}, versions={"updyn": HOSTILE}, timing_s={HOSTILE: 1.0}, noise={HOSTILE: HOSTILE},
        identifiability=Identifiability(1, 2, 1e9, (1.0, 1e-9), [dict.fromkeys(values, 1.0)], [], 1e9, HOSTILE),
    )  # fmt: skip
