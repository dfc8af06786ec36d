"""Whether play or a spring behind a joint explains the recordings as well as what was found there, or better."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis.config import EXPLAINED, LEAST_SHARE, LIKELY, Z95
from simgap.diagnosis.inference.evidence.null_distribution import blocks
from simgap.diagnosis.inference.explanation import Explanation, Hidden
from simgap.diagnosis.inference.fitting.model import Model, Reporter, cost, without
from simgap.diagnosis.inference.fitting.relinearise import itself
from simgap.diagnosis.inference.hidden.rivals import Gains, State, fitted, refitted
from simgap.diagnosis.inference.misfit.nonparametric import no_law
from simgap.diagnosis.inference.misfit.whiteness import Whiteness, whiteness
from simgap.diagnosis.inference.search.alternatives import Member, compared
from simgap.diagnosis.likelihood.problem import Fit, evaluate
from simgap.diagnosis.likelihood.student_t import log_density
from simgap.diagnosis.likelihood.variables import Variables
from simgap.engines import is_engine, split_of

FOUND = "found"
"""Name in a comparison of what was found, whatever it is."""
ON_THE_WAY = ("command", "filter")
"""Places of effects that play or a spring does not replace, if others were found at the joint: a command is late, or
limited, whatever moves behind the motor."""


class _Contest(NamedTuple):
    """What was found at a joint, and its rivals. base: the model without what they replace; own: with it, by the engine
    itself; bare: own with it switched off and nothing refitted."""

    replaced: Sequence[Member]
    base: Fit
    own: Fit
    bare: Variables
    states: Sequence[State]


class _Both(NamedTuple):
    """Log-densities of all rows, fitted and held out, of what was found and of the rivals, by name; and where blocks of
    rows begin. heldout: number of held-out rows, which come last."""

    rows: dict[str, Float[np.ndarray, " n"]]
    starts: np.ndarray
    heldout: int


def behind_joints(found: Explanation, report: Reporter) -> Explanation:
    """Compare what was found at each joint with play and a spring there; adds the rivals and changes the effects' odds.

    Only where something was found at a joint: an effect, or residuals that can be predicted. Not with a baseline.
    """
    simulator = found.problem.augmented.simulator
    if not is_engine(simulator) or found.baseline:
        return found
    own = evaluate(itself(found.problem), found.fit.v, found.fit.groups)
    for joint, members in _places(found, own).items():
        stand_ins = {name for h in found.hidden if h.named for name in h.replaces}
        members = [m for m in members if m.hypothesis.name not in stand_ins]
        engines = split_of(simulator, joint) if members or not stand_ins else ()
        if not engines:
            continue
        report(f"comparing with play and a spring between motor and link of {joint}")
        replaced = [m for m in members if m.hypothesis.effect.place not in ON_THE_WAY] or members
        bare = without(found.fit, [group for m in replaced for group in m.hypothesis.groups]).v
        base = max((m.without for m in replaced), key=lambda f: f.loglik) if replaced else found.fit
        states = fitted(found.problem, bare, engines, Gains(own.loglik, base.loglik))
        report(", ".join(f"{s.term.effect} {s.loglik - own.loglik:+.1f} nats" for s in states))
        if states:
            found = _with(found, _without_companions(found, _Contest(replaced, base, own, bare, states), report))
    return found


def _without_companions(found: Explanation, contest: _Contest, report: Reporter) -> _Contest:
    """Let the best rival also replace each effect without which it explains as much.

    A search that lacks a hidden state adds effects at other joints too, which make up for what the first one is not.
    """
    own, required = contest.own.loglik, found.rounds[0].screening.threshold / 2
    replaced = {m.hypothesis.name for m in contest.replaced}
    for m in (m for m in found.members if m.hypothesis.name not in replaced):
        if contest.states[0].loglik <= own:
            break
        best, *others = (s for s in contest.states if s.loglik > own)
        bare = without(contest.own._replace(v=contest.bare), m.hypothesis.groups).v
        state, *others = (refitted(found.problem, bare, s, contest.base.loglik) for s in (best, *others))
        if state.loglik > best.loglik - required:
            report(f"{m.hypothesis.name} dropped: {best.term.effect} explains as much without it")
            contest = contest._replace(replaced=[*contest.replaced, m], bare=bare, states=[state, *others])
    return contest


def _places(found: Explanation, own: Fit) -> dict[str, list[Member]]:
    """Joints at which effects were found, with those that gain most there, and the one joint of the others whose
    residuals can be predicted best; first where effects and predictable residuals gain most."""
    layout = found.problem.augmented.layout
    bodies = [f.body for f in layout.schema.outputs]
    # By the engine itself, which may have dropped an effect since.
    white = whiteness(found.problem, own).nats
    gains, places = np.array(white, float), {b: [] for b in dict.fromkeys(bodies) if b in layout.joints}
    density = log_density(found.fit.e, found.fit.noise).sum(0)
    for m in found.members:
        gained = np.maximum(density - log_density(m.without.e, m.without.noise).sum(0), 0.0)
        gains += gained
        places.get(bodies[int(gained.argmax())], []).append(m)
    total = {b: float(gains[[other == b for other in bodies]].sum()) for b in places}
    left = {b: float(white[[other == b for other in bodies]].sum()) for b in places if not places[b]}
    most = max(left, key=lambda b: left[b], default=None)  # one joint: a contest costs as much as a pass of the search
    tried = [b for b in places if places[b] or (b == most and left[b] > 0)]
    return {b: places[b] for b in sorted(tried, key=lambda b: -total[b])}


def _with(found: Explanation, contest: _Contest) -> Explanation:
    """The explanation after a contest: new odds of the effects, and the best rival if it is ahead of them."""
    best = {s.term.effect: s for s in contest.states}
    both = _rows(found, contest)
    constants = {FOUND: sum(len(m.hypothesis.groups) for m in contest.replaced)} | dict.fromkeys(best, 1)
    score = {k: float(d.sum()) - cost(constants[k], len(d)) for k, d in both.rows.items()}
    lead = max(score, key=lambda k: score[k])
    gained = (contest.own if lead == FOUND else best[lead]).loglik - contest.base.loglik
    odds = compared(both.rows, constants, both.starts, lead, gained)
    replaced = {m.hypothesis.name for m in contest.replaced}
    members = tuple(
        m._replace(odds=_beside(m.odds, odds)) if m.hypothesis.name in replaced else m for m in found.members
    )
    found = found._replace(members=members)
    if lead == FOUND:
        return found
    left = whiteness(found.problem, contest.own._replace(e=best[lead].e, noise=best[lead].noise))
    hidden = _hidden(found, contest, best[lead], both, odds, left)
    found = found._replace(hidden=(*found.hidden, hidden))
    if not hidden.named:
        return found
    # What was seen in the residuals of the effects that stand in for it may be the hidden state.
    law = no_law(Model(found.problem, found.fit, np.empty(0)), found.unseen)
    return found._replace(whiteness=left, noise_effects=[], law=law)


def _rows(found: Explanation, contest: _Contest) -> _Both:
    """Log-densities by the engine itself, with the noise of the fitted rows."""
    unseen, own = found.problem._replace(chunks=found.unseen), contest.own
    heldout = evaluate(itself(unseen), own.v, (), own.noise)
    rows = {FOUND: np.concatenate([log_density(f.e, own.noise).sum(1) for f in (own, heldout)])}
    for state in contest.states:
        here = log_density(state.e, state.noise).sum(1)
        rows[state.term.effect] = np.concatenate([here, state.on(unseen, contest.bare)])
    first = blocks(np.asarray(found.problem.chunks.counts))
    starts = np.concatenate([first, len(own.e) + blocks(np.asarray(found.unseen.counts))])
    return _Both(rows, starts, len(heldout.e))


def _beside(own: dict[str, float], odds: dict[str, float]) -> dict[str, float]:
    """Probabilities of ids, where those in `own` share the probability of what was found."""
    shared = {k: p * odds[FOUND] for k, p in own.items()} | {k: p for k, p in odds.items() if k != FOUND}
    return dict(sorted(shared.items(), key=lambda kp: -kp[1]))


def _hidden(
    found: Explanation, contest: _Contest, state: State, both: _Both, odds: dict[str, float], left: Whiteness
) -> Hidden:
    """The best rival, as a finding. It is named if it is likely, gains on held-out rows over what was found, and
    explains more than it leaves predictable in the outputs of its joint; and is ahead by what the last search
    required."""
    term, problem, replaced = state.term, found.problem, contest.replaced
    gain, heldout = state.loglik - contest.base.loglik, slice(len(both.rows[FOUND]) - both.heldout, None)
    more = float((both.rows[term.effect] - both.rows[FOUND])[heldout].sum())
    here = [f.body == term.where for f in problem.augmented.layout.schema.outputs]
    nameless = float(left.nats[here].sum())
    # Over the tables' fit as well: where the engine does not confirm it, any refit by the engine gains.
    ahead = state.loglik - found.fit.loglik > found.rounds[-1].screening.threshold / 2
    named = odds[term.effect] >= LIKELY and more > 0 and gain >= EXPLAINED * (gain + nameless) and ahead
    width = np.sqrt(Z95**2 + 2 * LEAST_SHARE * max(gain, 0.0)) * state.sd
    ends = np.clip(state.value * np.exp([0.0, -width, width]), term.low, term.high)
    value, *ci95 = (1 / ends if term.reciprocal else ends).tolist()
    probabilities = {k: p for m in replaced for k, p in _beside(m.odds, odds).items()} or dict(odds)
    probabilities = dict(sorted(probabilities.items(), key=lambda kp: -kp[1]))
    names = tuple(m.hypothesis.name for m in replaced)
    phi_sd = np.broadcast_to(state.phi_sd, state.at.phi.shape)
    return Hidden(
        term, value, (min(ci95), max(ci95)), probabilities, gain, more, named, names, state.at.phi, phi_sd
    )  # fmt: skip
