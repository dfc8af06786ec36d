"""Explanations in passes. Each tabulates an engine, and estimates unmeasured states, with the fit of the last pass.

A simulator whose step is a JAX function and whose states are all measured needs a single pass.
"""

import numpy as np

from simgap.diagnosis.config import EXPLAINED
from simgap.diagnosis.inference.explain import explain
from simgap.diagnosis.inference.explanation import Explanation
from simgap.diagnosis.inference.fitting.model import Model, Reporter, refitted_without, settled
from simgap.diagnosis.inference.fitting.relinearise import itself
from simgap.diagnosis.inference.fitting.starts import fitted_starts, led
from simgap.diagnosis.inference.hidden.behind_joints import behind_joints
from simgap.diagnosis.inference.search.posterior import spread
from simgap.diagnosis.likelihood.problem import evaluate
from simgap.diagnosis.likelihood.unmeasured import estimated, guessed
from simgap.engines import Engine, is_engine
from simgap.layout import Layout
from simgap.types import Sessions, StepModel

PASSES = 3
"""Searches at most, each with tables made at the fit of the one before."""


def explained(
    simulator: StepModel | Engine, sessions: Sessions, rng: np.random.Generator, report: Reporter
) -> tuple[Explanation, Sessions]:
    """The explanation on which a simulator's tables and the simulator itself agree.

    Also returns the sessions with estimates of unmeasured states. Arguments and errors as in `diagnose`.
    """
    layout, before, latest = Layout(simulator.schema), None, None
    sessions = guessed(simulator, sessions)
    for number in range(1, PASSES + 1):
        before = latest
        if before is not None:
            sessions = _estimated(layout, before, sessions)
            report(f"pass {number}: engine tabulated at the last fit" if is_engine(simulator) else f"pass {number}")
        latest = explain(simulator, sessions, rng, report, before=before)
        if layout.observed.all() and (not is_engine(simulator) or agrees(latest)):
            break
        if before is not None and _same(before, latest) and agrees(latest):
            break
    else:
        # Searches that find something else each time have not found it.
        if before is not None and latest is not None:
            latest = latest._replace(unsettled=frozenset(latest.ids - before.ids))
    assert latest is not None  # there is a first pass
    latest = behind_joints(confirmed(latest, report), report)
    return latest, _estimated(layout, latest, sessions)


def _same(before: Explanation, latest: Explanation) -> bool:
    """Whether two passes name the same effects at the same places."""
    return {m.hypothesis.name for m in before.members} == {m.hypothesis.name for m in latest.members}


def agrees(found: Explanation) -> bool:
    """Whether the simulator itself explains the recordings as well as its tables do."""
    loglik = evaluate(itself(found.problem), found.fit.v, found.fit.groups, found.fit.noise).loglik
    gain = found.fit.loglik - found.base.loglik
    return abs(loglik - found.fit.loglik) <= settled(gain)


def confirmed(found: Explanation, report: Reporter) -> Explanation:
    """Drop the effects that an engine's tables support but the engine itself does not."""
    if not is_engine(found.problem.augmented.simulator) or not found.members:
        return found
    engine, noise = itself(found.problem), found.fit.noise
    loglik = evaluate(engine, found.fit.v, (), noise).loglik
    gains = [loglik - evaluate(engine, m.without.v, (), noise).loglik for m in found.members]
    unconfirmed = [m for m, gain in zip(found.members, gains, strict=True) if not gain >= EXPLAINED * m.gain]
    if not unconfirmed:
        return found
    for m in unconfirmed:
        report(f"{m.hypothesis.name} dropped: the engine itself does not confirm its tables")
    model = refitted_without(Model(found.problem, found.fit, np.empty(0)), [m.hypothesis for m in unconfirmed])
    members = tuple(m for m in found.members if m not in unconfirmed)
    return found._replace(fit=model.fit, sd=spread(*model), members=members)


def _estimated(layout: Layout, explanation: Explanation, sessions: Sessions) -> Sessions:
    """Sessions with the explanation's estimates of unmeasured states."""
    if layout.observed.all():
        return sessions
    problem, fit = explanation.problem, explanation.fit
    fitting, fit = fitted_starts(problem, fit, free=led(problem))
    unseen, _ = fitted_starts(problem._replace(chunks=explanation.unseen), fit, free=False)
    fitted, heldout = estimated(fitting, fit.v, sessions.fitted), estimated(unseen, fit.v, sessions.heldout)
    first = len(sessions.baseline)
    return Sessions(fitted[first:], heldout, fitted[:first])
