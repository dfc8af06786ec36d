"""Effects that an engine computes itself: one for each kind of term that it can switch on.

`law(c[1, sites]) -> values of the engine's terms [k]`.
"""

from functools import cache, partial

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from simgap.effects.effect import Constant, Effect, Scales, Site
from simgap.engines import Engine, Term


@cache
def effects_of(engine: Engine) -> tuple[Effect, ...]:
    """One effect for each id among the engine's terms; its sites are where the terms act."""
    kinds = dict.fromkeys((term.effect, term.form) for term in engine.terms)
    return tuple(_effect(engine, *kind) for kind in kinds)


def _effect(engine: Engine, id: str, form: str) -> Effect:
    index = np.array([i for i, term in enumerate(engine.terms) if (term.effect, term.form) == (id, form)])
    terms = [engine.terms[i] for i in index]
    first = terms[0]
    constant = Constant(
        first.constant, "{u}", partial(_physical, first.reciprocal, first.base), min(t.low for t in terms),
        max(t.high for t in terms), reciprocal=first.reciprocal,
    )  # fmt: skip
    return Effect(
        id, "engine", (constant,), lambda layout: tuple(map(_site, terms)),
        lambda scales, site: [[c] for c in terms[site].starts], partial(_law, index, len(engine.terms)), first.says,
        form=form, tie="same_unit" if first.shared else "never",
    )  # fmt: skip


def _site(term: Term) -> Site:
    return Site(term.where, term.channels, term.outputs, term.effect, term.unit)


def _physical(reciprocal: bool, base: float, c: float, site: int, scales: Scales) -> float:
    if not reciprocal:
        return base + c
    return 1 / c if c else np.inf


def _law(index: Int[np.ndarray, " n"], count: int, c: Float[Array, "1 n"]) -> Float[Array, " k"]:
    return jnp.zeros(count).at[index].set(c[0])
