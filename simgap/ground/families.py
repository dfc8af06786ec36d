"""Kinds of missing physics of the training ground, each drawn with constants of its own.

Sizes are shares of usual commands and speeds, which are near one. `names` are the effects that name a family rightly;
none where the vocabulary has no word for it.
"""

from collections.abc import Callable

import numpy as np

from simgap.ground.crossed import CROSSED
from simgap.ground.family import HELD, JOINED, READ, RUBBING, Family, named
from simgap.ground.laws import Bristles, Fading, Gusts, Late, Law, Play, Push, Ringing, Slow, Static, Tired
from simgap.ground.legged import LEGGED
from simgap.ground.readings import Curve, Offset, Old


def _friction(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    soft, bump, fades = rng.uniform(0.005, 0.1), rng.uniform(0, 0.6), rng.uniform(0.1, 0.5)
    force = size * rate
    return Push(lambda q, v, u: -force * np.tanh(v / soft) * (1 + bump * np.exp(-np.abs(v) / fades)))  # noqa: ARG005


def _stribeck(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    """The same, with a bump as high as the rest, or up to twice as high."""
    soft, bump, fades, power = rng.uniform(0.005, 0.03), rng.uniform(1, 2), rng.uniform(0.1, 0.5), rng.uniform(0.8, 2)
    force = size * rate
    return Push(lambda q, v, u: -force * np.tanh(v / soft) * (1 + bump * np.exp(-(np.abs(v / fades) ** power))))  # noqa: ARG005


def _under_load(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    soft, power, ratio = rng.uniform(0.005, 0.05), rng.uniform(0.8, 1.2), size * rate
    return Push(lambda q, v, u: -ratio * np.tanh(v / soft) * np.abs(u[: len(v)]) ** power)  # noqa: ARG005


def _drag(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    power, force = rng.uniform(1.6, 2.4), size * rate
    return Push(lambda q, v, u: -force * np.sign(v) * np.abs(v) ** power)  # noqa: ARG005


def _bias(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    force, wave = rng.choice([-1, 1]) * size * rate, rng.uniform(0, 0.3)
    # A little of it varies with the speed.
    return Push(lambda q, v, u: force * (1 + wave * np.sin(2 * v)))  # noqa: ARG005


def _delay(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    delay = row * np.clip(10 * size, 0.3, 5)
    return Late(delay, rng.uniform(0, 0.3) * delay, ())


def _lag(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    lag = row * np.clip(10 * size, 0.3, 6)
    return Late(0.0, 0.0, (lag, rng.uniform(0.02, 0.2) * lag))


def _dispersion(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    part = row * np.clip(10 * size, 0.5, 5) / 3
    return Late(0.0, 0.0, (part, part, part))


def _saturation(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    limit, sharp = 1.5 / (1 + 4 * size), rng.uniform(3, 12)
    return Static(lambda u: u / (1 + np.abs(u / limit) ** sharp) ** (1 / sharp))


def _deadband(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    width, soft = size, rng.uniform(0.02, 0.3) * size
    # Commands beyond are lessened by the width or not, to some degree.
    lost = rng.choice([0.0, 1.0])
    passes = lambda u: 1 / (1 + np.exp(np.clip(-(np.abs(u) - width) / soft, -50, 50)))  # noqa: E731
    return Static(lambda u: passes(u) * (u - lost * width * np.sign(u)))


def _one_sided(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    weak, soft, side = 1 - min(size, 0.8), rng.uniform(0.02, 0.2), rng.choice([-1, 1])
    return Static(lambda u: u * (1 - (1 - weak) / (1 + np.exp(np.clip(side * u / soft, -50, 50)))))


def _rate_limit(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    return Slow(0.25 / (row * (0.2 + 10 * size)), rng.uniform(2, 8))


def _play(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    return Play(size, rng.uniform(0, 0.5))


def _cogging(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    turns, phase, force = rng.uniform(4, 15), rng.uniform(0, 2 * np.pi), size * rate
    return Push(lambda q, v, u: force * np.sin(turns * q[: len(v)] + phase))  # noqa: ARG005


def _wall(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    where, force = rng.uniform(-0.2, 0.4), 8 * size * rate
    return Push(lambda q, v, u: -force * np.maximum(q[: len(v)] - where, 0.0))  # noqa: ARG005


def _hardening(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    force = size * rate * rng.choice([-0.5, 1.0])
    return Push(lambda q, v, u: -force * np.clip(q[: len(v)], -2, 2) ** 3)  # noqa: ARG005


def _product(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    force = size * rate * rng.choice([-1, 1])
    return Push(lambda q, v, u: force * v * np.tanh(u[: len(v)]))  # noqa: ARG005


def _place_gain(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    turns, force = rng.uniform(1, 4), size * rate
    return Push(lambda q, v, u: force * np.sin(turns * q[: len(v)]) * u[: len(v)])


def _ringing(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    return Ringing(1 / (row * (0.5 + 10 * size)), rng.uniform(0.1, 0.4))


def _tired(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    return Tired(min(3 * size, 0.9), row * rng.uniform(20, 100))


def _gusts(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:
    return Gusts(size * rate, row * rng.uniform(2, 20))


def _bristles(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    return Bristles(size * rate, rng.uniform(0.1, 0.6), rng.uniform(0.5, 2))


def _stretched(rng: np.random.Generator, size: float) -> Callable[[np.ndarray], np.ndarray]:
    """What a factor off by a share of `size` adds: a little less where that is large."""
    share, bend = rng.choice([-1, 1]) * size, rng.uniform(2, 6)
    return lambda x: share * bend * np.tanh(x / bend)


def _gain(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    added = _stretched(rng, size)
    return Static(lambda u: u + added(u))


def _leak(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    added, side = _stretched(rng, size), rng.choice([-1, 1])
    return Static(lambda u: u + added(np.roll(u, side)))


def _fading(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    within = row * rng.uniform(180, 250)
    # Nearly as fast as the vocabulary's own can be, 1 a minute: sessions are short, and slower ones do not show.
    most = 0.7 * within / 60
    return Fading(rng.choice([-1, 1]) * most * np.tanh(4 * size / most), within)


def _sensor_scale(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    added = _stretched(rng, size)
    return Curve(lambda v: v + added(v))


def _sensor_bias(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    return Offset(rng.choice([-1, 1]) * size, rng.uniform(0, 0.3), row * rng.uniform(20, 200))


def _old_reading(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    age = row * np.clip(10 * size, 0.3, 3)
    return Old(age, rng.uniform(0, 0.3) * age)


def _rectified(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    """A sensor loses the sign; its answers to both signs differ a little."""
    ratio = rng.uniform(0.9, 1.1)
    return Curve(lambda v: np.where(v < 0, -ratio * v, v))


def _lopsided(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    """Of speeds of one sign a sensor shows less, or nothing."""
    share, side = 2 * size, rng.choice([-1, 1])
    return Curve(lambda v: v - share * side * np.maximum(side * v, 0.0))


FAMILIES: dict[str, Family] = {
    "friction": Family(named("coulomb_friction"), _friction, RUBBING),
    "stribeck": Family(named(), _stribeck, RUBBING),
    # Where an axis has no motor, nothing loads it.
    "under_load": Family(named(), _under_load, tuple(m for m in RUBBING if m not in ("trolley", "hull"))),
    "drag": Family(named("quadratic_drag"), _drag),
    "bias": Family(named("body_frame_bias"), _bias),
    "delay": Family(named("delay"), _delay),
    "lag": Family(named("lag"), _lag),
    "dispersion": Family(named("delay", "lag"), _dispersion),
    "saturation": Family(named("saturation"), _saturation),
    "deadband": Family(named("deadband"), _deadband),
    "one_sided": Family(named("asymmetric_gain"), _one_sided),
    "rate_limit": Family(named("rate_limit"), _rate_limit),
    "play": Family(named("backlash"), _play),
    "cogging": Family(named(), _cogging),
    "wall": Family(named(), _wall),
    "hardening": Family(named(), _hardening),
    "product": Family(named(), _product),
    "place_gain": Family(named(), _place_gain),
    "ringing": Family(named("resonance"), _ringing),
    "tired": Family(named(), _tired),
    "gusts": Family(named(), _gusts),
    "bristles": Family(named(), _bristles, RUBBING),
    # Elsewhere a parameter scales the command alone.
    "gain": Family(named("gain"), _gain, (*HELD, "base", "spot", "wheels")),
    # A leak of the Spot would cross its bodies, and a steady offset of a velocity in the world is a parameter of it.
    "leak": Family(named(), _leak, JOINED),
    "fading": Family(named("gain_drift"), _fading),
    "sensor_scale": Family(named("sensor_scale"), _sensor_scale, READ),
    "sensor_bias": Family(named("sensor_bias"), _sensor_bias, tuple(m for m in READ if m != "spot")),
    "old_reading": Family(named("sensor_delay"), _old_reading, READ),
    "lopsided": Family(named(), _lopsided, READ),
    "rectified": Family(named("rectified_sensor"), _rectified, READ),
    **LEGGED,
    **CROSSED,
}
