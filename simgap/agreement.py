"""Agreement of columns that describe one motion: velocities with poses in their frame, commands with what they move."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from simgap.kinematics import commanded, motion
from simgap.layout import AXES, Layout, X, Y
from simgap.rows import by_row
from simgap.survey import leading
from simgap.types import Recording, Schema

ROWS = 50_000
"""Commands are compared in the first sessions that together have this many rows."""
DELAY_S = 1.0
"""Longest delay of a command that is searched for [s]."""


class Frame(NamedTuple):
    """How well a body's velocities match the change of its position, in the schema's frame and in the other frame.

    as_is, turned: cosines of the angle between the two series; 1 if they are proportional. world: whether the schema
    has the velocities in the world frame.
    """

    velocities: tuple[str, ...]
    positions: tuple[str, ...]
    yaw: str
    world: bool
    as_is: float
    turned: float


class Following(NamedTuple):
    """How a measured quantity follows its command, at the delay of the strongest correlation.

    slope: change of the quantity per change of the command.
    """

    measured: str
    slope: float
    correlation: float


def frames(schema: Schema, recordings: Sequence[Recording]) -> list[Frame]:
    """One for every body that has a heading, and positions in the world frame."""
    layout, compared = Layout(schema), []
    for b, heading in enumerate(layout.heading):
        axes = [a for a in (X, Y) if layout.velocity[b, a] >= 0]
        positions = [int(i) for i in layout.position[b, [X, Y]]]
        if heading is None or not axes or min(positions) < 0 or not layout.in_world("position", b):
            continue
        velocities = [int(layout.velocity[b, a]) for a in axes]
        world, own, measured = (np.concatenate(part) for part in zip(
            *(_moved(r, positions, heading, velocities) for r in recordings), strict=True))  # fmt: skip
        in_world = layout.in_world("velocity", b)
        as_is, turned = (world, own) if in_world else (own, world)
        name = lambda indices: tuple(schema.state[i].name for i in indices)  # noqa: E731
        compared.append(Frame(name(velocities), name(positions), schema.state[heading].name, in_world,
                              _cosine(measured, as_is[:, axes]), _cosine(measured, turned[:, axes])))  # fmt: skip
    return compared


def _moved(
    recording: Recording, positions: list[int], heading: int, velocities: list[int]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"], Float[np.ndarray, "n k"]]:
    """Rates of change of x and y along the world's axes and along the body's, and the mean of the rows' velocities."""
    world = np.diff(recording.state[:, positions], axis=0) / np.diff(recording.time_s)[:, None]
    turn = np.unwrap(recording.state[:, heading])
    turn = (turn[1:] + turn[:-1]) / 2
    x, y = world.T
    own = np.column_stack([np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x])
    measured = recording.state[:, velocities]
    return world, own, (measured[1:] + measured[:-1]) / 2


def _cosine(a: np.ndarray, b: np.ndarray) -> float:
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float((a * b).sum() / size) if size else 0.0


def following(schema: Schema, recordings: Sequence[Recording]) -> dict[str, Following]:
    """By command, for commands of a velocity, position or angle that is measured.

    Velocities are compared in the body's own frame, minus those of its carrier.
    """
    used = leading(recordings, ROWS)
    session = np.repeat(np.arange(len(used)), [len(r.time_s) for r in used])
    step = float(np.median(np.concatenate([np.diff(r.time_s) for r in used])))
    delays = range(min(int(DELAY_S / step) + 1, 100, len(session) - 1))
    followed = {}
    for name, measured, command, value in _commanded(schema, used):
        fits = [_fit(command, value, session, k) for k in delays]
        slope, correlation = max(fits, key=lambda fit: abs(fit[1]), default=(0.0, 0.0))
        if correlation:
            followed[name] = Following(measured, slope, correlation)
    return followed


def _commanded(
    schema: Schema, recordings: Sequence[Recording]
) -> Iterator[tuple[str, str, Float[np.ndarray, " T"], Float[np.ndarray, " T"]]]:
    """Names of a command and of the quantity that it commands, and the values of both."""
    state = np.concatenate([r.state for r in recordings])
    command = np.concatenate([r.command for r in recordings])
    for i, field in enumerate(schema.command):
        same = [k for k, f in enumerate(schema.state)
                if field.body and (f.body, f.axis, f.kind, f.frame) == (field.body, field.axis, field.kind, field.frame)
                and f.kind in ("position", "angle")]  # fmt: skip
        if same:
            yield field.name, schema.state[same[0]].name, command[:, i], state[:, same[0]]
    layout = Layout(schema)
    pairs = [(b, a) for b in range(len(layout.bodies)) for a in range(len(AXES)) if layout.velocity[b, a] >= 0
             and layout.command[b, a] >= 0 and schema.command[layout.command[b, a]].kind == "velocity"]  # fmt: skip
    if not pairs:
        return
    velocity, _, heading = by_row(motion, layout, state)
    for b, a in pairs:
        own = jax.vmap(lambda h, u, b=b: commanded(layout, b, h, u))(heading[:, b], jnp.asarray(command, jnp.float32))
        names = schema.command[layout.command[b, a]].name, schema.state[layout.velocity[b, a]].name
        yield *names, np.asarray(own)[:, a], velocity[:, b, a]


def _fit(command: np.ndarray, value: np.ndarray, session: np.ndarray, delay: int) -> tuple[float, float]:
    """Slope of the value on the command `delay` rows before, and their correlation."""
    same = session[delay:] == session[: len(session) - delay]
    u, v = command[: len(command) - delay][same], value[delay:][same]
    if len(u) < 3 or not np.ptp(u) or not np.ptp(v):
        return 0.0, 0.0
    u, v = u - u.mean(dtype=np.float64), v - v.mean(dtype=np.float64)
    return float(u @ v / (u @ u)), float(u @ v / np.sqrt((u @ u) * (v @ v)))
