"""What the machines of the training ground have and their simulators lack: laws in forms that the vocabulary has not.

Each family is drawn with constants of its own, `size` being a share of usual commands and speeds, which are near one.
`names` are the effects that name it rightly; none where the vocabulary has no word for it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

Command = Float[np.ndarray, " u"]
Velocity = Float[np.ndarray, " v"]


class Law(Protocol):
    """A law with a memory, drawn anew for every session."""

    def begin(self, rng: np.random.Generator) -> None:
        """Take the session's own randomness."""
        ...

    def command(self, sent: Command, h: float) -> Command:
        """What of the command arrives, a moment of length h [s] later."""
        ...

    def push(self, q: Any, v: Velocity, u: Command, h: float) -> Velocity:
        """Acceleration that the simulator lacks."""
        ...


class _Plain:
    """A law that does nothing; the others differ from it in one of two ways."""

    def begin(self, rng: np.random.Generator) -> None:
        self.rng = rng

    def command(self, sent: Command, h: float) -> Command:  # noqa: ARG002
        return sent

    def push(self, q: Any, v: Velocity, u: Command, h: float) -> Velocity:  # noqa: ARG002
        return np.zeros_like(v)


class Static(_Plain):
    """A curve that commands pass."""

    def __init__(self, curve: Callable[[Command], Command]) -> None:
        self.curve = curve

    def command(self, sent: Command, h: float) -> Command:  # noqa: ARG002
        return self.curve(sent)


class Push(_Plain):
    """A push that depends on position, velocity and command as they are."""

    def __init__(self, law: Callable[[Any, Velocity, Command], Velocity]) -> None:
        self.law = law

    def push(self, q: Any, v: Velocity, u: Command, h: float) -> Velocity:  # noqa: ARG002
        return self.law(q, v, u)


class Late(_Plain):
    """Commands arrive `delay` [s] late, plus or minus some `jitter`, and through poles of `lag` [s]."""

    def __init__(self, delay: float, jitter: float, lags: tuple[float, ...]) -> None:
        self.delay, self.jitter, self.lags = delay, jitter, lags
        self.sent: list[Command] = []
        self.poles: list[Command] | None = None

    def command(self, sent: Command, h: float) -> Command:
        self.sent.append(sent)
        late = self.delay + self.jitter * self.rng.uniform(-1, 1)
        u = self.sent[max(len(self.sent) - 1 - max(round(late / h), 0), 0)]
        self.poles = self.poles or [u.copy() for _ in self.lags]
        for pole, lag in zip(self.poles, self.lags, strict=True):
            pole += (1 - np.exp(-h / lag)) * (u - pole)
            u = pole.copy()
        return u


class Play(_Plain):
    """The output rests until the input has crossed a gap; it follows through a soft flank of a share of the gap."""

    def __init__(self, gap: float, soft: float) -> None:
        self.gap, self.soft = gap, soft
        self.at: Command | None = None

    def command(self, sent: Command, h: float) -> Command:  # noqa: ARG002
        at = sent if self.at is None else self.at
        away = sent - at
        beyond = np.maximum(np.abs(away) - self.gap / 2, 0.0)
        moved: Command = at + np.sign(away) * beyond * (1 - self.soft * np.exp(-beyond / self.gap))
        self.at = moved
        return moved


class Slow(_Plain):
    """Commands are followed no faster than `limit` [1/s], with a rounded corner."""

    def __init__(self, limit: float, corner: float) -> None:
        self.limit, self.corner = limit, corner
        self.at: Command | None = None

    def command(self, sent: Command, h: float) -> Command:
        self.at = sent.copy() if self.at is None else self.at
        step, most = sent - self.at, self.limit * h
        over = np.abs(step) / most
        moved: Command = self.at + step / (1 + over**self.corner) ** (1 / self.corner)
        self.at = moved
        return moved


class Ringing(_Plain):
    """Commands pass an oscillator of frequency [rad/s] and damping ratio."""

    def __init__(self, frequency: float, damping: float) -> None:
        self.frequency, self.damping = frequency, damping
        self.at: Command | None = None
        self.rate: Any = 0.0

    def command(self, sent: Command, h: float) -> Command:
        self.at = sent.copy() if self.at is None else self.at
        w = self.frequency
        self.rate = self.rate + h * (w**2 * (sent - self.at) - 2 * self.damping * w * self.rate)
        moved: Command = self.at + h * self.rate
        self.at = moved
        return moved


class Tired(_Plain):
    """Work heats, and heat takes strength: of a command a share is lost that grows and fades with `fades` [s]."""

    def __init__(self, loss: float, fades: float) -> None:
        self.loss, self.fades = loss, fades
        self.heat: Any = 0.0

    def command(self, sent: Command, h: float) -> Command:
        self.heat = self.heat + h / self.fades * (sent**2 - self.heat)
        return sent * (1 - self.loss * self.heat / (1 + self.heat))


class Gusts(_Plain):
    """Random pushes, correlated over `lasts` [s]."""

    def __init__(self, size: float, lasts: float) -> None:
        self.size, self.lasts = size, lasts
        self.at: Any = 0.0

    def push(self, q: Any, v: Velocity, u: Command, h: float) -> Velocity:  # noqa: ARG002
        kept = np.exp(-h / self.lasts)
        self.at = kept * self.at + self.size * np.sqrt(1 - kept**2) * self.rng.standard_normal(v.shape)
        return self.at


class Bristles(_Plain):
    """Hysteresis: bristles of some length bend with the motion and push back (Dahl's friction with a free exponent)."""

    def __init__(self, force: float, length: float, exponent: float) -> None:
        self.force, self.length, self.exponent = force, length, exponent
        self.bent: Any = 0.0

    def push(self, q: Any, v: Velocity, u: Command, h: float) -> Velocity:  # noqa: ARG002
        ease = np.clip(1 - self.bent * np.sign(v), 0.0, 2.0) ** self.exponent
        self.bent = np.clip(self.bent + h * v / self.length * ease, -1.0, 1.0)
        return -self.force * self.bent


class Family(NamedTuple):
    """A kind of missing physics: the effects that name it rightly, and how one of it is drawn, `draw(rng, size, row,
    rate)`. row: length of a row [s]; rate: the machine's acceleration per unit of command [1/s^2]."""

    names: frozenset[str]
    draw: Callable[[np.random.Generator, float, float, float], Law]


def _friction(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    soft, bump, fades = rng.uniform(0.005, 0.1), rng.uniform(0, 0.6), rng.uniform(0.1, 0.5)
    force = size * rate
    return Push(lambda q, v, u: -force * np.tanh(v / soft) * (1 + bump * np.exp(-np.abs(v) / fades)))  # noqa: ARG005


def _drag(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    power, force = rng.uniform(1.6, 2.4), size * rate
    return Push(lambda q, v, u: -force * np.sign(v) * np.abs(v) ** power)  # noqa: ARG005


def _bias(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    force, wave = rng.choice([-1, 1]) * size * rate, rng.uniform(0, 0.3)
    # Along the first axis; a little of it varies with the speed.
    return Push(lambda q, v, u: np.eye(len(v))[0] * force * (1 + wave * np.sin(2 * v[0])))  # noqa: ARG005


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


def _named(*names: str) -> frozenset[str]:
    return frozenset(names)


FAMILIES: dict[str, Family] = {
    "friction": Family(_named("coulomb_friction"), _friction),
    "drag": Family(_named("quadratic_drag"), _drag),
    "bias": Family(_named("body_frame_bias"), _bias),
    "delay": Family(_named("delay"), _delay),
    "lag": Family(_named("lag"), _lag),
    "dispersion": Family(_named("delay", "lag"), _dispersion),
    "saturation": Family(_named("saturation"), _saturation),
    "deadband": Family(_named("deadband"), _deadband),
    "one_sided": Family(_named("asymmetric_gain"), _one_sided),
    "rate_limit": Family(_named("rate_limit"), _rate_limit),
    "play": Family(_named("backlash"), _play),
    "cogging": Family(_named(), _cogging),
    "wall": Family(_named(), _wall),
    "hardening": Family(_named(), _hardening),
    "product": Family(_named(), _product),
    "place_gain": Family(_named(), _place_gain),
    "ringing": Family(_named(), _ringing),
    "tired": Family(_named(), _tired),
    "gusts": Family(_named(), _gusts),
    "bristles": Family(_named(), _bristles),
}
WITHIN = tuple(name for name, family in FAMILIES.items() if family.names)
OUTSIDE = tuple(name for name, family in FAMILIES.items() if not family.names)
