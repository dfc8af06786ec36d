"""Numbers behind the figures: an effect's law with the data that it explains, its likelihood, and forecasts."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.hypotheses.space import Hypothesis, unit_of
from simgap.diagnosis.inference.evidence.score_test import vary
from simgap.diagnosis.likelihood.problem import Fit, Problem, raw_innovations, trials, value_of
from simgap.diagnosis.likelihood.segments import RUN_IN, counted
from simgap.diagnosis.likelihood.student_t import log_density
from simgap.diagnosis.report.experiment import Experiment
from simgap.diagnosis.report.localisation import Excess
from simgap.diagnosis.validation.forecast import Contestant, forecast, window
from simgap.kinematics import to_own_frame
from simgap.rows import by_row
from simgap.types import Recording

BINS = 16
PROFILE = 25
SHOWN_S = 12.0
"""Length of the rollouts shown [s]."""


def laws(problem: Problem, fit: Fit, hypothesis: Hypothesis, found: Excess) -> list[dict]:
    """Figures of one effect: its contribution to an output over a feature, and the likelihood of its constant."""
    shown = {"effect": hypothesis.effect.id, "form": hypothesis.effect.form, "where": hypothesis.where}
    return [shown | p for p in (*_explained(problem, fit, hypothesis, found), *_profile(problem, fit, hypothesis))]


def _explained(problem: Problem, fit: Fit, hypothesis: Hypothesis, found: Excess) -> list[dict]:
    """The effect's contribution to its main output (line), and the same plus the residuals (dots)."""
    without = vary(fit.v, hypothesis, [0.0] * len(hypothesis.groups))
    layout, state = problem.augmented.layout, counted(problem.chunks, np.asarray(problem.chunks.state)[:, :-1])
    # In the bodies' own frames, like commands: in the world frame the law depends on the robot's heading.
    innovations = [counted(problem.chunks, raw_innovations(problem, v)) for v in (without, fit.v)]
    raw = [by_row(to_own_frame, layout, e, state) for e in innovations]
    law = raw[0] - raw[1]
    noise = 1.4826 * np.median(np.abs(raw[1]), axis=0) + 1e-9
    output = int(np.argmax((law**2).mean(0) / noise**2))
    field = layout.schema.state[output]
    unit = np.eye(law.shape[1])[[output]]
    frame = ", in its own frame" if (by_row(to_own_frame, layout, unit, np.ones_like(state[:1])) != unit).any() else ""
    features, names, units = _features(problem, found)
    best = max(range(len(names)), key=lambda k: _explained_by(features[:, k], law[:, output]))
    x, y, residual = features[:, best], law[:, output], raw[1][:, output]
    members = binned(x)
    if len(members) < 3:
        return []
    centre, line = [float(x[m].mean()) for m in members], [float(y[m].mean()) for m in members]
    return [{
        "title": f"Effect on {field.name}{frame}",
        "x_label": f"{names[best]} [{units[best]}]",
        "y_label": f"one-step error of the simulator [{field.unit}]",
        "x": centre, "y": [at + float(np.median(residual[m])) for at, m in zip(line, members, strict=True)],
        "y_err": [_error_of_median(residual[m]) for m in members],
        "line_x": centre, "line_y": line,
        "caption": "Line: the law. Dots: the law plus the median of the residuals (95 % interval).",
    }]  # fmt: skip


def _features(problem: Problem, found: Excess) -> tuple[np.ndarray, list[str], list[str]]:
    """Features that describe regimes, and recent changes of each command, which show delays and lags."""
    fields, sent = problem.augmented.simulator.schema.command, np.asarray(problem.chunks.command)
    columns, names, units = [found.features], list(found.names), list(found.units)
    for rows, span in ((1, "a row"), (2, "two rows")):
        change = sent - np.concatenate([np.repeat(sent[:, :1], rows, axis=1), sent[:, :-rows]], axis=1)
        columns.append(counted(problem.chunks, change[:, :-1]))
        names += [f"change of {f.name} in {span}" for f in fields]
        units += [f.unit for f in fields]
    return np.hstack(columns), names, units


def binned(x: Float[np.ndarray, " n"]) -> list[np.ndarray]:
    """Row indices of each quantile bin, in order; without bins of few rows."""
    edges = np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)))
    members = [np.flatnonzero((x >= a) & (x <= b)) for a, b in pairwise(edges)]
    return [m for m in members if len(m) > 5]


def _error_of_median(y: np.ndarray) -> float:
    """Half of the median's 95 % interval. A mean would be dominated by outlier rows, which hardly count in the fit."""
    spread = 1.4826 * np.median(np.abs(y - np.median(y)))
    return float(1.96 * np.sqrt(np.pi / 2) * spread / np.sqrt(len(y)))


def _explained_by(x: np.ndarray, y: np.ndarray) -> float:
    """Sum of squares of y's mean in bins of x."""
    edges = np.quantile(x, np.linspace(0, 1, BINS + 1))
    index = np.clip(np.searchsorted(edges, x) - 1, 0, BINS - 1)
    count = np.bincount(index, minlength=BINS)
    mean = np.bincount(index, y, minlength=BINS) / np.maximum(count, 1)
    return float((count * mean**2).sum())


def _profile(problem: Problem, fit: Fit, hypothesis: Hypothesis) -> list[dict]:
    """Log-likelihood along the effect's first constant, all else fixed."""
    group, constant = hypothesis.groups[0], hypothesis.effect.constants[0]
    c = [value_of(fit.v, g) for g in hypothesis.groups]
    low, high = (float(b[group.entries[0]]) for b in problem.augmented.bounds)
    span = np.linspace(max(0.4 * c[0], low) if c[0] > 0 else max(1.6 * c[0], low),
                       min(1.6 * c[0], high) if c[0] > 0 else min(0.4 * c[0], high), PROFILE)  # fmt: skip
    e = trials(problem, [vary(fit.v, hypothesis, [x, *c[1:]]) for x in span])
    loglik = np.array([log_density(one, fit.noise).sum() for one in e])
    x = [float(constant.physical(float(v), hypothesis.sites[0], problem.scales)) for v in span]
    unit = unit_of(problem.augmented, hypothesis, constant)
    keep = np.isfinite(loglik) & np.isfinite(x)
    order = np.argsort(np.array(x)[keep])
    return [{
        "title": f"Likelihood of the {constant.name}",
        "x_label": f"{constant.name} [{unit}]", "y_label": "log-likelihood [nats]",
        "x": [], "y": [], "y_err": [],
        "line_x": np.array(x)[keep][order].tolist(), "line_y": (loglik - loglik.max())[keep][order].tolist(),
        "caption": "Relative to the maximum. All other constants are fixed at their estimates.",
    }]  # fmt: skip


def rollouts(problem: Problem, recording: Recording, contestants: dict[str, Contestant]) -> list[dict]:
    """Forecasts of every output by every model, over the busiest window of a held-out recording."""
    steps = min(int(SHOWN_S / problem.scales.time_step), len(recording.time_s) - RUN_IN - 2)
    if steps < 2:
        return []
    piece = window(recording, problem.scales.time_step, steps, int(np.argmax(activity(recording, steps))))
    predicted = {name: forecast(problem, c, piece)[0] for name, c in contestants.items()}
    time = np.asarray(piece.time_s)[0, RUN_IN + 1 :]
    measured = np.asarray(piece.state)[0, RUN_IN + 1 :]
    return [
        {"session": recording.name, "output": f.name, "unit": f.unit, "time_s": time, "measured": measured[:, i],
         **{name: p[:, i] for name, p in predicted.items()}}
        for i, f in enumerate(problem.augmented.simulator.schema.outputs)
    ]  # fmt: skip


def activity(recording: Recording, steps: int) -> Float[np.ndarray, " n"]:
    """Sum of the scaled commands over `steps` rows after the run-in, for every row at which a piece can begin."""
    size = np.abs(recording.command / np.maximum(np.abs(recording.command).max(0), 1e-9)).sum(1)
    total = np.concatenate([[0.0], np.cumsum(size[RUN_IN:-1])])
    return total[steps:] - total[:-steps]


def commands(problem: Problem, experiment: Experiment) -> dict:
    """An experiment's commands by channel, with their units."""
    fields = problem.augmented.simulator.schema.command
    return {
        "time_s": experiment.time_s,
        "channels": {f.name: experiment.commands[:, i] for i, f in enumerate(fields)},
        "units": {f.name: f.unit for f in fields},
    }
