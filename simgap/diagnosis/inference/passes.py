"""Explanations in passes: an engine is tabulated anew where the last one led, and so are states that nobody measured.

A simulator whose step is a function of JAX's and whose states are all measured needs a single pass.
"""

import numpy as np

from simgap.diagnosis.inference.explain import explain
from simgap.diagnosis.inference.explanation import Explanation
from simgap.diagnosis.inference.model import Model, Reporter, refitted_without, settled
from simgap.diagnosis.inference.posterior import spread
from simgap.diagnosis.inference.relinearise import itself
from simgap.diagnosis.likelihood.problem import evaluate
from simgap.diagnosis.likelihood.unmeasured import estimated, guessed
from simgap.engines import Engine, is_engine
from simgap.layout import Layout
from simgap.types import Sessions, StepModel

CONFIRMED = 0.5
"""Share of an effect's gain by an engine's tables that the engine itself must give as well."""
PASSES = 3
"""Searches at most, each on tables made where the one before ended."""


def explained(
    simulator: StepModel | Engine, sessions: Sessions, rng: np.random.Generator, report: Reporter
) -> tuple[Explanation, Sessions]:
    """The explanation that a simulator's tables and the simulator itself agree on, and the sessions with estimates of
    the states that they lack; arguments and errors as in `diagnose`."""
    layout, found = Layout(simulator.schema), None
    sessions = guessed(layout, sessions)
    for number in range(1, PASSES + 1):
        before = found
        if before is not None:
            sessions = _estimated(layout, before, sessions)
            report(f"pass {number}: the engine where the last pass led" if is_engine(simulator) else f"pass {number}")
        found = explain(simulator, sessions, rng, report, before=before)
        if layout.observed.all() and (not is_engine(simulator) or agrees(found)):
            break
        if before is not None and _same(before, found) and agrees(found):
            break
    assert found is not None  # there is a first pass
    return confirmed(found, report), sessions


def _same(before: Explanation, found: Explanation) -> bool:
    """Whether two passes name the same effects at the same places."""
    return {m.hypothesis.name for m in before.members} == {m.hypothesis.name for m in found.members}


def agrees(found: Explanation) -> bool:
    """Whether the simulator itself explains the recordings as well as its tables."""
    loglik = evaluate(itself(found.problem), found.fit.v, found.fit.groups, found.fit.noise).loglik
    gain = found.fit.loglik - found.base.loglik
    return abs(loglik - found.fit.loglik) <= settled(gain)


def confirmed(found: Explanation, report: Reporter) -> Explanation:
    """Without the effects that an engine itself does not bear out, though its tables do."""
    if not is_engine(found.problem.augmented.simulator) or not found.members:
        return found
    engine, noise = itself(found.problem), found.fit.noise
    whole = evaluate(engine, found.fit.v, (), noise).loglik
    gained = [whole - evaluate(engine, m.without.v, (), noise).loglik for m in found.members]
    weak = [m for m, gain in zip(found.members, gained, strict=True) if not gain >= CONFIRMED * m.gain]
    if not weak:
        return found
    for m in weak:
        report(f"{m.hypothesis.name} does not stand: the engine itself does not agree with its tables")
    model = refitted_without(Model(found.problem, found.fit, np.empty(0)), [m.hypothesis for m in weak])
    members = tuple(m for m in found.members if m not in weak)
    return found._replace(fit=model.fit, sd=spread(*model), members=members)


def _estimated(layout: Layout, found: Explanation, sessions: Sessions) -> Sessions:
    """Sessions with the explanation's estimates of the states that they lack."""
    if layout.observed.all():
        return sessions
    fitted = estimated(found.problem, found.fit.v, found.problem.chunks, sessions.fitted)
    heldout = estimated(found.problem, found.fit.v, found.unseen, sessions.heldout)
    first = len(sessions.baseline)
    return Sessions(fitted[first:], heldout, fitted[:first])
