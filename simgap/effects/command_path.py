"""Effects on the way from a command that is sent to the command that acts.

A law of place "command" is `law(c[k, sites], u, memory, row, layout) -> u`; one of place "filter" is
`law(c[k, sites], u, z, fading) -> (z, u)`: what it remembers, and the command that acts.

A simulator holds a command for a row, a robot does not: it may change within. What acts is the constant command that
leads to the same velocity at the row's end. There a joint that follows its command as a first-order system has
forgotten more of what came early in the row: with v = a v + (1 - a) u over a row, a command at the time s of it, 0 to
1, weighs as exp(fading s), fading = -ln a. Where nothing is forgotten, as with a force, that is the command's mean.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.effects.effect import HISTORY_ROWS, Constant, Effect, Memory, Row, Scales, Site, channel_sites
from simgap.kinematics import placed, substituted
from simgap.layout import Layout, X, Y
from simgap.types import StepModel

_U = Float[Array, " u"]
NEVER = 1e-6
"""Fading of what forgets nothing, or nearly."""
AT_ONCE = 4.0
"""Greatest fading: a joint that follows nearly at once still takes a part of a row."""


def fading_of(simulator: StepModel, layout: Layout, phi: Float[Array, " p"]) -> _U:
    """-ln a of every command [u], by the response at rest of the velocity it drives; `NEVER` where it drives none."""
    rest = jnp.zeros(len(layout.schema.state)), jnp.zeros(len(layout.schema.command))
    response = jax.jacfwd(lambda u: simulator.step(phi, rest[0], u))(rest[1])
    kept = []
    for i, field in enumerate(layout.schema.command):
        driven = layout.velocity[layout.command == i]
        follows = field.kind == "velocity" and len(driven) and driven[0] >= 0
        kept.append(1 - response[driven[0], i] if follows else 1.0)
    return jnp.clip(-jnp.log(jnp.maximum(jnp.array(kept), np.exp(-AT_ONCE))), NEVER, AT_ONCE)


def _beyond_one(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """(exp(x) - 1) / x - 1, by its series where that is rounding."""
    away = jnp.where(jnp.abs(x) < 0.1, 0.1, x)
    return jnp.where(jnp.abs(x) < 0.1, x / 2 + x**2 / 6 + x**3 / 24 + x**4 / 120, jnp.expm1(away) / away - 1)


def _delay(c: Float[Array, "1 u"], u: _U, memory: Memory, row: Row, layout: Layout) -> _U:
    """u(t - d), d = c rows: first still the older of two rows' commands."""
    whole = jnp.floor(c[0])
    share = jnp.expm1(memory.fading * (c[0] - whole)) / jnp.expm1(memory.fading)
    for k, (newer, older) in enumerate(zip([u, *memory.commands[:-1]], memory.commands, strict=True)):
        u = u + jnp.where(k < whole, 1.0, jnp.where(k == whole, share, 0.0)) * (older - newer)
    return u


def _quantization(c: Float[Array, "1 u"], u: _U, memory: Memory, row: Row, layout: Layout) -> _U:
    """Multiples of the step c."""
    step = jnp.where(c[0] > 0, c[0], 1.0)
    return jnp.where(c[0] > 0, jnp.round(u / step) * step, u)


def _deadband(c: Float[Array, "1 u"], u: _U, memory: Memory, row: Row, layout: Layout) -> _U:
    """Nothing below the width c, the rest shifted by it."""
    return u - jnp.clip(u, -c[0], c[0])


def _backlash(c: Float[Array, "1 u"], u: _U, z: _U, fading: _U) -> tuple[_U, _U]:
    """Play of gap c: the output is dragged along at the gap's ends."""
    z = jnp.clip(z, u - c[0] / 2, u + c[0] / 2)
    return z, z


def _gain(c: Float[Array, "1 u"], u: _U, memory: Memory, row: Row, layout: Layout) -> _U:
    """(1 + c) u."""
    return u * (1 + c[0])


def _asymmetric_gain(side: int):
    def law(c: Float[Array, "1 u"], u: _U, memory: Memory, row: Row, layout: Layout) -> _U:
        """(1 - c) u where u has the sign of the side."""
        return u - c[0] * side * jnp.maximum(side * u, 0.0)

    return law


def _gain_drift(c: Float[Array, "1 u"], u: _U, memory: Memory, row: Row, layout: Layout) -> _U:
    """(1 + c t) u, t in minutes."""
    return u * (1 + c[0] * row.time_s / 60)


def _saturation(c: Float[Array, "1 u"], u: _U, memory: Memory, row: Row, layout: Layout) -> _U:
    """u within +-1/c."""
    return u / jnp.maximum(1.0, jnp.abs(u) * c[0])


def _rate_limit(c: Float[Array, "1 u"], u: _U, z: _U, fading: _U) -> tuple[_U, _U]:
    """A ramp from z towards u by 1/c a row: where it ends, and what it amounts to over the row, which acts.

    Both are u less a share of its change, so that without a limit they are u exactly.
    """
    change = u - z
    rows = jnp.abs(change) * c[0]
    ended = jnp.maximum(rows, 1.0)
    missed = lambda rows: _beyond_one(fading * rows) / jnp.expm1(fading)  # noqa: E731 # by a ramp of less than a row
    share = jnp.where(rows < 1, missed(jnp.minimum(rows, 1.0)), 1 - (1 - missed(1.0)) / ended)
    return u - change * (1 - 1 / ended), u - change * share


def _lag(c: Float[Array, "1 u"], u: _U, z: _U, fading: _U) -> tuple[_U, _U]:
    """First-order response with a time constant of c rows: where it ends, and what it amounts to over the row."""
    rate = 1 / jnp.maximum(c[0], 1e-6)
    missed = jnp.where(c[0] > 0, (1 + _beyond_one(fading - rate)) / (1 + _beyond_one(fading)), 0.0)
    return u + jnp.where(c[0] > 0, jnp.exp(-rate), 0.0) * (z - u), u - missed * (u - z)


def _pairs(layout: Layout) -> list[tuple[int, int]]:
    """(from, to) command indices of the same body."""
    fields = layout.schema.command
    return [
        (i, j) for i, f in enumerate(fields) for j, g in enumerate(fields) if i != j and f.body and f.body == g.body
    ]


def _pair_sites(layout: Layout) -> tuple[Site, ...]:
    sites = channel_sites(layout)
    return tuple(
        Site(
            f"{sites[i].name} into {sites[j].name}", (sites[i].name,), sites[j].outputs, sites[i].family, sites[j].unit
        )
        for i, j in _pairs(layout)
    )


def _cross_axis(c: Float[Array, "1 n"], u: _U, memory: Memory, row: Row, layout: Layout) -> _U:
    """u_j + c u_i."""
    leak = jnp.zeros_like(u)
    for k, (i, j) in enumerate(_pairs(layout)):
        leak = leak + placed(len(u), j, c[0, k] * u[i])
    return u + leak


def _planar(layout: Layout) -> list[int]:
    return [b for b in range(len(layout.bodies)) if all(layout.command[b, [X, Y]] >= 0)]


def _planar_sites(layout: Layout) -> tuple[Site, ...]:
    return tuple(
        Site(layout.bodies[b], tuple(layout.schema.command[i].name for i in layout.command[b, [X, Y]]),
             layout.outputs(b, (X, Y)), "frame", "rad")
        for b in _planar(layout)
    )  # fmt: skip


def _misalignment(c: Float[Array, "1 n"], u: _U, memory: Memory, row: Row, layout: Layout) -> _U:
    """Horizontal commands turned by the angle c."""
    for k, b in enumerate(_planar(layout)):
        ix, iy = (int(i) for i in layout.command[b, [X, Y]])
        cos, sin = jnp.cos(c[0, k]), jnp.sin(c[0, k])
        x, y = cos * u[ix] - sin * u[iy], sin * u[ix] + cos * u[iy]
        u = substituted(substituted(u, ix, x), iy, y)
    return u


def _fractions(*fractions: float):
    """Starting values as fractions of the channel's usual command."""
    return lambda scales, site: [[f * float(scales.command[site])] for f in fractions]


def _reciprocals(usual: Callable[[Scales], np.ndarray], *fractions: float):
    """Of fractions of what is usual in the channel; beyond it too, where few rows feel a limit, but strongly."""
    return lambda scales, site: [[1 / (f * float(usual(scales)[site]))] for f in fractions]


def _fixed(*values: float):
    return lambda scales, site: [[v] for v in values]


def _reciprocal(c: float, *_: object) -> float:
    return 1 / c if c else np.inf


_RATIO = (Constant("ratio", "-", lambda c, site, scales: 1 - c, -2.0, 0.95),)

EFFECTS = (
    Effect(
        "delay", "command",
        (Constant("delay", "s", lambda c, site, scales: c * scales.time_step, 0.0, float(HISTORY_ROWS)),),
        channel_sites, _fixed(0.5, 1.0, 2.0, 3.5, 5.0, 7.0), _delay,
        "dead time: commands act {delay} after they are sent", tie="any",
    ),
    Effect(
        "quantization", "command", (Constant("step", "{u}", low=0.0),), channel_sites,
        _fractions(*np.geomspace(0.06, 0.9, 24)), _quantization,
        "commands are followed in steps of {step}", tie="same_unit", jagged=True,
    ),
    Effect(
        "deadband", "command", (Constant("width", "{u}", low=0.0),), channel_sites, _fractions(0.05, 0.15, 0.35),
        _deadband, "dead band: commands below {width} do nothing", tie="same_unit",
    ),
    Effect(
        "backlash", "filter", (Constant("gap", "{u}", low=0.0),), channel_sites, _fractions(0.1, 0.3, 0.7),
        _backlash, "play: after a reversal the motion waits until a gap of {gap} is crossed", tie="same_unit",
        lasts=True,
    ),
    Effect(
        "gain", "command", (Constant("gain", "-", lambda c, site, scales: 1 + c, -0.95, 2.0),), channel_sites,
        _fixed(-0.15), _gain, "commands are followed by a factor of {gain}", tie="any",
    ),
    Effect(
        "asymmetric_gain", "command", _RATIO, channel_sites, _fixed(0.15), _asymmetric_gain(-1),
        "negative commands are followed by only {ratio} of what positive ones are", tie="any", form="negative",
    ),
    Effect(
        "asymmetric_gain", "command", _RATIO, channel_sites, _fixed(0.15), _asymmetric_gain(1),
        "positive commands are followed by only {ratio} of what negative ones are", tie="any", form="positive",
    ),
    Effect(
        "gain_drift", "command", (Constant("change", "1/min", low=-1.0, high=1.0),), channel_sites, _fixed(-0.1),
        _gain_drift, "the response to commands drifts by {change} of itself over a session", tie="any",
    ),
    Effect(
        "cross_axis_coupling", "command", (Constant("ratio", "-", low=-1.5, high=1.5),), _pair_sites, _fixed(0.1),
        _cross_axis, "one axis leaks into another by a ratio of {ratio}",
    ),
    Effect(
        "frame_misalignment", "command", (Constant("angle", "rad", low=-1.6, high=1.6),), _planar_sites, _fixed(0.1),
        _misalignment, "the command frame is turned by {angle} against the assumed one", tie="any",
    ),
    Effect(
        "saturation", "command", (Constant("limit", "{u}", _reciprocal, 0.0, reciprocal=True),), channel_sites,
        _reciprocals(lambda scales: scales.command, 2.2, 1.7, 1.3, 0.95, 0.8, 0.6, 0.35), _saturation,
        "saturation: commands beyond {limit} have no further effect", tie="same_unit",
    ),
    Effect(
        "rate_limit", "filter",
        (Constant("limit", "{u}/s", lambda c, _, s: _reciprocal(c * s.time_step), 0.0, reciprocal=True),),
        channel_sites,
        _reciprocals(lambda scales: scales.command_step, 16, 10, 6, 3.5, 2.0, 1.2, 0.7, 0.4, 0.2),
        _rate_limit, "commands are followed no faster than {limit}", tie="same_unit",
    ),
    Effect(
        "lag", "filter",
        (Constant("time constant", "s", lambda c, site, scales: c * scales.time_step, 0.0, 30.0),),
        channel_sites, _fixed(0.6, 1.5, 4.5, 13.0), _lag,
        "lag: a further first-order response with time constant {time constant} lies between command and motion",
        tie="any",
    ),
)  # fmt: skip
