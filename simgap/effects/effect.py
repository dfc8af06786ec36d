"""What an effect of the catalogue is: a law that a simulator may lack, without effect where its constants are zero.

A law acts at one of nine places of a simulated step (see `step.advance`). An augmented simulator applies all laws of
the catalogue at all their sites, each with its constants; with all constants zero it is the bare simulator. Internal
constants are chosen so that this holds: a limit, for example, is stored as its reciprocal.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from simgap.engines import Table
from simgap.kinematics import Motion
from simgap.layout import Layout

Place = Literal["command", "filter", "before", "engine", "push", "friction", "hysteresis", "after", "sensing"]
Bend = Literal["past", "command", "speed", "place"]
"""How a law's true form may differ from its form in the catalogue: in its memory, or in how it depends on the command,
the speed or the position where it acts."""
_BENDS: dict[str, tuple[Bend, ...]] = {
    "command": ("command",),
    "filter": ("past",),
    "before": ("past",), "after": ("past",), "sensing": ("past", "place"),
    "push": ("speed",), "friction": ("speed",), "hysteresis": ("speed",),
    "engine": ("past", "speed", "place"),
}  # fmt: skip
HISTORY_ROWS = 8
"""Past commands that an augmented simulator remembers: the longest dead time, in rows."""
SENSED_ROWS = 4
"""Past states that it remembers: the longest delay of a measured output, in rows."""


class Memory(NamedTuple):
    """What an augmented simulator remembers apart from the state.

    commands[k]: sent k + 1 rows ago. filters, bent: the memory of every law of place "filter" or "hysteresis", by key.
    states[k]: the state k + 1 rows ago. fading: how fast the early part of a row is forgotten, per command
    (`command_filters.fading_of`).
    """

    commands: Float[Array, "h u"]
    filters: dict[str, Float[Array, "... u"]]
    bent: dict[str, Float[Array, "b 4"]]
    states: Float[Array, "r s"]
    fading: Float[Array, " u"]


class Earlier(NamedTuple):
    """What is known of the rows before a start: commands[k] was sent k + 1 rows ago. turns: values at which each
    command turned before these, the latest first; None: it never turned. states: where each state was a row ago and
    turned before that, the latest first; None: it stood still."""

    commands: Float[Array, "n u"]
    turns: Float[Array, "m u"] | None = None
    states: Float[Array, "w s"] | None = None


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
    [s]. time_step [s]. travel, pace, hold [n]: 95th percentile of |position|, axis_speed and axis_command of the bodies
    that keep their place (`restoring.staying`); grain [n]: noise of their positions, or their step. furthest [n]:
    greatest size of the states that may stop (`stops.limited`). measured: number of the measured ones of these.
    both_ways: whether commands of a channel have both signs, per channel. Only speed, reach, height, interval, grain,
    measured and both_ways can be zero.
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
    travel: np.ndarray = np.zeros(0)
    pace: np.ndarray = np.zeros(0)
    hold: np.ndarray = np.zeros(0)
    grain: np.ndarray = np.zeros(0)
    furthest: np.ndarray = np.zeros(0)
    measured: float = 0.0
    both_ways: np.ndarray = np.zeros(0)


class Site(NamedTuple):
    """Where an effect can act: its name, the commands and outputs concerned, its family and its unit. Sites of one
    family may share constants; so may those of one branch within a family. length: unit of the position there."""

    name: str
    channels: tuple[str, ...]
    outputs: tuple[str, ...]
    family: str
    unit: str
    branch: str = ""
    length: str = ""


@dataclass(frozen=True)
class Constant:
    """One constant: name, unit (`{u}`, `{x}`: the site's unit and length), physical value from the internal one.

    `physical(c, index of the site, scales)`. `low`, `high`: bounds of the internal value. `shapes`: it shapes how the
    other constants act (such as an onset) and does nothing by itself. reciprocal: the internal value is one over a
    limit; the smaller it is, the wider the limit. credible(index of the site, scales): size of the internal value
    beyond which the estimate is not physically plausible. least(index of the site, scales): size of a shape below which
    another law is meant.
    """

    name: str
    unit: str
    physical: Callable[[Any, int, Scales], Any] = lambda c, site, scales: c
    low: float = -np.inf
    high: float = np.inf
    shapes: bool = False
    reciprocal: bool = False
    credible: Callable[[int, Scales], float] = lambda site, scales: np.inf
    least: Callable[[int, Scales], float] = lambda site, scales: 0.0


def reciprocal(c: float, *_: object) -> float:
    """The limit whose reciprocal is c; infinite where there is none."""
    return 1 / c if c else np.inf


@dataclass(frozen=True)
class Effect:
    """A law of the catalogue.

    id: name of the effect. form: which of several laws of one id. sites(layout): where it can act. starts(scales,
    site): internal constants [k] to start a search from; none where such recordings cannot show it. law: see the module
    of its place. says: a sentence for people, with the names of the constants in braces. tie: whether the sites of a
    family may share constants ("never"; "same_unit": sites of one unit; "any"). rest(u): a filter's memory once the
    command u has lasted. lasts: a filter's memory outlasts any rest; it depends on where commands turned, not on how
    long ago. jagged: the likelihood has many local maxima along the constant. basins: it has a few; the simulator's
    parameters lead to one with too small a constant, so fits start from all of `starts`. event: it acts in a window of
    one session. slope(c, state): of what a sensor shows, by the state, where it is not one. folds: two states give one
    measurement, so that a start does not follow from what is measured there. slight: it takes less to compute than XLA
    takes to decide whether to; it is computed even where it does not act. coarse: it concerns steps as long as a row,
    which an engine divides into many. extends: id of a simpler law that it is as well, or nearly, with some of its
    constants. bends: see `Bend`; by default those of its place.
    """

    id: str
    place: Place
    constants: tuple[Constant, ...]
    sites: Callable[[Layout], tuple[Site, ...]]
    starts: Callable[[Scales, int], list[list[float]]]
    law: Callable[..., Any]
    says: str
    form: str = ""
    rest: Callable[[Array], Array] = lambda u: u
    lasts: bool = False
    jagged: bool = False
    basins: bool = False
    event: bool = False
    slope: Callable[[Any, Array], Array] | None = None
    folds: bool = False
    slight: bool = False
    coarse: bool = False
    tie: Literal["never", "same_unit", "any"] = "never"
    extends: str = ""
    bends: tuple[Bend, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "bends", self.bends or _BENDS[self.place])

    @property
    def key(self) -> str:
        """The id, and the form where it has one."""
        return f"{self.id}.{self.form}" if self.form else self.id


class Step(NamedTuple):
    """What the law of a push can use: the motion now, the motion that the simulator expects, the states of both, the
    command and the layout."""

    now: Motion
    then: Motion
    states: tuple[Float[Array, " s"], Float[Array, " s"]]
    command: Float[Array, " u"]
    layout: Layout
    scales: Scales
    row: Row
