"""What the machines of the training ground have and their simulators lack: laws in forms that the vocabulary has not.

`families` draws their constants.
"""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float

Command = Float[np.ndarray, " u"]
Velocity = Float[np.ndarray, " v"]


class Law(Protocol):
    """A law with a memory, drawn anew for every session.

    Commands, velocities and pushes are those of all axes; a command that an axis lacks is zero.
    """

    @property
    def of_commands(self) -> bool:
        """Whether it acts on commands, and so only along axes that have one."""
        ...

    def begin(self, rng: np.random.Generator) -> None:
        """Take the session's own randomness."""
        ...

    def command(self, sent: Command, h: float) -> Command:
        """What of the command arrives, a moment of length h [s] later."""
        ...

    def push(self, q: Any, v: Velocity, u: Command, h: float) -> Velocity:
        """Acceleration that the simulator lacks."""
        ...

    def read(self, v: Velocity, row: float) -> Velocity:
        """What sensors show of the velocities, a row of that length [s] after the last one."""
        ...


class Plain:
    """A law that does nothing; the others differ from it in one of three ways."""

    of_commands = False
    """Whether it acts on commands, and so only along axes that have one."""

    def begin(self, rng: np.random.Generator) -> None:
        self.rng = rng

    def command(self, sent: Command, h: float) -> Command:  # noqa: ARG002
        return sent

    def push(self, q: Any, v: Velocity, u: Command, h: float) -> Velocity:  # noqa: ARG002
        return np.zeros_like(v)

    def read(self, v: Velocity, row: float) -> Velocity:  # noqa: ARG002
        return v


class Arriving(Plain):
    """A law between the command that is sent and the one that arrives."""

    of_commands = True


class Static(Arriving):
    """A curve that commands pass."""

    def __init__(self, curve: Callable[[Command], Command]) -> None:
        self.curve = curve

    def command(self, sent: Command, h: float) -> Command:  # noqa: ARG002
        return self.curve(sent)


class Push(Plain):
    """A push that depends on position, velocity and command as they are."""

    def __init__(self, law: Callable[[Any, Velocity, Command], Velocity]) -> None:
        self.law = law

    def push(self, q: Any, v: Velocity, u: Command, h: float) -> Velocity:  # noqa: ARG002
        return self.law(q, v, u)


class Late(Arriving):
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


class Play(Arriving):
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


class Slow(Arriving):
    """Commands are followed no faster than `limit` [1/s], with a rounded corner."""

    def __init__(self, limit: float, corner: float) -> None:
        self.limit, self.corner = limit, corner
        self.at: Command | None = None

    def command(self, sent: Command, h: float) -> Command:
        at = sent if self.at is None else self.at
        step = sent - at
        over = np.abs(step) / (self.limit * h)
        moved: Command = at + step / (1 + over**self.corner) ** (1 / self.corner)
        self.at = moved
        return moved


class Ringing(Arriving):
    """Commands pass an oscillator of frequency [rad/s] and damping ratio."""

    def __init__(self, frequency: float, damping: float) -> None:
        self.frequency, self.damping = frequency, damping
        self.at: Command | None = None
        self.rate: Any = 0.0

    def command(self, sent: Command, h: float) -> Command:
        at, w = sent if self.at is None else self.at, self.frequency
        self.rate = self.rate + h * (w**2 * (sent - at) - 2 * self.damping * w * self.rate)
        moved: Command = at + h * self.rate
        self.at = moved
        return moved


class Tired(Arriving):
    """Work heats, and heat takes strength: of a command a share is lost that grows and fades with `fades` [s]."""

    def __init__(self, loss: float, fades: float) -> None:
        self.loss, self.fades = loss, fades
        self.heat: Any = 0.0

    def command(self, sent: Command, h: float) -> Command:
        self.heat = self.heat + h / self.fades * (sent**2 - self.heat)
        return sent * (1 - self.loss * self.heat / (1 + self.heat))


class Fading(Arriving):
    """The response to commands drifts by a share `by` in `within` [s], ever more slowly: half of it in a third."""

    def __init__(self, by: float, within: float) -> None:
        self.by, self.within = by, within
        self.since = 0.0

    def command(self, sent: Command, h: float) -> Command:
        self.since += h
        return sent * (1 + self.by * 2 * self.since / (self.since + self.within))


class Gusts(Plain):
    """Random pushes, correlated over `lasts` [s]."""

    def __init__(self, size: float, lasts: float) -> None:
        self.size, self.lasts = size, lasts
        self.at: Any = 0.0

    def push(self, q: Any, v: Velocity, u: Command, h: float) -> Velocity:  # noqa: ARG002
        kept = np.exp(-h / self.lasts)
        self.at = kept * self.at + self.size * np.sqrt(1 - kept**2) * self.rng.standard_normal(v.shape)
        return self.at


class Bristles(Plain):
    """Hysteresis: bristles of some length bend with the motion and push back (Dahl's friction with a free exponent)."""

    def __init__(self, force: float, length: float, exponent: float) -> None:
        self.force, self.length, self.exponent = force, length, exponent
        self.bent: Any = 0.0

    def push(self, q: Any, v: Velocity, u: Command, h: float) -> Velocity:  # noqa: ARG002
        ease = np.clip(1 - self.bent * np.sign(v), 0.0, 2.0) ** self.exponent
        self.bent = np.clip(self.bent + h * v / self.length * ease, -1.0, 1.0)
        return -self.force * self.bent


class Uneven(Plain):
    """A law whose strength varies with place or command, and that acts along some axes only.

    axes: one along which it acts, else zero. depth: share by which its strength varies; waves: per unit of place or
    command. A sensor does not know the place: along its axes it reads as it does everywhere.
    """

    def __init__(self, law: Law, axes: Float[np.ndarray, " v"], depth: float, waves: float, phase: float) -> None:
        self.law, self.axes, self.of_commands = law, axes, law.of_commands
        self.depth, self.waves, self.phase = depth, waves, phase

    def begin(self, rng: np.random.Generator) -> None:
        self.law.begin(rng)

    def command(self, sent: Command, h: float) -> Command:
        return sent + self._strength(sent) * (self.law.command(sent, h) - sent)

    def push(self, q: Any, v: Velocity, u: Command, h: float) -> Velocity:
        return self._strength(q[: len(v)]) * self.law.push(q, v, u, h)

    def read(self, v: Velocity, row: float) -> Velocity:
        return v + self.axes * (self.law.read(v, row) - v)

    def _strength(self, at: Any) -> Any:
        return self.axes * (1 + self.depth * np.sin(self.waves * at + self.phase))
