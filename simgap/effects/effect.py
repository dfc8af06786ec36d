"""What an effect of the catalogue is: a law that a simulator may lack, without effect where its constants are zero.

A law acts at one of seven places of a simulated step (see `step.advance`). An augmented simulator applies all laws of
the catalogue at all their sites, each with its constants; with all constants zero it is the bare simulator. Internal
constants are chosen so that this holds: a limit, for example, is stored as its reciprocal.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.engines import Table
from simgap.kinematics import Motion, on_body
from simgap.layout import Layout

Place = Literal["command", "filter", "before", "engine", "push", "after", "sensing"]
Bend = Literal["past", "command", "speed", "place"]
"""How a law's true form may differ from its form in the catalogue: in its memory, or in how it depends on the command,
the speed or the position where it acts."""
_BENDS: dict[str, tuple[Bend, ...]] = {
    "command": ("command",),
    "filter": ("past",),
    "before": ("past",), "after": ("past",), "sensing": ("past", "place"),
    "push": ("speed",),
    "engine": ("past", "speed", "place"),
}  # fmt: skip
HISTORY_ROWS = 8
"""Past commands that an augmented simulator remembers: the longest dead time, in rows."""
SENSED_ROWS = 4
"""Past states that it remembers: the longest delay of a measured output, in rows."""


class Memory(NamedTuple):
    """What an augmented simulator remembers apart from the state.

    commands[k]: sent k + 1 rows ago. filters: the memory of every law of place "filter", by key. states[k]: the state
    k + 1 rows ago. fading: how fast the early part of a row is forgotten, per command (`command_filters.fading_of`).
    """

    commands: Float[Array, "h u"]
    filters: dict[str, Float[Array, " u"]]
    states: Float[Array, "r s"]
    fading: Float[Array, " u"]


class Row(NamedTuple):
    """A row apart from its state and command: session time [s], interval divided by the nominal one [-], and an
    engine's table for this row, if there is one."""

    time_s: Float[Array, ""]
    interval: Float[Array, ""]
    table: Table | None = None


class Scales(NamedTuple):
    """Magnitudes of the recordings: for starting values, and for what the laws refer to.

    command, command_step: 95th percentile of |u| and of |u_t - u_{t-1}| where it moves, per channel. speed: the same
    of the bodies' own velocities [b, 4]. axis_speed, axis_command: the same of the velocity and of the command (or
    velocity) at each axis site; for a command that is always zero, the command that would change the velocity as much
    as it changes. reach: quantiles 0, 5, .. 100 % of the horizontal distance from the carrier, of the bodies
    `reaching` [n, 21]. height: the same of z, of the bodies `floored` [n, 21]. interval: time [s] over which each
    position integrates its velocity. output: 95th percentile of |output - median|. duration: of the longest session
    [s]. time_step [s]. Only speed, reach, height and interval can be zero.
    """

    command: np.ndarray
    command_step: np.ndarray
    speed: np.ndarray
    axis_speed: np.ndarray
    axis_command: np.ndarray
    reach: np.ndarray
    height: np.ndarray
    interval: np.ndarray
    output: np.ndarray
    duration: float
    time_step: float


class Site(NamedTuple):
    """Where an effect can act: its name, the commands and outputs concerned, its family and its unit. Sites of one
    family may share constants; so may those of one branch within a family."""

    name: str
    channels: tuple[str, ...]
    outputs: tuple[str, ...]
    family: str
    unit: str
    branch: str = ""


@dataclass(frozen=True)
class Constant:
    """One constant: name, unit (`{u}`: the unit of the site), and its physical value from the internal one.

    `physical(c, index of the site, scales)`. `low`, `high`: bounds of the internal value. `shapes`: it shapes how the
    other constants act (such as an onset) and does nothing by itself. reciprocal: the internal value is one over a
    limit; the smaller it is, the wider the limit. credible(index of the site, scales): size of the internal value
    beyond which the estimate is not physically plausible.
    """

    name: str
    unit: str
    physical: Callable[[Any, int, Scales], Any] = lambda c, site, scales: c
    low: float = -np.inf
    high: float = np.inf
    shapes: bool = False
    reciprocal: bool = False
    credible: Callable[[int, Scales], float] = lambda site, scales: np.inf


@dataclass(frozen=True)
class Effect:
    """A law of the catalogue.

    id: name of the effect. form: which of several laws of one id. sites(layout): where it can act. starts(scales,
    site): internal constants [k] to start a search from. law: see the module of its place. says: a sentence for
    people, with the names of the constants in braces. tie: whether the sites of a family may share constants ("never";
    "same_unit": sites of one unit; "any"). lasts: a filter's memory outlasts any rest; it depends on where commands
    turned, not on how long ago. jagged: the likelihood has many local maxima along the constant. basins: it has a few;
    the simulator's parameters lead to one with too small a constant, so fits start from all of `starts`. event: it
    acts in a window of one session. coarse: it concerns steps as long as a row, which an engine divides into many.
    bends: see `Bend`; by default those of its place.
    """

    id: str
    place: Place
    constants: tuple[Constant, ...]
    sites: Callable[[Layout], tuple[Site, ...]]
    starts: Callable[[Scales, int], list[list[float]]]
    law: Callable[..., Any]
    says: str
    form: str = ""
    lasts: bool = False
    jagged: bool = False
    basins: bool = False
    event: bool = False
    coarse: bool = False
    tie: Literal["never", "same_unit", "any"] = "never"
    bends: tuple[Bend, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "bends", self.bends or _BENDS[self.place])

    @property
    def key(self) -> str:
        """The id, and the form where it has one."""
        return f"{self.id}.{self.form}" if self.form else self.id


class Step(NamedTuple):
    """What the law of a push can use: the motion now, the motion that the simulator expects, command and layout.

    response(): change of the expected own velocity per unit of push, by body and axis. own(): the expected motion of
    bodies that remember only their own velocity, not what carriers add. Each call computes one more simulator step.
    """

    now: Motion
    then: Motion
    response: Callable[[], Float[Array, "b 4"]]
    own: Callable[[], Motion]
    command: Float[Array, " u"]
    layout: Layout
    scales: Scales
    row: Row


def channel_sites(layout: Layout) -> tuple[Site, ...]:
    """Every command channel."""
    sites = []
    for i, f in enumerate(layout.schema.command):
        where = np.argwhere(layout.driven == i)
        outputs: tuple[str, ...] = ()
        if len(where):
            body, axis = map(int, where[0])
            shown = layout.outputs if layout.in_world("command", body) else layout.shown_in
            outputs = shown(body, (axis,))
        sites.append(Site(f.name, (f.name,), outputs, f.body or f.name, f.unit))
    return tuple(sites)


def axis_sites(layout: Layout) -> tuple[Site, ...]:
    """Every (body, axis) that can be pushed, in the order of `axis_indices`."""
    sites = []
    for b, a in axis_indices(layout):
        column = layout.driven[b, a]
        channels = (layout.schema.command[column].name,) if column >= 0 else ()
        (name,) = layout.outputs(b, (a,))
        unit = layout.schema.state[layout.velocity[b, a]].effort or _unit_of_push(layout, b, a)
        sites.append(Site(name, channels, layout.shown_in(b, (a,)), layout.bodies[b], unit))
    return tuple(sites)


def _unit_of_push(layout: Layout, b: int, a: int) -> str:
    """Unit of the command in which a push enters; of the velocity, where there is none."""
    column = layout.command[b, a]
    return layout.schema.command[column].unit if column >= 0 else "rad/s" if a == 3 else "m/s"


def axis_indices(layout: Layout) -> list[tuple[int, int]]:
    """The (body, axis) pairs that can be pushed and whose velocity is known."""
    return [(b, a) for b in range(len(layout.bodies)) for a in range(4) if layout.velocity[b, a] >= 0]


def body_sites(layout: Layout, bodies: list[int], axes: tuple[int, ...]) -> tuple[Site, ...]:
    """One site per body, acting along `axes`."""
    return tuple(_body_site(layout, b, axes) for b in bodies)


def _body_site(layout: Layout, b: int, axes: tuple[int, ...]) -> Site:
    channels = tuple(layout.schema.command[int(c)].name for c in layout.command[b, list(axes)] if c >= 0)
    return Site(layout.bodies[b], channels, layout.shown_in(b, axes), layout.bodies[b], "m/s")


def mounted(layout: Layout) -> list[int]:
    """Bodies on a carrier."""
    return [b for b, c in enumerate(layout.carrier) if c is not None]


def turning(layout: Layout) -> list[int]:
    """Bodies with a yaw rate and velocities along x and y, not mounted."""
    return [b for b, c in enumerate(layout.carrier) if c is None and all(layout.velocity[b, [0, 1, 3]] >= 0)]


def reaching(layout: Layout) -> list[int]:
    """Bodies on a carrier that commands drive along x and y."""
    return [b for b in mounted(layout) if all(layout.command[b, [0, 1]] >= 0)]


def floored(layout: Layout) -> list[int]:
    """Bodies whose height is measured."""
    return [b for b in range(len(layout.bodies)) if layout.position[b, 2] >= 0]


def usual_push(layout: Layout, scales: Scales) -> Float[Array, "b 1"]:
    """Usual size of a push on each body: its largest usual command."""
    bodies = np.array([b for b, _ in axis_indices(layout)], int)
    size = jnp.zeros(len(layout.bodies)).at[bodies].max(jnp.asarray(scales.axis_command))
    return jnp.where(size > 0, size, 1.0)[:, None]


def on_axes(layout: Layout, values: Float[Array, " n"]) -> Float[Array, "b 4"]:
    """Values per axis site as a table of bodies x axes."""
    places = zip(values, axis_indices(layout), strict=True)
    return sum((on_body(layout, b, a, value) for value, (b, a) in places), jnp.zeros((len(layout.bodies), 4)))
