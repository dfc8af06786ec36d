"""The numbers behind a diagnosis: which effects, acting when, and what scatter, explain the recordings best."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from simgap.diagnosis.config import LEAST_SHARE, MOST_SUPPORTS
from simgap.diagnosis.hypotheses.space import Hypothesis, behind, changed, hypotheses_of, within_session
from simgap.diagnosis.hypotheses.support import ALWAYS, Since, Support, Window, for_heldout, opened, to_its_end
from simgap.diagnosis.inference.alternatives import Member, defend, drop_dominated
from simgap.diagnosis.inference.disturbances import pushed
from simgap.diagnosis.inference.explanation import Explanation
from simgap.diagnosis.inference.heldout import agrees, by_row, gain
from simgap.diagnosis.inference.model import Found, Model, Reporter, Round, Trial, refitted_without
from simgap.diagnosis.inference.noise import noise_effects
from simgap.diagnosis.inference.nonparametric import no_law, nonparametric_law
from simgap.diagnosis.inference.onsets import hidden_restriction, restriction
from simgap.diagnosis.inference.posterior import spread
from simgap.diagnosis.inference.relaxation import misfits
from simgap.diagnosis.inference.select import search
from simgap.diagnosis.inference.two_sample import differs, noise_effects_since, whiteness_of
from simgap.diagnosis.likelihood.linearised import tabulated
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate, start, whitening
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import Chunks, cut, rows_of
from simgap.effects.augmented import Augmented
from simgap.engines import Engine, is_engine
from simgap.types import Recording, Sessions, StepModel


def split(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    """Sessions to fit and sessions held out: every fourth, the last of fewer; the last quarter of a single one."""
    if len(recordings) == 1:
        (r,) = recordings
        edge = 3 * len(r.time_s) // 4
        part = lambda name, rows: Recording(name, r.time_s[rows], r.state[rows], r.command[rows])  # noqa: E731
        return [part(r.name, slice(0, edge))], [part(f"{r.name} (last quarter)", slice(edge, None))]
    held = set(range(3, len(recordings), 4)) or {len(recordings) - 1}
    return [r for i, r in enumerate(recordings) if i not in held], [r for i, r in enumerate(recordings) if i in held]


class _Asked(NamedTuple):
    """What does not change during a search; baseline: number of its sessions, which come first."""

    chunks: Chunks
    unseen: Chunks
    nominal: Fit
    throughout: Sequence[Hypothesis]
    events: Sequence[Hypothesis]
    baseline: int
    rng: np.random.Generator
    report: Reporter


class _Found(NamedTuple):
    """The explanation so far; unseen: held-out rows with its supports."""

    problem: Problem
    unseen: Chunks
    searched: Found
    model: Model
    members: tuple[Member, ...]
    rounds: list[Round]
    supports: tuple[Support, ...] = ()

    def bare(self, baseline: int) -> Model:
        """The model without its effects."""
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
    """Search for the effects that the simulator lacks; arguments and errors as in `diagnose`, `ranges_hold` as in
    `Problem`. An engine is tabulated where an explanation from `before` leads along, or as it is."""
    augmented, baseline = Augmented(simulator), sessions.baseline
    scales, time_step = measure(augmented, sessions.fitted), simulator.time_step
    chunks = cut(sessions.fitted, time_step)
    if baseline:
        chunks = opened(augmented.layout, chunks, [Since(len(baseline))])
    unseen = cut(sessions.heldout, time_step, least=len(chunks.row))
    problem = Problem(augmented, scales, chunks, np.eye(len(simulator.schema.outputs)), ranges_hold)
    problem = _tabulated(problem, before)
    chunks = problem.chunks
    nominal = evaluate(problem, start(problem), ())
    problem = problem._replace(whiten=whitening(nominal.e))
    throughout, events = hypotheses_of(augmented, scales), hypotheses_of(augmented, scales, events=True)
    asked = _Asked(chunks, unseen, nominal, throughout, events, len(baseline), rng, report)
    if baseline:
        asked = asked._replace(nominal=_with_baseline(asked, problem, baseline))
    report(f"fitting the {len(simulator.parameters)} parameters to {len(sessions.fitted)} sessions")
    # A change is measured beside its twin: what both have and the baseline alone was too short to show is no change.
    found = _look(
        asked, problem, unseen, [changed(h, len(baseline)) for h in throughout] if baseline else throughout, ()
    )
    changes = bool(baseline and found.members)  # beside which nothing else is looked for
    noise_effects = [] if changes else noise_effects(found.model.problem, found.model.fit, found.unseen)
    looked_at, odd = found.model.fit, sum(s.gain for s in noise_effects if s.rare)
    if not baseline:
        # Odd rows would make up as much as a weak member gains.
        model, members = drop_dominated(found.model, found.members, odd, report)
        found = _restricted(asked, found._replace(model=model, members=members), odd)
    found, base = (found, None) if odd else _disturbed(asked, found, changes)
    report("looking at the scatter that is left")
    problem, fit, _ = found.model
    if baseline:
        noise_effects = noise_effects_since(found.model, sessions, found.unseen)
    elif fit is not looked_at:
        noise_effects = noise_effects(problem, fit, found.unseen)
    # Of less, what the laws of the others are not quite may be the cause; and odd rows are made up by what explains
    # them better, though it may not hold in all sessions.
    required, rejected = LEAST_SHARE * sum(m.gain for m in found.members), found.searched.rounds[-1].rejected
    noise_effects = [s for s in noise_effects if s.gain > (max(required, rejected) if s.rare else required)]
    base = base or found.bare(len(baseline))
    law = no_law(found.model, found.unseen) if baseline else nonparametric_law(found.model, found.unseen, rng, report)
    bent = misfits(found.model, [m.hypothesis for m in found.members])
    members = tuple(m._replace(misfit=gain) for m, gain in zip(found.members, bent, strict=True))
    return Explanation(
        problem, asked.nominal, base.fit, fit, spread(*found.model), members, noise_effects,
        whiteness_of(problem, fit, len(baseline)), law, found.unseen, found.supports,
        [*found.searched.rounds, *found.rounds], len(baseline),
    )  # fmt: skip


def _tabulated(problem: Problem, before: Explanation | None) -> Problem:
    """With tables of an engine, where an earlier explanation leads or as it is; as it was without an engine."""
    if not is_engine(problem.augmented.simulator):
        return problem
    v, gate = (start(problem), problem.chunks.gate) if before is None else (before.fit.v, before.problem.chunks.gate)
    table = tabulated(problem, v, problem.chunks._replace(gate=gate)).table
    return problem._replace(chunks=problem.chunks._replace(table=table), near=np.asarray(v.phi))


def _with_baseline(asked: _Asked, problem: Problem, baseline: Sequence[Recording]) -> Fit:
    """The simulator with the effects that the baseline shows by itself, evaluated on all sessions."""
    asked.report(f"what the baseline of {len(baseline)} sessions shows by itself")
    chunks = cut(baseline, problem.scales.time_step, least=len(asked.chunks.row))
    before, v = problem._replace(chunks=chunks), asked.nominal.v
    # No session of the baseline is held out.
    always = lambda *_: True  # noqa: E731
    known = search(before, evaluate(before, v, ()), asked.throughout, always, asked.rng, asked.report).model.fit
    # Few sessions may say so little of parameters and gain that these explode on the others.
    left = known.v, v._replace(theta=known.v.theta)
    return max((evaluate(problem, v, known.groups) for v in left), key=lambda fit: fit.loglik)


def _look(
    asked: _Asked, problem: Problem, unseen: Chunks, hypotheses: Sequence[Hypothesis], supports: tuple[Support, ...]
) -> _Found:
    """Search for effects, each of which then defends its place against its alternatives."""

    def confirmed(problem: Problem, trial: Trial, required: float) -> bool:
        heldout = gain(problem, tabulated(problem, trial.fit.v, unseen), trial.without, trial.fit)
        return agrees(by_row(trial.without, trial.fit), heldout, problem.chunks, required)

    def holds_out(problem: Problem, trial: Trial, required: float) -> bool:
        # Held-out sessions say nothing of an effect whose support they do not enter.
        gate = trial.hypothesis.groups[0].support
        elsewhere = gate and not np.asarray(unseen.gate)[:, gate - 1].any()
        holds = elsewhere or confirmed(problem, trial, required)
        return holds and (not asked.baseline or differs(problem, trial, asked.baseline))

    nominal = asked.nominal
    v = nominal.v._replace(delta=np.zeros((max(len(supports), 1), nominal.v.delta.shape[1]), np.float32))
    searched = search(problem, evaluate(problem, v, nominal.groups), hypotheses, holds_out, asked.rng, asked.report)
    model, members, rounds = defend(searched, hypotheses, holds_out, asked.rng, asked.report)
    unseen = tabulated(model.problem, model.fit.v, unseen)
    problem = problem._replace(chunks=model.problem.chunks, near=model.problem.near)
    return _Found(problem, unseen, searched, model, members, rounds, supports)


def _restricted(asked: _Asked, found: _Found, odd: float) -> _Found:
    """With the times, stretches and regimes in which effects act that do not act throughout.

    What acts for a while or in a regime only was looked for as if it acted throughout: every time the search starts
    over, with all hypotheses throughout and in each of the supports.
    """
    layout = found.problem.augmented.layout
    while len(found.supports) < MOST_SUPPORTS:
        support = restriction(found.model, found.members, found.supports, found.unseen, asked.report)
        if not (found.members or odd):
            support = hidden_restriction(found.model, found.searched.rounds[0].screening, asked.rng, asked.report)
        if support is None:
            return found
        supports = (*found.supports, support)
        hypotheses = [*asked.throughout, *(h for i, s in enumerate(supports, 1) for h in _within(asked, s, i))]
        problem = found.problem._replace(chunks=opened(layout, found.problem.chunks, supports))
        further = _look(asked, problem, for_heldout(layout, asked.unseen, supports), hypotheses, supports)
        if not further.members or (
            found.supports and not any(m.hypothesis.support == support for m in further.members)
        ):
            return found
        found = further
        if all(m.hypothesis.support == ALWAYS for m in found.members):
            return found._replace(supports=(), unseen=opened(layout, found.unseen, ()))
    return found


def _within(asked: _Asked, support: Support, gate: int) -> list[Hypothesis]:
    """Hypotheses that an effect acts in a support only; in one session it may have been a push as well."""
    some = asked.throughout
    if isinstance(support, Window):
        drifts, pushes = within_session(some, asked.events, to_its_end(rows_of(asked.chunks), support))
        some = [*drifts, *pushes]
    return [behind(h, support, gate) for h in some]


def _disturbed(asked: _Asked, found: _Found, changes: bool) -> tuple[_Found, Model | None]:
    """With a push from outside, if there is one; and the model without effects, if that was needed to look for it.

    Changes since a baseline may be made up of one push.
    """
    base = found.bare(asked.baseline) if changes else None
    model, members = pushed(
        base or found.model, () if changes else found.members, asked.events, asked.throughout, asked.rng, asked.report
    )
    pays = not changes or model.fit.loglik > found.model.fit.loglik
    supports = tuple(s for s in (m.hypothesis.support for m in members) if s != ALWAYS)
    before = any(isinstance(s, Window) and s.session < asked.baseline for s in supports)
    if not pays or before or model is found.model:
        return found, base
    unseen = for_heldout(found.problem.augmented.layout, found.unseen, supports)
    return found._replace(model=model, members=members, supports=supports, unseen=unseen), None
