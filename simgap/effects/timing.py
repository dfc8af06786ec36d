"""How a step advances: which velocity positions integrate, over which interval, and which velocity is remembered.

Place "before": `law(c[k, sites], state, layout, scales) -> state` before the simulator's step; place "after":
`law(c[k, sites], state, then, layout, scales, row) -> then`.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.effects.effect import Constant, Effect, Row, Scales, Site
from simgap.effects.sites import body_sites, mounted
from simgap.kinematics import carried_velocity, placed, turned, wrapped
from simgap.layout import YAW, Layout, X, Y

_S = Float[Array, " s"]
MISTIMED = 0.3
"""Share of the nominal time step by which the true one may differ: time stamps are no further off. A robot that moves
even more or less per row does so for another reason, for which the simulator may have parameters."""


def _integrated(layout: Layout) -> list[int]:
    return [i for i, v in enumerate(layout.integrates) if v >= 0]


def _integrated_sites(layout: Layout) -> tuple[Site, ...]:
    fields = layout.schema.state
    return tuple(Site(fields[i].name, (), (fields[i].name,), "positions", fields[i].unit) for i in _integrated(layout))


def _integration_rule(c: Float[Array, "1 n"], state: _S, then: _S, layout: Layout, scales: Scales, row: Row) -> _S:
    """p' + c h (v - v'): positions advance by the old velocity to a share c."""
    for k, i in enumerate(_integrated(layout)):
        v = int(layout.integrates[i])
        then = then + placed(len(then), i, c[0, k] * scales.interval[i] * (state[v] - then[v]))
    return then


def _whole_site(layout: Layout) -> tuple[Site, ...]:
    return (Site("all", (), tuple(f.name for f in layout.schema.state), "all", "s"),)


def _position_site(layout: Layout) -> tuple[Site, ...]:
    names = tuple(f.name for f in layout.schema.state if f.kind in ("position", "angle"))
    return (Site("positions", (), names, "all", "-"),)


def _interval(c: Float[Array, "1 1"], state: _S, then: _S, layout: Layout, scales: Scales, row: Row) -> _S:
    """s + (1 + c) (s' - s)."""
    return then + c[0, 0] * wrapped(layout, then - state)


def _stamped(c: Float[Array, "1 1"], state: _S, then: _S, layout: Layout, scales: Scales, row: Row) -> _S:
    """Positions advance by the row's own interval to a share c."""
    is_position = jnp.array([f.kind in ("position", "angle") for f in layout.schema.state])
    return then + jnp.where(is_position, c[0, 0] * (row.interval - 1) * wrapped(layout, then - state), 0.0)


def _own_motion(c: Float[Array, "1 n"], state: _S, layout: Layout, scales: Scales) -> _S:
    """v - c V: the mounted body remembers its own motion only, not the velocity V that its carrier adds."""
    carried = carried_velocity(layout, state, state)
    for k, b in enumerate(mounted(layout)):
        for axis in (X, Y):
            i = int(layout.velocity[b, axis])
            state = state - placed(len(state), i, c[0, k] * carried[i])
    return state


def _rotating(layout: Layout) -> list[int]:
    """Bodies whose horizontal velocity is in the world frame and whose own frame turns."""
    return [
        b for b in range(len(layout.bodies))
        if layout.heading[b] is not None and all(layout.velocity[b, [X, Y]] >= 0)
        and layout.schema.state[layout.velocity[b, X]].frame == "world"
        and max(_yaw_rate(layout, b), 0) == _yaw_rate(layout, b)
    ]  # fmt: skip


def _yaw_rate(layout: Layout, b: int) -> int:
    carrier = layout.carrier[b]
    return int(layout.velocity[b if carrier is None else carrier, YAW])


def _body_frame(c: Float[Array, "1 n"], state: _S, layout: Layout, scales: Scales) -> _S:
    """R(c h w) v: the remembered velocity turns with the body."""
    angle = jnp.zeros(len(layout.bodies))
    for k, b in enumerate(_rotating(layout)):
        heading = layout.heading[b]
        assert heading is not None  # by _rotating
        angle = angle + placed(len(angle), b, c[0, k] * scales.interval[heading] * state[_yaw_rate(layout, b)])
    return turned(layout, state, angle)


EFFECTS = (
    Effect(
        "relative_smoothing", "before", (Constant("share", "-", low=-0.5, high=1.5),),
        lambda layout: body_sites(layout, mounted(layout), (X, Y)), lambda scales, site: [[0.5]], _own_motion,
        "the velocity memory acts on the arm's own motion, to a share of {share}, not on what its carrier adds",
        form="own_motion",
    ),
    Effect(
        "relative_smoothing", "before", (Constant("share", "-", low=-0.5, high=1.5),),
        lambda layout: body_sites(layout, _rotating(layout), (X, Y)), lambda scales, site: [[0.5]], _body_frame,
        "the velocity memory turns with the body, to a share of {share}", form="body_frame", tie="any",
    ),
    Effect(
        "integration_rule", "after", (Constant("weight", "-", low=-1.5, high=1.5),), _integrated_sites,
        lambda scales, site: [[0.3]], _integration_rule,
        "positions advance by the old velocity to a share of {weight}", tie="any", coarse=True,
    ),
    Effect(
        "sampling_interval", "after",
        (Constant("interval", "s", lambda c, site, scales: scales.time_step * (1 + c), -MISTIMED, MISTIMED),),
        _whole_site,
        lambda scales, site: [[0.1]], _interval, "the true time step is {interval}", form="constant",
        slight=True,
    ),
    Effect(
        "sampling_interval", "after", (Constant("share", "-", low=0.0, high=1.5),), _position_site,
        lambda scales, site: [[1.0]], _stamped,
        "rows are unevenly spaced: positions advance by each row's own interval (to a share of {share})",
        form="stamped", slight=True,
    ),
)  # fmt: skip
