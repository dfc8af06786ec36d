"""Whether effects are still needed when parameters may leave their ranges.

A range that is too narrow looks like missing physics, so no claim may depend on one.
"""

from simgap.diagnosis.config import LEAST_SHARE
from simgap.diagnosis.inference.explanation import Explanation
from simgap.diagnosis.inference.fitting.gauss_newton import optimise
from simgap.diagnosis.inference.fitting.model import Model, refitted_without, settled
from simgap.diagnosis.inference.search.alternatives import Member
from simgap.diagnosis.likelihood.problem import evaluate
from simgap.threads import side_by_side


def needed_beyond_ranges(found: Explanation) -> bool:
    """Whether each effect, given the others, gains as much as a search requires while no range limits the parameters.

    False without effects. The fits without an effect start from the parameters with all effects, and from those without
    any: a parameter whose range is too narrow goes furthest there.
    """
    if not found.members:
        return False
    problem = found.problem._replace(ranges_hold=False)
    fits = found.fit, found.base
    whole, bare = (Model(problem, *optimise(problem, evaluate(problem, fit.v, fit.groups))) for fit in fits)
    required = max(found.rounds[0].screening.threshold / 2, LEAST_SHARE * (whole.fit.loglik - bare.fit.loglik))
    return min(side_by_side(lambda member: _gain(whole, bare, member), found.members)) > required


def _gain(whole: Model, bare: Model, member: Member) -> float:
    """Gain [nats] of an effect over the better of two fits without it."""
    fit = whole.fit
    from_bare = bare.fit.v._replace(theta=fit.v.theta, delta=fit.v.delta)
    starts = fit, fit._replace(v=from_bare)
    reduced = (refitted_without(whole._replace(fit=f), [member.hypothesis], settled(member.gain)) for f in starts)
    return fit.loglik - max(model.fit.loglik for model in reduced)
