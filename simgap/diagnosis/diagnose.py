"""The whole diagnosis: whether something is missing, where, what, how much, whether it helps, and what to do."""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from simgap import compiled
from simgap.diagnosis.exchange import explained_or_exchanged
from simgap.diagnosis.hypotheses.space import hypotheses_of
from simgap.diagnosis.hypotheses.support import for_heldout, opened
from simgap.diagnosis.inference.explain import explain
from simgap.diagnosis.inference.explanation import Explanation
from simgap.diagnosis.inference.fitting.model import Reporter
from simgap.diagnosis.inference.search.posterior import at_bound
from simgap.diagnosis.likelihood.filter import gain_matrix
from simgap.diagnosis.likelihood.resolution import dithered, resolution
from simgap.diagnosis.report import experiment
from simgap.diagnosis.report import statement as written
from simgap.diagnosis.report.names import in_steps
from simgap.diagnosis.validation import black_box, replay, scores
from simgap.diagnosis.validation.adequacy import conclude
from simgap.diagnosis.validation.behind import deflected
from simgap.diagnosis.validation.forecast import Contestant
from simgap.diagnosis.validation.ranges import needed_beyond_ranges
from simgap.diagnosis.validation.scores import Judgement
from simgap.diagnosis.validation.sensitivity import sensitivity
from simgap.effects.augmented import Augmented
from simgap.effects.effect import Scales
from simgap.effects.regime import Regime
from simgap.engines import Engine, given_of, is_engine
from simgap.types import Recording, Sessions, StepModel


class AugmentedModel(NamedTuple):
    """Constants of the augmented simulator.

    phi: parameters. theta, delta, regimes: the effects' internal constants (see `Acting`). gain: filter gain.
    noise_scale, noise_dof: one-step noise of the innovations that `whiten` decorrelates. scales: those that the laws
    refer to. behind: the hidden state that is named, or nothing (see `Behind`). With one, phi and theta are of the
    engine that has it, and gain and noise of the search (see `Deflected`).
    """

    phi: Float[np.ndarray, " p"]
    theta: Float[np.ndarray, " P"]
    delta: Float[np.ndarray, "S P"]
    regimes: tuple[Regime, ...]
    gain: Float[np.ndarray, "s s"]
    noise_scale: Float[np.ndarray, " s"]
    noise_dof: Float[np.ndarray, " s"]
    whiten: Float[np.ndarray, "s s"]
    scales: Scales
    behind: tuple[str, ...] = ()


class Diagnosis(NamedTuple):
    """The result of a diagnosis.

    statement: content of diagnosis.json. evidence: arrays for the pictures. model: the augmented simulator. experiment:
    time [s] and commands that would separate the likeliest explanations.
    """

    statement: dict[str, Any]
    evidence: dict[str, Any]
    model: AugmentedModel
    experiment: tuple[Float[np.ndarray, " T"], Float[np.ndarray, "T u"]] | None


def _quiet(_: str) -> None:
    """Discard a progress message."""


def diagnose(
    simulator: StepModel | Engine, name: str, sessions: Sessions, seed: int = 0, report: Reporter = _quiet
) -> Diagnosis:
    """Diagnose the simulator called `name` against recordings; `report(line)` is called with the progress.

    With a baseline in `sessions`, the diagnosis finds what changed since: the simulator is refitted to both sets, with
    the effects that the baseline shows by itself, and an effect is claimed if it differs between the two.

    Raises DivergenceError if the simulator does not stay finite on the recordings at its nominal parameters.
    """
    compiled.forget_if_many()
    rng = np.random.default_rng(seed)
    steps = resolution([*sessions.fitted, *sessions.heldout])
    sessions = dithered(sessions, steps, rng.spawn(1)[0])
    found, sessions, exchange = explained_or_exchanged(simulator, sessions, rng, report)
    report("scoring on held-out sessions")
    contestants = _contestants(found, rng)
    judged = _judged(found, contestants, sessions)
    problem = found.problem
    seen = sensitivity(problem, found.rounds[0].screening, hypotheses_of(problem.augmented, problem.scales))
    beyond = _beyond_ranges(found, simulator, sessions, rng, report)
    concluded = conclude(found, judged, seen, beyond, rng)
    outcome = written.Outcome(contestants, judged, seen, beyond, concluded)
    report("designing an experiment that separates the likeliest explanations")
    plan, notes = _experiment(found, sessions.training)
    statement = written.statement(name, found, sessions, outcome, plan, rng)
    statement["notes"] += [*exchange, *notes, *in_steps(simulator.schema.outputs, steps)]
    statement["replay"] = _replayed(found, contestants, sessions.heldout)
    evidence = written.evidence(found, sessions, outcome, plan)
    commands = None if plan is None else (plan.experiment.time_s, plan.experiment.commands)
    return Diagnosis(statement, evidence, _model(found), commands)


def _beyond_ranges(
    found: Explanation,
    simulator: StepModel | Engine,
    sessions: Sessions,
    rng: np.random.Generator,
    report: Reporter,
) -> Explanation | None:
    """The explanation when parameters may leave their ranges.

    None if no parameter is at the end of its range, or if all effects are needed even so. An engine's ranges are wide
    and need no such check.
    """
    bound = {} if is_engine(simulator) or not found.anything else at_bound(found.problem, found.base)
    if not bound or needed_beyond_ranges(found):
        return None
    report(f"repeating the search without parameter ranges, since {', '.join(bound)} ended at a bound")
    return explain(simulator, sessions, rng, report, ranges_hold=False)


def _contestants(found: Explanation, rng: np.random.Generator) -> dict[str, Contestant]:
    problem = found.problem
    box = black_box.train(problem, found.base.v, rng)
    # The filter gain is not part of the simulator, so the nominal one gets the fitted gain as well.
    nominal = found.nominal.v._replace(gain=found.base.v.gain, cross=found.base.v.cross)
    contestant = partial(Contestant, regimes=found.regimes)
    models = {"nominal": contestant(nominal), "refitted": contestant(found.base.v)}
    if found.members:
        models["augmented"] = contestant(found.fit.v)
    return {**models, "black_box": contestant(found.base.v, box)}


def _judged(found: Explanation, contestants: dict[str, Contestant], sessions: Sessions) -> Judgement:
    """Every contestant on held-out and fitted pieces; empty if the sessions are too short for a single piece."""
    simulator = found.problem.augmented.simulator
    fitted, unseen = (scores.pieces_of(recorded, simulator) for recorded in (sessions.training, sessions.heldout))
    if fitted is None or unseen is None:
        return Judgement({}, {}, ())
    layout, supports = found.problem.augmented.layout, found.known_supports
    fitted, unseen = opened(layout, fitted, supports), for_heldout(layout, unseen, supports)
    judged = {name: scores.judge(found.problem, c, fitted, unseen) for name, c in contestants.items()}
    refitted_without = (Contestant(m.without.v, regimes=found.regimes) for m in found.members)
    return Judgement(
        {name: held for name, (held, _) in judged.items()},
        {name: on for name, (_, on) in judged.items()},
        # Without its only effect the model is the refitted one.
        (judged["refitted"],) if len(found.members) == 1 else
        tuple(scores.judge(found.problem, c, fitted, unseen) for c in refitted_without),
    )  # fmt: skip


def _replayed(
    found: Explanation, contestants: dict[str, Contestant], heldout: Sequence[Recording]
) -> dict[str, Any] | None:
    """Open-loop errors of an engine with every model except the black box; None if there is nothing to replay.

    If the search started elsewhere than at the engine as its user gave it, that one is among the models. If a hidden
    state is named, the engine with it is the one with the effects.
    """
    simulator, layout = found.problem.augmented.simulator, found.problem.augmented.layout
    if not is_engine(simulator) or (pieces := replay.pieces_of(heldout, simulator)) is None:
        return None
    pieces = for_heldout(layout, pieces, found.known_supports)
    models = {n: replay.Run(found.problem, model, pieces) for n, model in contestants.items() if n != "black_box"}
    if (given := given_of(simulator)) is not simulator:
        augmented, nominal = Augmented(given), contestants["nominal"]
        as_given = nominal._replace(v=nominal.v._replace(phi=augmented.nominal))
        models["given"] = replay.Run(found.problem._replace(augmented=augmented), as_given, pieces)
    if (hidden := deflected(found)) is not None:
        with_it = Contestant(hidden.fit.v, regimes=found.regimes)
        models["augmented"] = replay.Run(hidden.problem, with_it, hidden.chunks(pieces))
    return replay.replay(models)


def _experiment(found: Explanation, training: Sequence[Recording]) -> tuple[written.Plan | None, list[str]]:
    """An experiment that separates the least certain effect from its rival, or a note why there is none."""
    contested = [(m, m.rivals[0]) for m in found.members if m.rivals]
    if not contested or not found.problem.augmented.layout.schema.command:
        return None, []
    if is_engine(found.problem.augmented.simulator):
        return None, ["No experiment is proposed: experiments are not designed for engines yet."]
    member, rival = min(contested, key=lambda c: c[0].odds[c[0].hypothesis.effect.id])
    about, ids = [member.hypothesis, rival.hypothesis], (member.hypothesis.effect.id, rival.hypothesis.effect.id)
    designed = experiment.design(found.problem, found.fit, rival.fit, about, found.regimes, list(training))
    if isinstance(designed, experiment.NoExperiment):
        return None, [f"No experiment is proposed to separate {' from '.join(ids)}: {designed.reason}."]
    return written.Plan(designed, ids), []


def _model(found: Explanation) -> AugmentedModel:
    hidden = deflected(found)
    problem, fit, behind = (
        (found.problem, found.fit, ()) if hidden is None else (hidden.problem, hidden.fit, hidden.behind)
    )
    return AugmentedModel(
        np.asarray(fit.v.phi),
        *found.acting(fit),
        np.asarray(gain_matrix(problem.augmented, problem.scales, fit.v)),
        fit.noise.scale,
        fit.noise.dof,
        problem.whiten,
        problem.scales,
        tuple(behind),
    )
