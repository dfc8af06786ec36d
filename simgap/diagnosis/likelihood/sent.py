"""The commands that act in the rows of segments: what laws on their way make of those that were sent.

They depend on no state, so they are computed first. On phi they depend only by how fast the early part of a row is
forgotten (`effects.command_path`).
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.diagnosis.likelihood.segments import Chunks, bare
from simgap.diagnosis.likelihood.traced import fading, follow, remember
from simgap.diagnosis.likelihood.variables import Variables, acting
from simgap.effects.augmented import Active, Augmented, Theta
from simgap.effects.effect import Memory, Row
from simgap.effects.step import unsense
from simgap.effects.stepping import terms_of


def start_of(augmented: Augmented, v: Variables, chunk: Chunks) -> tuple[Theta, Float[Array, " s"]]:
    """Constants and state estimate at the beginning of a segment (here and below without its leading axis C)."""
    at_start = acting(v, v.theta, chunk.gate[:, 0])
    return at_start, unsense(augmented, at_start, chunk.state[0], chunk.time_s[0])


def begun_of(
    augmented: Augmented, v: Variables, forgets: Float[Array, " u"], active: Active, chunk: Chunks
) -> tuple[Memory, Float[Array, " s"]]:
    """Memory and state estimate there."""
    at_start, first = start_of(augmented, v, chunk)
    return remember(augmented, forgets, at_start, first, chunk.earlier, chunk.time_s[0], active), first


def sent_by(
    augmented: Augmented, v: Variables, thetas: Float[Array, "k P"], active: Active, chunk: Chunks, memory: Memory
) -> Float[Array, "T-1 k ... u"]:
    """The commands that act in each row with each of k sets of constants, after earlier rows with the first of them."""

    def row(memory: Memory, now: tuple) -> tuple[Memory, Float[Array, "k ... u"]]:
        u, time_s, interval, gate = now
        step = lambda theta: follow(augmented, acting(v, theta, gate), memory, u, Row(time_s, interval), active)  # noqa: E731
        after, sent = each_of(step, thetas)
        return jax.tree.map(lambda a: a[0], after), sent

    rows = (chunk.command[:-1], chunk.time_s[:-1], chunk.interval[:-1], chunk.gate[:, :-1].T)
    return jax.lax.scan(row, memory, rows)[1]


def each_of(step: Callable[..., Any], *over: Any) -> Any:
    """`step` for each set of constants; compiled once."""
    if jax.tree.leaves(over)[0].shape[0] == 1:
        return jax.tree.map(lambda a: a[None], step(*jax.tree.map(lambda a: a[0], over)))
    return jax.lax.map(lambda each: step(*each), over)


@partial(jax.jit, static_argnames="augmented")
def fading_by_phi(augmented: Augmented, v: Variables) -> Float[Array, "u p"]:
    """How fast the early part of a row is forgotten, per command: derivatives by phi."""
    active = augmented.active(v.theta, *v.delta)
    return jax.jacfwd(lambda phi: fading(augmented, phi, v.theta, active))(jnp.asarray(v.phi))


@partial(jax.jit, static_argnames="augmented")
def sent_of(augmented: Augmented, v: Variables, chunks: Chunks) -> Float[Array, "C T-1 parts u"]:
    """Commands that act in each part of an engine's rows."""
    active = augmented.active(v.theta, *v.delta)
    forgets = fading(augmented, jnp.asarray(v.phi), v.theta, active)

    def one(chunk: Chunks) -> Float[Array, "T-1 parts u"]:
        memory, _ = begun_of(augmented, v, forgets, active, chunk)
        return sent_by(augmented, v, jnp.asarray(v.theta)[None], active, chunk, memory)[:, 0]

    return jax.vmap(one)(bare(chunks)._replace(table=None))


def terms_in_rows(augmented: Augmented, v: Variables, chunks: Chunks) -> Float[np.ndarray, "C T-1 k"]:
    """An engine's terms in each row."""

    def terms(gate: Float[Array, " S"]) -> Float[Array, " k"]:
        values = terms_of(augmented, acting(v, v.theta, gate))
        assert values is not None  # an engine has them
        return values

    return np.asarray(jax.vmap(jax.vmap(terms))(jnp.swapaxes(chunks.gate[..., :-1], 1, 2)))
