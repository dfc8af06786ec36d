"""What a machine may have that its user's simulator lacks, in amounts drawn at random, and the words that are right."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from concealed.form import Array
from concealed.kinds.robots import Kind
from concealed.kinds.session import FINE, Pushes, Traits

CLIPPED = (0.8, 0.95)
"""Share of the rows in which a limited command stays within its limit."""
STIFF, FADES = 0.01, 0.2
"""Speeds [m/s or rad/s] at which dry friction has most of its force, and at which the higher one near rest fades."""


class Drawn(NamedTuple):
    """What became of a cause: the machine's traits, commands that it acts on (none named: all, or no command), and its
    constant as name, value and unit."""

    traits: Traits
    channels: tuple[str, ...] = ()
    constant: tuple[str, float, str] | None = None


Draw = Callable[[Kind, Array, np.random.Generator], Drawn]
"""For a kind of machine and the commands that it is sent without the cause [S, T, u]."""


class Cause(NamedTuple):
    """A cause; the machine that has it, the words that are right for it (none: there are none), and why."""

    kind: str
    draw: Draw
    accept: tuple[str, ...]
    why: str


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """A size between two, evenly in its logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _late(of: Kind, sent: Array, rng: np.random.Generator) -> Drawn:
    late = of.interval / FINE * round(FINE * _between(rng, 0.6, 3))
    return Drawn(Traits(late=late), (), ("delay", late, "s"))


def _slow(of: Kind, sent: Array, rng: np.random.Generator) -> Drawn:
    lag = of.interval * _between(rng, 0.8, 4)
    return Drawn(Traits(lag=lag), (), ("time constant", lag, "s"))


def _one_of(of: Kind, rng: np.random.Generator) -> tuple[int, Array, tuple[str]]:
    """A command: its number, a one in its place, and its name."""
    j = int(rng.integers(len(of.columns.command)))
    return j, np.eye(len(of.columns.command))[j], (of.columns.command[j],)


def _limited(of: Kind, sent: Array, rng: np.random.Generator) -> Drawn:
    j, place, name = _one_of(of, rng)
    limit = float(np.quantile(np.abs(sent[..., j]), rng.uniform(*CLIPPED)))
    return Drawn(Traits(limit=np.where(place > 0, limit, np.inf)), name, ("limit", limit, ""))


def _dead(of: Kind, sent: Array, rng: np.random.Generator) -> Drawn:
    j, place, name = _one_of(of, rng)
    band = _between(rng, 0.03, 0.15) * float(np.quantile(np.abs(sent[..., j]), 0.9))
    return Drawn(Traits(band=place * band), name, ("band", band, ""))


def _along(of: Kind, axis: int, force: Callable[[Array, Array], Array]) -> Pushes:
    """A force [B] along one velocity, of states and what the motors get."""
    return lambda x, u: force(x, u)[:, None] * np.eye(of.rates)[axis]


def _dry(axis: int, low: float, high: float, unit: str) -> Draw:
    """Friction that is up to a quarter higher near rest."""

    def draw(of: Kind, sent: Array, rng: np.random.Generator) -> Drawn:
        loss, bump = _between(rng, low, high), rng.uniform(0, 0.25)

        def force(x: Array, u: Array) -> Array:
            v = x[:, axis - of.rates]
            return -loss * np.tanh(v / STIFF) * (1 + bump * np.exp(-np.abs(v) / FADES))

        return Drawn(Traits(push=_along(of, axis, force)), (of.columns.command[axis],), ("loss", loss, unit))

    return draw


def _squared(low: float, high: float, constant: str = "") -> Draw:
    """A force along the first velocity, against its square. constant: its unit, where it is the law's own."""

    def draw(of: Kind, sent: Array, rng: np.random.Generator) -> Drawn:
        size = _between(rng, low, high)
        push = _along(of, 0, lambda x, u: -size * x[:, -of.rates] * np.abs(x[:, -of.rates]))
        return Drawn(Traits(push=push), (), ("coefficient", size, constant) if constant else None)

    return draw


def _oiled(of: Kind, sent: Array, rng: np.random.Generator) -> Drawn:
    size = _between(rng, 0.002, 0.02)
    return Drawn(Traits(push=_along(of, 1, lambda x, u: -size * x[:, 3])))


def _windy(of: Kind, sent: Array, rng: np.random.Generator) -> Drawn:
    size = _between(rng, 0.08, 0.8) * rng.choice([-1, 1])
    return Drawn(Traits(push=_along(of, 0, lambda x, u: np.full(len(x), size))))


def _sprung(of: Kind, sent: Array, rng: np.random.Generator) -> Drawn:
    stiffness = _between(rng, 0.4, 4)
    return Drawn(Traits(push=_along(of, 0, lambda x, u: -stiffness * x[:, 0])), (), ("stiffness", stiffness, "N/m"))


def _uneven(of: Kind, sent: Array, rng: np.random.Generator) -> Drawn:
    """One wheel is larger than the other: what drives ahead turns as well."""
    ratio = _between(rng, 0.02, 0.15) * rng.choice([-1, 1])
    return Drawn(Traits(leak=np.array([[0, 0], [ratio, 0]])), (), ("ratio", ratio, "-"))


def _scaled(output: int) -> Draw:
    def draw(of: Kind, sent: Array, rng: np.random.Generator) -> Drawn:
        scale = np.ones(len(of.columns.state))
        scale[output] += _between(rng, 0.02, 0.1) * rng.choice([-1, 1])
        return Drawn(Traits(sees=lambda x: scale * x), (), ("scale", float(scale[output]), "-"))

    return draw


def _offset(output: int, low: float, high: float, unit: str) -> Draw:
    def draw(of: Kind, sent: Array, rng: np.random.Generator) -> Drawn:
        bias = np.zeros(len(of.columns.state))
        bias[output] = _between(rng, low, high) * rng.choice([-1, 1])
        return Drawn(Traits(sees=lambda x: x + bias), (), ("bias", float(bias[output]), unit))

    return draw


def _old(of: Kind, sent: Array, rng: np.random.Generator) -> Drawn:
    rows = int(rng.integers(1, 4))
    return Drawn(Traits(old=rows), (), ("delay", rows * of.interval, "s"))


def _magnet(of: Kind, sent: Array, rng: np.random.Generator) -> Drawn:
    """A magnet under the track: it pulls from both sides towards its place."""
    place, size = rng.uniform(-0.5, 0.5), _between(rng, 1, 6)

    def force(x: Array, u: Array) -> Array:
        away = (x[:, 0] - place) / 0.12
        return -size * away * np.exp(-(away**2) / 2)

    return Drawn(Traits(push=_along(of, 0, force)))


def _near_ground(of: Kind, sent: Array, rng: np.random.Generator) -> Drawn:
    """Thrust gains near the ground, which lies two metres below the start."""
    gain = _between(rng, 0.1, 0.6)
    lift = lambda x, u: gain * u[:, 0] * np.exp(-1.5 * np.maximum(x[:, 1] + 2, 0)) * np.cos(x[:, 2])  # noqa: E731
    return Drawn(Traits(push=_along(of, 1, lift)))


def _keel(of: Kind, sent: Array, rng: np.random.Generator) -> Drawn:
    """A keel's lift: a force across in proportion to the speed ahead times the speed across."""
    lift = _between(rng, 10, 80)
    return Drawn(Traits(push=_along(of, 1, lambda x, u: -lift * np.abs(x[:, 3]) * x[:, 4])))


def _skidding(of: Kind, sent: Array, rng: np.random.Generator) -> Drawn:
    """Wheels that grip less in fast turns: turning is braked by the product of both speeds."""
    share = _between(rng, 0.3, 2)
    return Drawn(Traits(push=_along(of, 1, lambda x, u: -share * np.abs(x[:, 3]) * x[:, 4])))


_QUEUE = (_late, ("delay", "sensor_delay"), "commands wait in a queue; late readings of all sensors would look alike")
_FILTER = (_slow, ("lag",), "a filter of first order lies before all motors")
_CLIP = (_limited, ("saturation",), "a command is clipped")
_BAND = (_dead, ("deadband",), "a command near zero does nothing, a greater one less than it says")
_DRY = ("coulomb_friction", "stribeck_friction")
_DRIFT = ("body_frame_bias", "external_push", "slope")
_LAST_READING = (_old, ("sensor_delay",), "velocities are measured some rows before they are shown")
CAUSES = {
    **{f"{what} of a {kind}": Cause(kind, *how) for what, how, kinds in (
        ("delay", _QUEUE, ("crane", "drone", "boat", "two links", "two wheels")),
        ("lag", _FILTER, ("crane", "drone", "boat", "two links", "two wheels")),
        ("limit", _CLIP, ("crane", "two links", "two wheels")),
        ("dead band", _BAND, ("crane", "boat", "two wheels")),
        ("late velocities", _LAST_READING, ("drone", "two links")),
    ) for kind in kinds},
    "dry track": Cause("crane", _dry(0, 0.1, 1.0, "N"), _DRY, "a nearly constant force against the motion"),
    "pole in oil": Cause("crane", _oiled, ("viscous_drag",),
                         "a torque at the free joint in proportion to its speed"),
    "tilted track": Cause("crane", _windy, _DRIFT, "a steady force along the track"),
    "cart on a spring": Cause("crane", _sprung, ("nonlinear_spring",), "a force in proportion to the way from a place"),
    "magnet": Cause("crane", _magnet, (), "there is no word for it"),
    "crooked encoder of a crane": Cause("crane", _offset(1, 0.005, 0.05, "rad"), ("sensor_bias",), "an offset"),
    "drag of a drone": Cause("drone", _squared(0.1, 1.0), ("quadratic_drag",),
                             "a force in proportion to the squared speed"),
    "wind": Cause("drone", _windy, _DRIFT, "a steady force along the ground"),
    "crooked level of a drone": Cause("drone", _offset(2, 0.005, 0.05, "rad"), ("sensor_bias",), "an offset"),
    "gyroscope of a drone": Cause("drone", _scaled(5), ("sensor_scale",), "a rate is shown too large or too small"),
    "near the ground": Cause("drone", _near_ground, (), "there is no word for it"),
    "drag of a boat": Cause("boat", _squared(3, 30, "s/m"),
                            ("quadratic_drag",), "a force in proportion to the squared speed ahead"),
    "gyroscope of a boat": Cause("boat", _scaled(5), ("sensor_scale",), "a rate is shown too large or too small"),
    "keel": Cause("boat", _keel, (), "there is no word for it"),
    "dry shoulder": Cause("two links", _dry(0, 0.1, 0.8, "N m"), _DRY, "a nearly constant torque against the motion"),
    "dry elbow": Cause("two links", _dry(1, 0.05, 0.4, "N m"), _DRY, "a nearly constant torque against the motion"),
    "crooked encoder of an arm": Cause("two links", _offset(0, 0.003, 0.05, "rad"), ("sensor_bias",), "an offset"),
    "uneven wheels": Cause("two wheels", _uneven, ("cross_axis_coupling",), "a speed ahead turns the base as well"),
    "gyroscope of a base": Cause("two wheels", _scaled(4), ("sensor_scale",), "a rate is shown too large or too small"),
    "skidding": Cause("two wheels", _skidding, (), "there is no word for it"),
}  # fmt: skip
"""By what a person would say."""
