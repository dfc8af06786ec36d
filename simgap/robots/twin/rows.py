"""What each recorded row says beyond the model: how long it lasted, and what the model missed."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import logsumexp
from jaxtyping import Array, Float

from simgap.noise import student_t_log_density
from simgap.recordings import HISTORY, to_transitions
from simgap.residual import duration
from simgap.residual.model import ResidualModel
from simgap.robots.twin.model import SHOULDER, advance, departure, true
from simgap.simulators.spot import SCHEMA, to_body
from simgap.types import Recording

GRID = np.exp(np.linspace(np.log(0.4), np.log(10.0), 128)).astype(np.float32)
"""Durations to choose from [steps]: neighbours differ by 2.5 %, less than the rows' own scatter."""
WIDTH = 0.1
"""Of the kernel that makes a density of the equally likely durations of the model, relative: about their spacing."""


class Rows(NamedTuple):
    """A session as windows are cut from it: measured states, commands, and the duration [steps] of every row, of which
    the first `HISTORY` are taken to last one step."""

    state: Float[np.ndarray | Array, "T 12"]
    command: Float[np.ndarray | Array, "T 6"]
    duration: Float[np.ndarray | Array, " T-1"]


def timed(model: ResidualModel, recording: Recording) -> Rows:
    """A session, every row with its likeliest duration under the model's law of durations and its noise."""
    rows = to_transitions(SCHEMA, [recording])
    likeliest = _likeliest(model, jnp.asarray(rows.x), jnp.asarray(rows.y))
    return Rows(recording.state, recording.command, np.concatenate([np.ones(HISTORY), np.asarray(likeliest)]))


@jax.jit
def _likeliest(model: ResidualModel, x: Float[Array, "n x"], y: Float[Array, "n y"]) -> Float[Array, " n"]:
    grid = jnp.asarray(GRID)
    apart = (jnp.log(grid)[:, None] - jnp.log(model.durations)) / WIDTH
    prior = logsumexp(-(apart**2) / 2, axis=1)

    def one(x: Float[Array, " x"], y: Float[Array, " y"]) -> Float[Array, ""]:
        changes = duration.after(duration.path(model.simulator, model.params, x), grid)
        likelihood = student_t_log_density(y - changes, model.scale, model.dof).sum(-1)
        return grid[jnp.argmax(likelihood + prior)]

    return jax.vmap(one)(x, y)


def missed(
    model: ResidualModel, ages: Float[Array, " 2"], reach: Float[Array, ""], rows: Rows
) -> Float[np.ndarray, "n 12"]:
    """What the model missed in every row that has its history of commands; see `Twin`."""
    return np.asarray(_missed(model, ages, reach, Rows(*(jnp.asarray(a, jnp.float32) for a in rows))))


@jax.jit
def _missed(
    model: ResidualModel, ages: Float[Array, " 2"], reach: Float[Array, ""], rows: Rows
) -> Float[Array, "n 12"]:
    def one(t: Array) -> Float[Array, " 12"]:
        start, real = (true(rows.state[k], ages) for k in (t, t + 1))
        sent = jax.lax.dynamic_slice_in_dim(rows.command, t - HISTORY, HISTORY + 1)
        return departure(start, advance(model, reach, start, sent, rows.duration[t]), real)

    return jax.vmap(one)(jnp.arange(HISTORY, len(rows.state) - 1))


def reach(recordings: Sequence[Recording]) -> float:
    """The greatest distance of the hand from the shoulder [m]."""
    hands = np.concatenate(
        [np.asarray(jax.vmap(to_body)(jnp.asarray(r.state, jnp.float32)))[:, 6:9] for r in recordings]
    )
    return float(np.linalg.norm(hands - np.array(SHOULDER), axis=1).max())


def seconds(recordings: Sequence[Recording]) -> float:
    """What a row lasts on average [s]: the measured changes of positions over the measured velocities, by regression.

    Where recordings have no time stamps of their own, this says what their clock was.
    """
    moved, speed = [], []
    for r in recordings:
        change = np.diff(r.state.reshape(-1, 4, 3)[:, 0::2], axis=0)
        change[:, 0, 2] = (change[:, 0, 2] + np.pi) % (2 * np.pi) - np.pi
        velocity = r.state.reshape(-1, 4, 3)[:, 1::2]
        moved.append(change.ravel())
        speed.append(((velocity[1:] + velocity[:-1]) / 2).ravel())
    v = np.concatenate(speed)
    return float(np.concatenate(moved) @ v / (v @ v))
