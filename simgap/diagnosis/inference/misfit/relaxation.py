"""Laws are not exact: how wrong each accepted effect may be, so that its misfit is not credited to a further effect.

Every effect gets a flexible law at each of its sites: the effect's own contribution, earlier or later, and stronger or
weaker depending on what the site does; and pushes along the site's axes that depend on what it does. A prior limits its
size: `DISCREPANCY`, a share of the effect's own contribution.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from simgap.diagnosis.config import DISCREPANCY
from simgap.diagnosis.hypotheses.library import dictionary, quantities, sent_until, values
from simgap.diagnosis.hypotheses.place import Place, place_of
from simgap.diagnosis.hypotheses.space import Hypothesis
from simgap.diagnosis.inference.evidence.score_test import DEPENDENT, basis_of
from simgap.diagnosis.inference.fitting.model import Model, Trial, absorbing, without
from simgap.diagnosis.inference.misfit.impulse_response import direction, own_echoes
from simgap.diagnosis.likelihood.problem import Group, Problem, trials
from simgap.diagnosis.likelihood.segments import rows_of
from simgap.diagnosis.likelihood.student_t import weights
from simgap.effects.effect import HISTORY_ROWS

LAGS = (-2, -1, 1, 2, 3, 4)
"""Rows by which an effect's contribution may be delayed."""
NARROW = (0.02, 0.06, 0.2)
"""Widths about zero, as shares of a quantity's usual size."""
NOTHING = 1e-9
"""Squared lengths of directions [nats] below this count as zero."""


class Room(NamedTuple):
    """What a model absorbs of a direction, with rows scaled by the roots of their weights.

    free: by its free constants (orthonormal columns). misfit: by the misfit of its effects (columns T such that
    1 - T T' removes that part).
    """

    root: Float[np.ndarray, "n s"]
    residual: Float[np.ndarray, "n s"]
    free: Float[np.ndarray, "m r"]
    misfit: Float[np.ndarray, "m k"]

    @property
    def whole(self) -> Float[np.ndarray, "m r+k"]:
        """The columns of both."""
        return np.concatenate([self.free, self.misfit], axis=1)

    def judged(self, tried: Trial) -> Trial:
        """The trial with the share of its gain that misfit does not explain."""
        if not self.misfit.shape[1]:
            return tried
        d = ((tried.fit.e - tried.without.e) * self.root).ravel()
        gained, beyond = (_gain(d, self.residual.ravel(), basis) for basis in (self.free, self.whole))
        return tried._replace(share=min(beyond / max(gained, NOTHING), 1.0))


def _gain(d: Float[np.ndarray, " m"], residual: Float[np.ndarray, " m"], basis: Float[np.ndarray, "m r"]) -> float:
    """Gain [nats] of the residual along a direction, beyond what the basis absorbs."""
    d, residual = (a - basis @ (basis.T @ a) for a in (d, residual))
    return 0.5 * float(d @ residual) ** 2 / max(float(d @ d), NOTHING)


def room(model: Model, columns: Float[np.ndarray, "M n s"], effects: Sequence[Hypothesis]) -> Room:
    """The room of a model, given derivatives by its free constants, and its effects."""
    fit = model.fit
    root = np.sqrt(weights(fit.e, fit.noise)).astype(np.float32)
    free = basis_of(columns.reshape(len(columns), root.size) * root.ravel())
    misfit = relaxations(model, effects, root) if effects else np.zeros((0, *root.shape), np.float32)
    return Room(root, fit.e * root, free, softly(misfit.reshape(len(misfit), root.size) * root.ravel(), free))


def relaxations(
    model: Model, effects: Sequence[Hypothesis], root: Float[np.ndarray, "n s"]
) -> Float[np.ndarray, "K n s"]:
    """Directions in which the innovations may deviate from the effects' laws, with coefficients of about one."""
    problem, fit, _ = model
    layout, counts = problem.augmented.layout, np.asarray(problem.chunks.counts)
    known, z = quantities(layout), values(problem, fit.v)
    places = [(effect.effect.bends, *site) for effect in effects for site in _per_site(problem, effect)]
    responses = own_echoes(problem, fit.v, {axis for _, _, place in places for axis in place.axes(layout)})
    blocks = []
    for bends, groups, place in places:
        own = fit.e - trials(problem, [without(fit, groups).v])[0]
        index = place.quantities(layout, known, bends)
        functions = dictionary([known[i] for i in index], z[counts][:, index])
        pushes = [f.of(z[..., index]) for f in functions] + [p for i in index for p in _narrow_about_zero(z[..., i])]
        varied = [own * push[counts][:, None].astype(np.float32) for push in pushes]
        if "past" in bends:
            pushes += _past_commands(problem, place)
        directions = [direction(problem, responses[a], pushes) for a in place.axes(layout) if a in responses and pushes]
        columns = [_shifted(own, rows_of(problem.chunks).session), *([np.stack(varied)] if varied else []), *directions]
        blocks.append(_scaled(np.concatenate(columns), own, root))
    return np.concatenate(blocks).astype(np.float32)


def _scaled(
    columns: Float[np.ndarray, "K n s"], own: Float[np.ndarray, "n s"], root: Float[np.ndarray, "n s"]
) -> Float[np.ndarray, "K n s"]:
    """Columns scaled so that all together, with coefficients of about one, make up `DISCREPANCY` of a contribution."""
    size = np.sqrt(((columns * root) ** 2).sum((1, 2)))
    length = DISCREPANCY * np.sqrt(((own * root) ** 2).sum() / len(columns))
    return columns * np.where(size > NOTHING, length / np.maximum(size, NOTHING), 0.0)[:, None, None]


def _per_site(problem: Problem, effect: Hypothesis) -> list[tuple[tuple[Group, ...], Place]]:
    """The constants of each site alone, and its place."""
    augmented = problem.augmented
    sites = augmented.sites[augmented.catalogue.index(effect.effect)]
    return [
        (tuple(Group((g.entries[k],), g.scale, g.support) for g in effect.groups), place_of(augmented.layout, sites[s]))
        for k, s in enumerate(effect.sites)
    ]


def _narrow_about_zero(values: Float[np.ndarray, "C T-1"]) -> list[Float[np.ndarray, "C T-1"]]:
    """Even and odd functions of a quantity that are narrow about zero, where a law may change its form."""
    usual = max(float(np.quantile(np.abs(values), 0.9)), NOTHING)
    even = [np.exp(-np.abs(values) / (share * usual)) for share in NARROW]
    return [*even, *(np.sign(values) * e for e in even)]


def _past_commands(problem: Problem, place: Place) -> list[Float[np.ndarray, "C T-1"]]:
    """Pushes by the commands of previous rows: any response to the commands is a combination of these."""
    commands, sent = [f.name for f in problem.augmented.layout.schema.command], sent_until(problem.chunks)
    first, end = np.asarray(problem.chunks.past).shape[1], sent.shape[1]
    return [
        sent[:, first - lag : end - lag, commands.index(name)]
        for name in place.channels
        for lag in range(HISTORY_ROWS + 1)
    ]


def _shifted(own: Float[np.ndarray, "n s"], session: Int[np.ndarray, " n"]) -> Float[np.ndarray, "l n s"]:
    """A contribution shifted earlier and later by some rows, within sessions."""
    shifted = np.zeros((len(LAGS), *own.shape), own.dtype)
    for i, lag in enumerate(LAGS):
        to, of = (slice(lag, None), slice(None, -lag)) if lag > 0 else (slice(None, lag), slice(-lag, None))
        shifted[i, to] = np.where((session[to] == session[of])[:, None], own[of], 0.0)
    return shifted


def softly(columns: Float[np.ndarray, "K m"], basis: Float[np.ndarray, "m r"]) -> Float[np.ndarray, "m k"]:
    """Columns T such that 1 - T T' removes from a direction what the given columns, with coefficients of about one,
    absorb of it beyond the basis."""
    if not len(columns):
        return np.zeros((len(basis), 0), np.float32)
    columns = columns - (columns @ basis) @ basis.T
    squared, axes = np.linalg.eigh((columns @ columns.T).astype(np.float64))
    kept = squared > DEPENDENT * max(squared[-1], NOTHING)
    squared, axes = squared[kept], axes[:, kept]
    # A prior of variance one leaves the share s^2 = 1 / (squared + 1) of a product; each of its two factors keeps s.
    taken = np.sqrt(1 - np.sqrt(1 / (squared + 1)))
    return columns.T @ (axes * taken / np.sqrt(squared)).astype(np.float32)


def misfits(model: Model, effects: Sequence[Hypothesis]) -> list[float]:
    """Further gain [nats] of each of a model's effects if its law could bend, minus the gain by chance.

    The prior makes bending beyond the law's own size unlikely, and limits its gain accordingly.
    """
    columns = absorbing(model)
    return [_misfit(room(model, columns, [effect])) for effect in effects]


def _misfit(around: Room) -> float:
    r = around.residual.ravel()
    r = r - around.free @ (around.free.T @ r)
    rest = r - around.misfit @ (around.misfit.T @ r)
    squared = (around.misfit**2).sum(0)
    by_chance = float((1 - (1 - squared) ** 2).sum()) * float(r @ r) / len(r)
    return max(0.5 * (float(r @ r) - float(rest @ rest) - by_chance), 0.0)
