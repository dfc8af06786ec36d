"""The numbers behind a diagnosis: which effects, acting when, and what scatter, explain the recordings best."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from simgap.diagnosis.config import EXPLAINED, LEAST_SHARE, LIKELY, MOST_SUPPORTS
from simgap.diagnosis.hypotheses.space import Candidate, behind, candidates, changed, within_session
from simgap.diagnosis.hypotheses.support import When, opened, to_its_end
from simgap.diagnosis.inference.alternatives import Member, defend, outshone
from simgap.diagnosis.inference.disturbances import pushed
from simgap.diagnosis.inference.heldout import agrees, by_row, gain, seen_at
from simgap.diagnosis.inference.model import Model, Round, Say, Tried, lacking, without
from simgap.diagnosis.inference.noise import scatter
from simgap.diagnosis.inference.noise_effect import Scatter
from simgap.diagnosis.inference.nonparametric import Law, no_law, unnamed
from simgap.diagnosis.inference.onsets import acts_when, begins
from simgap.diagnosis.inference.posterior import Spread, spread, told_from_nil
from simgap.diagnosis.inference.select import search
from simgap.diagnosis.inference.two_sample import acted_before, behind_gate, differs, leaves, scatter_since
from simgap.diagnosis.inference.whiteness import LeftOver, named_share
from simgap.diagnosis.likelihood.problem import Fit, Problem, evaluate, start, whitening
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import Chunks, cut, rows_of
from simgap.effects.augmented import Augmented
from simgap.effects.regime import EVERYWHERE, Acting, Regime, everywhere
from simgap.types import Recording, StepModel


class Explanation(NamedTuple):
    """The best explanation of the recordings.

    as_is, base, fit: the simulator as it is (as the baseline left it), refitted, and with the effects, fitted alike.
    sd: of its constants. members: the effects; scattered: those on the scatter; left: what they leave over; law: one
    beside them that has no name. unseen: the held-out rows, with the effects' supports. supports: when and where
    effects act that do not act throughout. rounds: what was tried. baseline: number of its sessions; with any, what is
    left over is what they do not leave as well, and no law without a name is looked for.
    """

    problem: Problem
    as_is: Fit
    base: Fit
    fit: Fit
    sd: Spread
    members: tuple[Member, ...]
    scattered: list[Scatter]
    left: LeftOver
    law: Law
    unseen: Chunks
    supports: tuple[When, ...]
    rounds: list[Round]
    baseline: int

    def names(self, member: Member) -> bool:
        """Whether an effect explains its outputs, rather than being the nearest word for something else.

        A constant that is not told from nil, though its effect gains, stands for what the simulator's parameters do;
        and what many names fit alike is likely something that has none.
        """
        if member.odds[member.candidate.effect.id] < LIKELY:
            return False
        nameless = np.maximum(self.left.nats, self.law.nats(self.fit))
        share = named_share(self.problem.augmented.layout, self.fit, member.without, nameless)
        return share >= EXPLAINED and told_from_nil(self.problem, self.fit, member.candidate, self.sd)

    @property
    def anything(self) -> bool:
        """Whether an effect was found, or something without a name."""
        return bool(self.members or self.left.nats.any() or self.law.terms)

    @property
    def ids(self) -> set[str]:
        """Of the effects found."""
        return {m.candidate.effect.id for m in self.members}

    @property
    def regimes(self) -> tuple[Regime, ...]:
        """Of every support; everywhere, where there is none, or it is a matter of time."""
        return tuple(when.regime or EVERYWHERE for when in self.supports) or (EVERYWHERE,)

    def acting(self, fit: Fit) -> Acting:
        """The constants of a fit, as part of a simulator: what changed since a baseline acts in it as well, and what
        acts in a regime acts there; what acts for a while only is no part of it."""
        theta, delta = np.asarray(fit.v.theta), np.asarray(fit.v.delta)
        if self.baseline and not self.supports:
            return everywhere(theta + delta[0])
        lasting = [s for s, when in enumerate(self.supports) if when.regime is not None]
        return Acting(theta, delta[lasting], tuple(self.regimes[s] for s in lasting))

    def known(self) -> Fit:
        """The fit without the effects that are nearest words only; nothing is fitted anew."""
        return without(self.fit, [group for m in self.members if not self.names(m) for group in m.candidate.groups])


def split(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    """Sessions to fit and sessions held out: every fourth, the last of fewer; the last quarter of a single one."""
    if len(recordings) == 1:
        (r,) = recordings
        edge = 3 * len(r.time_s) // 4
        part = lambda name, rows: Recording(name, r.time_s[rows], r.state[rows], r.command[rows])  # noqa: E731
        return [part(r.name, slice(0, edge))], [part(f"{r.name} (last quarter)", slice(edge, None))]
    held = set(range(3, len(recordings), 4)) or {len(recordings) - 1}
    return [r for i, r in enumerate(recordings) if i not in held], [r for i, r in enumerate(recordings) if i in held]


def _acting_when(member: Member, supports: Sequence[When]) -> Member:
    """With the support that it acts in."""
    support = member.candidate.groups[0].support
    return member._replace(when=supports[support - 1]) if support else member


def explain(
    simulator: StepModel,
    training: Sequence[Recording],
    heldout: Sequence[Recording],
    baseline: Sequence[Recording],
    rng: np.random.Generator,
    say: Say,
    ranges_hold: bool = True,
) -> Explanation:
    """Search for the effects that the simulator lacks; arguments and errors as in `diagnose`, `ranges_hold` as in
    `Problem`."""
    augmented = Augmented(simulator)
    layout = augmented.layout
    sessions = [*baseline, *training]
    scales, time_step = measure(augmented, sessions), simulator.time_step
    chunks = behind_gate(cut(sessions, time_step), len(baseline))
    unseen = cut(heldout, time_step, least=len(chunks.row))
    problem = Problem(augmented, scales, chunks, np.eye(len(simulator.schema.state)), ranges_hold)
    as_is = evaluate(problem, start(problem), ())
    problem = problem._replace(whiten=whitening(as_is.e))
    throughout, events = candidates(augmented, scales), candidates(augmented, scales, events=True)
    hypotheses = throughout
    if baseline:
        say(f"what the baseline of {len(baseline)} sessions shows by itself")
        before = problem._replace(chunks=cut(baseline, time_step, least=len(chunks.row)))
        # No session of the baseline is held out.
        known = search(before, evaluate(before, as_is.v, ()), throughout, lambda *_: True, rng, say).model.fit
        # Few sessions may say so little of parameters and gain that these explode on the others.
        left = known.v, as_is.v._replace(theta=known.v.theta)
        as_is = max((evaluate(problem, v, known.groups) for v in left), key=lambda fit: fit.loglik)
        # Each is measured beside its twin: what both have and the baseline alone was too short to show is no change.
        hypotheses = [changed(c) for c in throughout]

    def helps(problem: Problem, tried: Tried, owed: float) -> bool:
        # What acts in one session of training only is nothing to the others.
        support = tried.candidate.groups[0].support
        elsewhere = support and not np.asarray(unseen.gate)[:, support - 1].any()
        gained = by_row(tried.without, tried.fit)
        holds = elsewhere or agrees(gained, gain(problem, unseen, tried.without, tried.fit), problem.chunks, owed)
        return holds and (not baseline or differs(problem, tried, len(baseline)))

    say(f"fitting the {len(simulator.parameters)} parameters to {len(sessions)} sessions")
    searched = search(problem, evaluate(problem, as_is.v, as_is.groups), hypotheses, helps, rng, say)
    model, members, rounds = defend(searched, hypotheses, helps, rng, say)
    changes = bool(baseline and members)  # beside which nothing else is looked for
    scattered = [] if changes else scatter(model.problem, model.fit, unseen)
    looked_at, odd = model.fit, sum(s.gain for s in scattered if s.rare)
    if not baseline:  # which has odd rows as well, that would make up as much
        model, members = outshone(model, members, odd, say)

    def within(support: int, when: When) -> list[Candidate]:
        """Hypotheses that an effect acts there only."""
        some = throughout
        if when.session is not None:  # it may have been a push as well
            drifts, pushes = within_session(throughout, events, to_its_end(rows_of(chunks), when))
            some = [*drifts, *pushes]
        return [behind(c, support) for c in some]

    supports: list[When] = []
    while not baseline and len(supports) < MOST_SUPPORTS:
        when = acts_when(model, members, supports, unseen, say)
        if not (members or odd):
            when = begins(model, searched.rounds[0].screening, rng, say)
        if when is None:
            break
        # What acts for a while or in a regime only was looked for as if it acted throughout: look again.
        before = problem, unseen, searched, model, members, rounds, supports
        supports = [*supports, when]
        problem = problem._replace(chunks=opened(layout, chunks, supports))
        unseen = seen_at(layout, unseen, supports)
        hypotheses = [*throughout, *(h for i, s in enumerate(supports, 1) for h in within(i, s))]
        nominal = as_is.v._replace(delta=np.zeros((len(supports), as_is.v.delta.shape[1]), np.float32))
        searched = search(problem, evaluate(problem, nominal, as_is.groups), hypotheses, helps, rng, say)
        model, members, rounds = defend(searched, hypotheses, helps, rng, say)
        members = tuple(_acting_when(m, supports) for m in members)
        if not members or (len(supports) > 1 and not any(m.when == when for m in members)):
            problem, unseen, searched, model, members, rounds, supports = before
            break

    def bare() -> Model:
        """The model without its effects."""
        if baseline:
            return lacking(model, [m.candidate for m in members])
        return lacking(model._replace(fit=searched.base), [])

    base = bare() if changes else None
    if not odd:
        # Odd rows look like pushes, one by one. And changes may be made up of one push.
        with_push, those = pushed(base or model, () if changes else members, events, throughout, rng, say)
        pays = not changes or with_push.fit.loglik > model.fit.loglik
        if pays and not any(acted_before(m.when, len(baseline)) for m in those):
            base = base if with_push is model else None
            model, members = with_push, those
    if not any(m.when in supports for m in members):
        supports = [m.when for m in members if m.when]  # that of a push
    unseen = seen_at(layout, unseen, supports)
    say("looking at the scatter that is left")
    if baseline:
        scattered = scatter_since(model, training, baseline, unseen)
    elif model.fit is not looked_at:
        scattered = scatter(model.problem, model.fit, unseen)
    # Of less, what the laws of the others are not quite may be the cause; and odd rows are made up by what explains
    # them better, though it may not hold in all sessions.
    owed, rejected = LEAST_SHARE * sum(m.gain for m in members), searched.rounds[-1].rejected
    scattered = [s for s in scattered if s.gain > (max(owed, rejected) if s.rare else owed)]
    base = base or bare()
    law = no_law(model, unseen) if baseline else unnamed(model, unseen, rng, say)
    return Explanation(
        model.problem, as_is, base.fit, model.fit, spread(*model), members, scattered,
        leaves(model.problem, model.fit, len(baseline)), law, unseen, tuple(supports), [*searched.rounds, *rounds],
        len(baseline),
    )  # fmt: skip
