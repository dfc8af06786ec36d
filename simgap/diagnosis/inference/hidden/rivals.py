"""Rivals with a hidden state at a joint of an engine: play, or a spring, between motor and link.

What they do looks like a resistance, above all from positions alone. So effects that were found at a joint are compared
with them, by the log-likelihood of the engine itself.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from simgap.diagnosis.inference.fitting.gauss_newton import ENOUGH, SHARES, lowest
from simgap.diagnosis.inference.fitting.model import settled
from simgap.diagnosis.inference.search.one_more import CONTENDER
from simgap.diagnosis.likelihood.direct import Driven, driven, innovations
from simgap.diagnosis.likelihood.directions import CROSS, PRIOR_PRECISION, TRUST, spans
from simgap.diagnosis.likelihood.filter import gain_matrix
from simgap.diagnosis.likelihood.problem import Problem, start
from simgap.diagnosis.likelihood.student_t import Noise, fit_noise, log_density, weights
from simgap.diagnosis.likelihood.variables import Variables
from simgap.engines import Engine, Term
from simgap.threads import side_by_side

PHI, GAIN, SIZE = 0.01, 0.01, 0.03
"""Difference steps of a parameter (a logarithm), of the filter's gain, and of the logarithm of the rival's constant.
They are wide: stops make the innovations jagged in all of these."""
ITERATIONS = 8
"""Gauss-Newton steps, at most, of a fit; most end before, where a step gains too little."""
SEARCHED = 10
"""Segments, at regular intervals, on which rivals are searched for: play and springs gain hundreds of nats there, and
each of some hundred trials steps the engine through all of them. Only the last step of a fit takes all segments."""


class Gains(NamedTuple):
    """Log-likelihoods that rivals are compared with: of what was found, and of the model without what they replace."""

    found: float
    base: float


class Point(NamedTuple):
    """Free variables of a rival: parameters, gain of the joint's states, and the logarithm of its constant."""

    phi: Float[np.ndarray, " p"]
    gain: Float[np.ndarray, "s+h o"]
    size: float


class State(NamedTuple):
    """A rival fitted. e, noise, loglik: as in a `Fit`. sd, phi_sd: standard deviations of the logarithm of its
    constant, and of the parameters."""

    engine: Engine
    at: Point
    e: Float[np.ndarray, "n o"]
    noise: Noise
    loglik: float
    sd: float = np.inf
    phi_sd: Float[np.ndarray, " p"] | float = np.inf

    @property
    def term(self) -> Term:
        """What it is, where, and in which unit its constant is given."""
        return self.engine.terms[-1]

    @property
    def value(self) -> float:
        """Its constant, in the unit of the term."""
        return float(np.exp(self.at.size))

    def on(self, problem: Problem, v: Variables) -> Float[np.ndarray, " n"]:
        """Log-density of the rows of other recordings, with everything as fitted."""
        e = innovations(problem, self.engine, driven(problem, v), self.at.phi, self.at.gain, np.array([self.value]))
        return log_density(e, self.noise).sum(1)


class Search(NamedTuple):
    """What a rival is fitted to. free: entries of the gain that are fitted; unit: of each entry. full: whether the
    parameters are fitted too."""

    problem: Problem
    engine: Engine
    given: Driven
    free: tuple[Int[np.ndarray, " c"], Int[np.ndarray, " c"]]
    unit: Float[np.ndarray, "s+h o"]
    full: bool = False

    def innovations(self, at: Point) -> Float[np.ndarray, "n o"]:
        """Those of the rival at a point."""
        return innovations(self.problem, self.engine, self.given, at.phi, at.gain, np.array([np.exp(at.size)]))

    def fit(self, at: Point) -> State:
        """The rival at a point, with its noise."""
        e = self.innovations(at)
        if not np.isfinite(e).all():
            return State(self.engine, at, e, Noise(np.ones(e.shape[1]), np.ones(e.shape[1])), -np.inf)
        noise = fit_noise(e)
        return State(self.engine, at, e, noise, float(log_density(e, noise).sum()))

    def moved(self, at: Point, by: Float[np.ndarray, " m"]) -> Point:
        """The point with its free variables changed, within their bounds."""
        low, high = self.bounds(at)
        by = np.clip(by, low, high)
        count = len(at.phi) if self.full else 0
        phi = at.phi + by[:count] * spans(self.problem) if self.full else at.phi
        gain = at.gain.copy()
        gain[self.free] += by[count:-1] * self.unit[self.free]
        return Point(phi, gain, at.size + by[-1])

    def bounds(self, at: Point) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """Largest steps down and up of the free variables."""
        term, here = self.engine.terms[-1], at.gain[self.free] / self.unit[self.free]
        own = self.free[0] == self.free[1]
        down, up = [np.where(own, TRUST[0], -CROSS) - here], [np.where(own, TRUST[1], CROSS) - here]
        if self.full:
            ranges = np.array([(p.low, p.high) for p in self.engine.parameters], float)
            for ends, side in ((down, 0), (up, 1)):
                ends.insert(0, (ranges[:, side] - at.phi) / spans(self.problem))
        down.append(np.array([np.log(term.low) - at.size]))
        up.append(np.array([np.log(term.high) - at.size]))
        return np.minimum(np.concatenate(down), 0.0), np.maximum(np.concatenate(up), 0.0)

    def steps(self, at: Point) -> Float[np.ndarray, " m"]:
        """Difference steps of the free variables, away from a bound."""
        wide = [np.full(len(self.free[0]), GAIN), [SIZE]]
        if self.full:
            wide.insert(0, PHI / spans(self.problem))
        h = np.concatenate(wide)
        return np.where(self.bounds(at)[1] >= h, h, -h)

    def climbed(self, state: State, base: float) -> State:
        """The rival after Gauss-Newton steps with the weights of its noise. base: see `Gains`."""
        for _ in range(ITERATIONS):
            before = state
            state = self.step(state)
            if state.loglik - before.loglik < settled(state.loglik - base):
                break
        return state

    def step(self, state: State) -> State:
        """One Gauss-Newton step."""
        h = self.steps(state.at)
        ends = side_by_side(lambda row: self.innovations(self.moved(state.at, row)), np.diag(h))
        columns = np.stack([(e - state.e) / width for e, width in zip(ends, h, strict=True)])
        columns = np.where(np.isfinite(columns).all((1, 2), keepdims=True), columns, 0.0)
        w = weights(state.e, state.noise)
        weighted = (columns * w).reshape(len(h), -1)
        hessian = weighted @ columns.reshape(len(h), -1).T + PRIOR_PRECISION * np.eye(len(h))
        delta = lowest(hessian, weighted @ state.e.ravel(), *self.bounds(state.at))
        best = state
        for share in SHARES:
            there = self.fit(self.moved(state.at, share * delta))
            if there.loglik > best.loglik:
                best = there
            elif best is not state:
                break
            if best.loglik - state.loglik > ENOUGH * share * float(-delta @ (weighted @ state.e.ravel())) / 2:
                break
        # From the covariance of all free variables, at the point that the step started from.
        sd = np.sqrt(np.diag(np.linalg.inv(hessian)))
        phi_sd = sd[: len(state.at.phi)] * spans(self.problem) if self.full else np.inf
        return best._replace(sd=float(sd[-1]), phi_sd=phi_sd)


def fitted(problem: Problem, v: Variables, engines: Sequence[Engine], gains: Gains) -> list[State]:
    """The best rival of each id, best first.

    Of each id the engine whose best start is likeliest is fitted: first the gain of the joint and its constant; where
    that is promising, the parameters too. v: the model without the effects that the rivals replace; its command paths
    and other terms stay as they are.
    """
    few, best = _thinned(problem), {}
    given, gains_of_few = driven(few, v), _share(few, problem, gains)
    for engine in engines:
        search = _search(few, engine, given)
        state, effect = _best_start(search, v, _gain(problem, v, engine)), engine.terms[-1].effect
        if effect not in best or state.loglik > best[effect][1].loglik:
            best[effect] = search, state
    found = [(search, search.climbed(state, gains_of_few.base)) for search, state in best.values()]
    most = max([gains_of_few.found, *(s.loglik for _, s in found)])
    least = gains_of_few.base + CONTENDER * (most - gains_of_few.base)
    ends, whole = [], driven(problem, v)
    for search, state in found:
        on_all = search._replace(problem=problem, given=whole, full=True)
        if state.loglik > least:
            end = search._replace(full=True).climbed(state, gains_of_few.base)
            ends.append(on_all.step(on_all.fit(end.at)))
        else:
            ends.append(on_all.fit(state.at))
    return sorted((s for s in ends if np.isfinite(s.loglik)), key=lambda s: -s.loglik)


def _best_start(search: Search, v: Variables, gain: Float[np.ndarray, "s+h o"]) -> State:
    """The likeliest of the sizes at which a search starts; also with the parameters of the simulator, since those in v
    may make up for what the rival explains."""
    sizes = np.log(search.engine.terms[-1].starts).tolist()
    states = side_by_side(lambda size: search.fit(Point(np.asarray(v.phi, float), gain, size)), sizes)
    state = max(states, key=lambda s: s.loglik)
    nominal = np.asarray(search.problem.augmented.nominal, float)
    return max(state, search.fit(state.at._replace(phi=nominal)), key=lambda s: s.loglik)


def _thinned(problem: Problem) -> Problem:
    """The problem with `SEARCHED` of its segments scored, at most."""
    counts = np.array(problem.chunks.counts)
    scored = np.flatnonzero(counts.any(1))
    kept = scored[np.linspace(0, len(scored) - 1, min(SEARCHED, len(scored))).round().astype(int)]
    counts[np.setdiff1d(scored, kept)] = False
    return problem._replace(chunks=problem.chunks._replace(counts=counts))


def _share(few: Problem, problem: Problem, gains: Gains) -> Gains:
    """Log-likelihoods in proportion to the rows that are scored."""
    share = np.asarray(few.chunks.counts).sum() / np.asarray(problem.chunks.counts).sum()
    return Gains(*(float(share * g) for g in gains))


def refitted(problem: Problem, v: Variables, state: State, base: float) -> State:
    """A rival fitted on, with other command paths and terms of the engine, those in v. base: see `Gains`."""
    few, on_all = _thinned(problem), _search(problem, state.engine, driven(problem, v))._replace(full=True)
    search = on_all._replace(problem=few, given=driven(few, v))
    end = search.climbed(search.fit(state.at), _share(few, problem, Gains(base, base)).base)
    return on_all.step(on_all.fit(end.at))


def _gain(problem: Problem, v: Variables, engine: Engine) -> Float[np.ndarray, "s+h o"]:
    """The gain of v; at the joint that with which a search starts, and none for the hidden states. The gain of v there
    makes up for what the rival explains."""
    fields, outputs = engine.schema.state, len(engine.schema.outputs)
    whole = (gain_matrix(problem.augmented, problem.scales, a) for a in (v, start(problem)))
    own, first = (np.asarray(K, float)[:, :outputs] for K in whole)
    here = [f.body == engine.terms[-1].where for f in fields[: len(own)]]
    return np.vstack([np.where(np.array(here)[:, None], first, own), np.zeros((len(fields) - len(own), outputs))])


def _search(problem: Problem, engine: Engine, given: Driven) -> Search:
    """The gain is free among the states of the joint, which the rival's last term names."""
    fields, outputs = engine.schema.state, len(engine.schema.outputs)
    here = [i for i, f in enumerate(fields) if f.body == engine.terms[-1].where]
    i, j = np.array([(i, j) for i in here for j in here if j < outputs]).T
    rate = np.array([f.kind == "velocity" for f in fields], float)
    return Search(problem, engine, given, (i, j), engine.time_step ** (rate[None, :outputs] - rate[:, None]))
