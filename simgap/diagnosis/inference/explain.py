"""The estimation behind a diagnosis: which effects, supports and noise effects explain the recordings best."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from simgap.diagnosis.config import LEAST_SHARE, MOST_SUPPORTS
from simgap.diagnosis.hypotheses.space import Hypothesis, behind, changed, hypotheses_of, within_session
from simgap.diagnosis.hypotheses.support import ALWAYS, Since, Support, Window, for_heldout, opened, to_its_end
from simgap.diagnosis.inference.explanation import Explanation
from simgap.diagnosis.inference.fitting.heldout import agrees, by_row, gain
from simgap.diagnosis.inference.fitting.model import Found, Model, Reporter, Round, Trial, refitted_without
from simgap.diagnosis.inference.fitting.starts import begun_anew, fitted_starts, led
from simgap.diagnosis.inference.misfit.nonparametric import no_law, nonparametric_law
from simgap.diagnosis.inference.misfit.relaxation import misfits
from simgap.diagnosis.inference.noise.find import noise_effects
from simgap.diagnosis.inference.search.alternatives import Member, defend, drop_dominated
from simgap.diagnosis.inference.search.disturbances import pushed
from simgap.diagnosis.inference.search.late import among_late_rivals
from simgap.diagnosis.inference.search.onsets import hidden_restriction, restriction
from simgap.diagnosis.inference.search.posterior import spread
from simgap.diagnosis.inference.search.select import Inputs, search
from simgap.diagnosis.inference.two_sample import differs, noise_effects_since, whiteness_of
from simgap.diagnosis.likelihood.linearised import tabulated
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate, start, whitening
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import Chunks, cut, most_rows, rows_of
from simgap.effects.augmented import Augmented
from simgap.engines import Engine, is_engine
from simgap.types import Recording, Sessions, StepModel


class _Asked(NamedTuple):
    """The inputs of searches. baseline: number of baseline sessions, which come first. opening: see `select.Inputs`."""

    chunks: Chunks
    unseen: Chunks
    nominal: Fit
    throughout: Sequence[Hypothesis]
    events: Sequence[Hypothesis]
    baseline: int
    rng: np.random.Generator
    report: Reporter
    opening: str | None = None


class _Found(NamedTuple):
    """The explanation so far. unseen: held-out rows with the gates of its supports."""

    problem: Problem
    unseen: Chunks
    searched: Found
    model: Model
    members: tuple[Member, ...]
    rounds: list[Round]
    supports: tuple[Support, ...] = ()

    def bare(self, baseline: int) -> Model:
        """The model refitted without its effects."""
        if baseline:
            return refitted_without(self.model, [m.hypothesis for m in self.members])
        return refitted_without(self.model._replace(fit=self.searched.base), [])


def explain(
    simulator: StepModel | Engine,
    sessions: Sessions,
    rng: np.random.Generator,
    report: Reporter,
    ranges_hold: bool = True,
    before: Explanation | None = None,
) -> Explanation:
    """Search for the effects that a simulator lacks. Arguments and errors as in `diagnose`, `ranges_hold` in `Problem`.

    An engine is tabulated at the fit of the explanation `before`, or at its nominal parameters without one.
    """
    problem, nominal, unseen = _posed(simulator, sessions, ranges_hold, before)
    augmented, scales, chunks, baseline = problem.augmented, problem.scales, problem.chunks, sessions.baseline
    throughout, events = hypotheses_of(augmented, scales), hypotheses_of(augmented, scales, events=True)
    opening = before.rounds[0].accepted_id if before else None
    asked = _Asked(chunks, unseen, nominal, throughout, events, len(baseline), rng, report, opening)
    if baseline:
        asked = asked._replace(nominal=_with_baseline(asked, problem, baseline))
    report(f"fitting the {len(simulator.parameters)} parameters to {len(sessions.fitted)} sessions")
    # Each change is fitted together with its twin. Otherwise an effect that acts all along, but that the baseline alone
    # was too short to show, would pass for a change.
    best = _look(asked, problem, unseen, [changed(h, len(baseline)) for h in throughout] if baseline else throughout)
    changes = bool(baseline and best.members)  # then nothing else is searched for
    noise_terms = [] if changes else noise_effects(best.model.problem, best.model.fit, best.unseen)
    fit_before, outlier_gain = best.model.fit, sum(s.gain for s in noise_terms if s.rare)
    if not baseline:
        # Outlier rows can produce the gain of a weak member.
        model, members = drop_dominated(best.model, best.members, outlier_gain, report)
        best = _restricted(asked, best._replace(model=model, members=members), outlier_gain)
        best = best._replace(members=among_late_rivals(best.model, best.members, best.supports))
    best, base = (best, None) if outlier_gain else _disturbed(asked, best, changes)
    report("searching for effects on the noise")
    problem, fit, _ = best.model
    best = best._replace(unseen=begun_anew(problem._replace(chunks=best.unseen), fit, free=False)[0].chunks)
    if baseline:
        noise_terms = noise_effects_since(best.model, sessions, best.unseen)
    elif fit is not fit_before:
        noise_terms = noise_effects(problem, fit, best.unseen)
    # Smaller gains may only reflect misfit of the accepted laws or, in rare rows, a law that not all sessions confirm.
    misfit_gain, rejected = LEAST_SHARE * sum(m.gain for m in best.members), best.searched.rounds[-1].rejected
    noise_terms = [s for s in noise_terms if s.gain > (max(misfit_gain, rejected) if s.rare else misfit_gain)]
    base = base or best.bare(len(baseline))
    law = no_law(best.model, best.unseen) if baseline else nonparametric_law(best.model, best.unseen, rng, report)
    misfit_gains = misfits(best.model, [m.hypothesis for m in best.members])
    members = tuple(m._replace(misfit=gain) for m, gain in zip(best.members, misfit_gains, strict=True))
    return Explanation(
        problem, asked.nominal, base.fit, fit, spread(*best.model), members, noise_terms,
        whiteness_of(problem, fit, len(baseline)), law, best.unseen, best.supports,
        [*best.searched.rounds, *best.rounds], len(baseline),
    )  # fmt: skip


def _posed(
    simulator: StepModel | Engine, sessions: Sessions, ranges_hold: bool, before: Explanation | None
) -> tuple[Problem, Fit, Chunks]:
    """The problem, its fit at nominal parameters, and the held-out segments."""
    augmented = Augmented(simulator)
    scales, time_step, most = measure(augmented, sessions.fitted), simulator.time_step, most_rows(simulator)
    chunks = cut(sessions.fitted, time_step, most=most)
    if sessions.baseline:
        chunks = opened(augmented.layout, chunks, [Since(len(sessions.baseline))])
    unseen = cut(sessions.heldout, time_step, len(chunks.row), most)
    problem = Problem(augmented, scales, chunks, np.eye(len(simulator.schema.outputs)), ranges_hold)
    problem = _tabulated(problem, before)
    nominal = evaluate(problem, start(problem), ())
    problem = problem._replace(whiten=whitening(nominal.e))
    if before is None and led(problem):
        problem, fit = fitted_starts(problem, nominal)
        unseen = fitted_starts(problem._replace(chunks=unseen), fit, free=False)[0].chunks
        nominal = evaluate(problem, nominal.v, ())
    return problem, nominal, unseen


def _tabulated(problem: Problem, before: Explanation | None) -> Problem:
    """The problem with an engine tabulated at an earlier fit, or at the start; unchanged without an engine."""
    if not is_engine(problem.augmented.simulator):
        return problem
    v, gate = (start(problem), problem.chunks.gate) if before is None else (before.fit.v, before.problem.chunks.gate)
    table = tabulated(problem, v, problem.chunks._replace(gate=gate)).table
    return problem._replace(chunks=problem.chunks._replace(table=table), near=np.asarray(v.phi))


def _with_baseline(asked: _Asked, problem: Problem, baseline: Sequence[Recording]) -> Fit:
    """The simulator with the effects that the baseline shows by itself, evaluated on all sessions."""
    asked.report(f"searching the baseline of {len(baseline)} sessions for effects")
    chunks = cut(baseline, problem.scales.time_step, len(asked.chunks.row), most_rows(problem.augmented.simulator))
    before, v = problem._replace(chunks=chunks), asked.nominal.v
    # The baseline has no held-out sessions.
    always = lambda *_: True  # noqa: E731
    inputs = Inputs(asked.throughout, always, asked.rng, asked.report)
    known = search(inputs, before, evaluate(before, v, ())).model.fit
    # A short baseline may determine parameters and filter gain so badly that the model diverges on other sessions.
    starts = known.v, v._replace(theta=known.v.theta)
    return max((evaluate(problem, v, known.groups) for v in starts), key=lambda fit: fit.loglik)


def _look(
    asked: _Asked,
    problem: Problem,
    unseen: Chunks,
    hypotheses: Sequence[Hypothesis],
    supports: tuple[Support, ...] = (),
) -> _Found:
    """Search for effects, then compare each with its alternatives."""

    def confirmed(problem: Problem, trial: Trial, required: float) -> bool:
        fits = trial.without, trial.fit
        heldout = gain(problem, tabulated(problem, trial.fit.v, unseen, fits), *fits)
        return agrees(by_row(trial.without, trial.fit), heldout, problem.chunks, required)

    def holds_out(problem: Problem, trial: Trial, required: float) -> bool:
        # Held-out sessions cannot test an effect whose support they do not enter.
        gate = trial.hypothesis.groups[0].support
        untestable = gate and not np.asarray(unseen.gate)[:, gate - 1].any()
        holds = untestable or confirmed(problem, trial, required)
        return holds and (not asked.baseline or differs(problem, trial, asked.baseline))

    nominal = asked.nominal
    v = nominal.v._replace(delta=np.zeros((max(len(supports), 1), nominal.v.delta.shape[1]), np.float32))
    inputs = Inputs(hypotheses, holds_out, asked.rng, asked.report, asked.opening)
    searched = search(inputs, problem, evaluate(problem, v, nominal.groups))
    model, members, rounds = defend(searched, hypotheses, holds_out, asked.rng, asked.report)
    unseen = tabulated(model.problem, model.fit.v, unseen)
    problem = problem._replace(chunks=model.problem.chunks, near=model.problem.near)
    return _Found(problem, unseen, searched, model, members, rounds, supports)


def _restricted(asked: _Asked, best: _Found, outlier_gain: float) -> _Found:
    """Search for supports: onsets, windows and regimes of effects that do not act throughout.

    Until a support is known, its effect is searched for as if it acted throughout. So the search starts over after each
    new support, with all hypotheses both throughout and in each support.
    """
    layout = best.problem.augmented.layout
    while len(best.supports) < MOST_SUPPORTS:
        support = restriction(best.model, best.members, best.supports, best.unseen, asked.report)
        if support is None and not (best.supports or outlier_gain):
            bare = best.bare(asked.baseline) if best.members else best.model
            screening = best.searched.rounds[0].screening
            gained = best.model.fit.loglik - bare.fit.loglik
            support = hidden_restriction(bare, screening, gained, asked.rng, asked.report)
        if support is None:
            return best
        supports = (*best.supports, support)
        hypotheses = [*asked.throughout, *(h for i, s in enumerate(supports, 1) for h in _within(asked, s, i))]
        problem = best.problem._replace(chunks=opened(layout, best.problem.chunks, supports))
        asked = asked._replace(opening=best.searched.rounds[0].accepted_id)
        trial = _look(asked, problem, for_heldout(layout, asked.unseen, supports), hypotheses, supports)
        # The search may have taken a worse way than the one before.
        in_vain = best.supports and not any(m.hypothesis.support == support for m in trial.members)
        if not trial.members or in_vain or trial.model.density < best.model.density:
            return best
        best = trial
        if all(m.hypothesis.support == ALWAYS for m in best.members):
            return best._replace(supports=(), unseen=opened(layout, best.unseen, ()))
    return best


def _within(asked: _Asked, support: Support, gate: int) -> list[Hypothesis]:
    """Hypotheses of effects that act in a support only; in a window of one session pushes are among them."""
    hypotheses = asked.throughout
    if isinstance(support, Window):
        drifts, pushes = within_session(hypotheses, asked.events, to_its_end(rows_of(asked.chunks), support))
        hypotheses = [*drifts, *pushes]
    return [behind(h, support, gate) for h in hypotheses]


def _disturbed(asked: _Asked, best: _Found, changes: bool) -> tuple[_Found, Model | None]:
    """Add a push from outside, if there is one. Also returns the model without effects, if the search needed it.

    One push may explain all changes since a baseline, so it then competes with all of them together.
    """
    base = best.bare(asked.baseline) if changes else None
    model, members = pushed(
        base or best.model, () if changes else best.members, asked.events, asked.throughout, asked.rng, asked.report
    )
    improves = not changes or model.fit.loglik > best.model.fit.loglik
    supports = tuple(s for s in (m.hypothesis.support for m in members) if s != ALWAYS)
    in_baseline = any(isinstance(s, Window) and s.session < asked.baseline for s in supports)
    if not improves or in_baseline or model is best.model:
        return best, base
    unseen = for_heldout(best.problem.augmented.layout, best.unseen, supports)
    return best._replace(model=model, members=members, supports=supports, unseen=unseen), None
