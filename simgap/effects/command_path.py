"""Effects between the command that is sent and the command that acts.

A law of place "command" is `law(c[k, sites], u, memory, row, layout) -> u`; those of place "filter" are in
`command_filters`.

A simulator holds a command for a whole row; on a robot the command may change within the row. What acts here is
therefore the equivalent constant command: the one that leads to the same velocity at the end of the row. A joint that
follows its command as a first-order system forgets more of what came early in the row. With v = a v + (1 - a) u over a
row, the command at the time s of the row, 0 to 1, has the weight exp(fading s), fading = -ln a. Where nothing is
forgotten, as with a force, the equivalent command is the mean.

An engine takes commands in parts of a row: u is then [parts, u], and the mean over each part acts.
"""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.effects.command_filters import UNDAMPED, backlash, lag, rate_limit, resonance, resting
from simgap.effects.effect import HISTORY_ROWS, Constant, Effect, Memory, Row, Scales, Site, reciprocal
from simgap.effects.sites import channel_sites
from simgap.layout import Layout, X, Y

_U = Float[Array, " u"]
OVERSHOOTS = 0.4
"""Greatest damping ratio of a response that overshoots clearly, by a quarter; others may be delays that vary."""


def _delay(c: Float[Array, "1 u"], u: _U, memory: Memory, row: Row, layout: Layout) -> _U:
    """u(t - d), d = c rows. Early in a row the older of two commands still acts."""
    if u.ndim == 2:
        return _delay_in_parts(c, u, memory)
    whole = jnp.floor(c[0])
    share = jnp.expm1(memory.fading * (c[0] - whole)) / jnp.expm1(memory.fading)
    for k, (newer, older) in enumerate(zip([u, *memory.commands[:-1]], memory.commands, strict=True)):
        u = u + jnp.where(k < whole, 1.0, jnp.where(k == whole, share, 0.0)) * (older - newer)
    return u


def _delay_in_parts(c: Float[Array, "1 u"], u: Float[Array, "parts u"], memory: Memory) -> Float[Array, "parts u"]:
    """u(t - d) in every part of the row.

    The delayed command may change within a part. Its mean over the part acts, which leads to the right velocity. The
    mean leads to too great a position, by the first moment of the command about the middle of the part. So the moment
    is subtracted in this part and added in the next.
    """
    parts, ago = len(u), np.arange(1, HISTORY_ROWS + 1)[:, None, None]
    # Starts with the last part of the previous row, whose moment is added in the first part of this row.
    begins = np.arange(-1, parts)[:, None] / parts - c[0]
    ends, middle = begins + 1 / parts, begins + 0.5 / parts
    # Share of each part in which each command acts. The oldest known one acted at all earlier times.
    first = jnp.maximum(begins, np.where(ago < HISTORY_ROWS, -ago, -np.inf))
    last = jnp.maximum(jnp.minimum(ends, 1 - ago), first)
    share, older = parts * (last - first), (memory.commands - u[0])[:, None]
    mean = u[0] + (share * older).sum(0)
    moment = (parts * share * ((first + last) / 2 - middle) * older).sum(0)
    return (mean - moment)[1:] + moment[:-1]


def _quantization(c: Float[Array, "1 u"], u: _U, memory: Memory, row: Row, layout: Layout) -> _U:
    """u rounded to multiples of the step c."""
    step = jnp.where(c[0] > 0, c[0], 1.0)
    return jnp.where(c[0] > 0, jnp.round(u / step) * step, u)


def _deadband(c: Float[Array, "1 u"], u: _U, memory: Memory, row: Row, layout: Layout) -> _U:
    """Zero below the width c; beyond it, u reduced by c."""
    return u - jnp.clip(u, -c[0], c[0])


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
    """u clipped to +-1/c."""
    return u / jnp.maximum(1.0, jnp.abs(u) * c[0])


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
        leak = leak + jnp.where(np.arange(u.shape[-1]) == j, (c[0, k] * u[..., i])[..., None], 0.0)
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
        along, across = u[..., ix], u[..., iy]
        x, y = (cos * along - sin * across)[..., None], (sin * along + cos * across)[..., None]
        u = jnp.where(np.arange(u.shape[-1]) == ix, x, jnp.where(np.arange(u.shape[-1]) == iy, y, u))
    return u


def _fractions(*fractions: float):
    """Starting values as fractions of the channel's usual command."""
    return lambda scales, site: [[f * float(scales.command[site])] for f in fractions]


def _reciprocals(usual: Callable[[Scales], np.ndarray], *fractions: float):
    """Starting values: reciprocals of fractions of the channel's usual value.

    Fractions above 1 are included: such a limit affects few rows, but strongly.
    """
    return lambda scales, site: [[1 / (f * float(usual(scales)[site]))] for f in fractions]


def _of_both_signs(value: float):
    """A start only where commands have both signs. Where they have one, a law that depends on the sign is a gain."""
    return lambda scales, site: [[value]] if scales.both_ways[site] else []


def _fixed(*values: float):
    return lambda scales, site: [[v] for v in values]


_RATIO = (Constant("ratio", "-", lambda c, site, scales: 1 - c, -2.0, 0.95),)

EFFECTS = (
    Effect(
        "delay", "command",
        (Constant("delay", "s", lambda c, site, scales: c * scales.time_step, 0.0, float(HISTORY_ROWS)),),
        channel_sites, _fixed(0.5, 1.0, 2.0, 3.5, 5.0, 7.0), _delay,
        "dead time: commands act {delay} after they are sent", tie="any", basins=True, bends=("past",),
    ),
    Effect(
        "quantization", "command", (Constant("step", "{u}", low=0.0),), channel_sites,
        _fractions(*np.geomspace(0.06, 0.9, 24)), _quantization,
        "commands are followed in steps of {step}", tie="same_unit", jagged=True, slight=True,
    ),
    Effect(
        "deadband", "command", (Constant("width", "{u}", low=0.0),), channel_sites, _fractions(0.05, 0.15, 0.35),
        _deadband, "dead band: commands below {width} do nothing", tie="same_unit", slight=True,
    ),
    Effect(
        "backlash", "filter", (Constant("gap", "{u}", low=0.0),), channel_sites, _fractions(0.1, 0.3, 0.7),
        backlash, "play: after a reversal the motion waits until a gap of {gap} is crossed", tie="same_unit",
        lasts=True,
    ),
    Effect(
        "gain", "command", (Constant("gain", "-", lambda c, site, scales: 1 + c, -0.95, 2.0),), channel_sites,
        _fixed(-0.15), _gain, "commands are followed by a factor of {gain}", tie="any", slight=True,
    ),
    Effect(
        "asymmetric_gain", "command", _RATIO, channel_sites, _of_both_signs(0.15), _asymmetric_gain(-1),
        "negative commands are followed by only {ratio} of what positive ones are", tie="any", form="negative",
        slight=True,
    ),
    Effect(
        "asymmetric_gain", "command", _RATIO, channel_sites, _of_both_signs(0.15), _asymmetric_gain(1),
        "positive commands are followed by only {ratio} of what negative ones are", tie="any", form="positive",
        slight=True,
    ),
    Effect(
        "gain_drift", "command", (Constant("change", "1/min", low=-1.0, high=1.0),), channel_sites, _fixed(-0.1),
        _gain_drift, "the response to commands drifts by {change} of itself over a session", tie="any", slight=True,
    ),
    Effect(
        "cross_axis_coupling", "command", (Constant("ratio", "-", low=-1.5, high=1.5),), _pair_sites, _fixed(0.1),
        _cross_axis, "one axis leaks into another by a ratio of {ratio}", slight=True,
    ),
    Effect(
        "frame_misalignment", "command", (Constant("angle", "rad", low=-1.6, high=1.6),), _planar_sites, _fixed(0.1),
        _misalignment, "the command frame is turned by {angle} against the assumed one", tie="any",
    ),
    Effect(
        "saturation", "command", (Constant("limit", "{u}", reciprocal, 0.0, reciprocal=True),), channel_sites,
        _reciprocals(lambda scales: scales.command, 2.2, 1.7, 1.3, 0.95, 0.8, 0.6, 0.35), _saturation,
        "saturation: commands beyond {limit} have no further effect", tie="same_unit", slight=True,
    ),
    Effect(
        "rate_limit", "filter",
        (Constant("limit", "{u}/s", lambda c, _, s: reciprocal(c * s.time_step), 0.0, reciprocal=True),),
        channel_sites,
        _reciprocals(lambda scales: scales.command_step, 16, 10, 6, 3.5, 2.0, 1.2, 0.7, 0.4, 0.2),
        rate_limit, "commands are followed no faster than {limit}", tie="same_unit",
    ),
    Effect(
        "lag", "filter",
        (Constant("time constant", "s", lambda c, site, scales: c * scales.time_step, 0.0, 30.0),),
        channel_sites, _fixed(0.6, 1.5, 4.5, 13.0), lag,
        "lag: a further first-order response with time constant {time constant} lies between command and motion",
        tie="any",
    ),
    Effect(
        "resonance", "filter",
        (Constant("period", "s", lambda c, site, scales: 2 * np.pi * c * scales.time_step, 0.0, 30.0),
         Constant("damping", "-", low=0.0, high=UNDAMPED, shapes=True, credible=lambda site, scales: OVERSHOOTS)),
        channel_sites, lambda scales, site: [[rows, 0.3] for rows in (0.6, 1.2, 2.5, 5.0, 10.0)], resonance,
        "resonance: commands are followed with an overshoot, by a swing of {period} with a damping ratio of {damping}",
        tie="any", basins=True, rest=resting, extends="delay",
    ),
)  # fmt: skip
