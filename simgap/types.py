"""The nouns of the project: what is recorded, what is learnt from, what is predicted; and protocols.

Imports neither NumPy nor JAX: commands report wrong arguments before these are loaded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol, runtime_checkable

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Array, Float, Int

MOST_ROWS = 2_000_000
"""Most rows of a session: half an hour at 1 kHz, a day at 20 Hz. With twenty columns these are 320 MB."""

Kind = Literal["position", "angle", "velocity", "force"]
Frame = Literal["world", "body"]
Axis = Literal["x", "y", "z", "yaw", ""]


class SimgapError(Exception):
    """An error that its message explains to the person who can mend it: what must hold, what came, what to do."""


class RecordingError(SimgapError):
    """A recording that cannot be used; the message names file, column, row and remedy."""


class ConfigError(SimgapError, ValueError):
    """A parameter that is unknown, missing or out of its range; the message names it."""


class DivergenceError(SimgapError):
    """A computation that left the finite numbers; the message says where and what may help."""


@dataclass(frozen=True)
class Field:
    """One state or command column: its name, its unit, what it measures and the frame it is given in.

    `body` and `axis` say of which moving part it is and along which axis (`yaw`: about the vertical): a velocity
    changes the position of the same body and axis, a command drives the velocity of the same body and axis. Without
    them, effects that need geometry do not apply.

    observed: whether recordings have it as a column. A state that is not observed is estimated; these come last.
    effort: unit of the force or torque that an engine can apply along this velocity (see `simgap.engines`).
    """

    name: str
    unit: str
    kind: Kind
    frame: Frame
    body: str = ""
    axis: Axis = ""
    observed: bool = True
    effort: str = ""


@dataclass(frozen=True)
class Parameter:
    """One simulator parameter: its name, its unit and its plausible range, from which priors are drawn.

    `nominal` is the value the simulator is used with as it is; the middle of the range where it has none.
    """

    name: str
    unit: str
    low: float
    high: float
    nominal: float | None = None


@dataclass(frozen=True)
class Schema:
    """The columns of a robot's recordings, in order. `mounts`: pairs (body, carrier), where a body is mounted on
    another and turns with it, as a hand on a base."""

    state: tuple[Field, ...]
    command: tuple[Field, ...]
    mounts: tuple[tuple[str, str], ...] = ()

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns a recording file must have, `time_s` first."""
        return ("time_s", *(f.name for f in self.outputs), *(f.name for f in self.command))

    @property
    def outputs(self) -> tuple[Field, ...]:
        """The states that recordings have as columns: the first of all."""
        return tuple(f for f in self.state if f.observed)

    @property
    def measured(self) -> Schema:
        """This schema without the states that recordings lack: that of the recordings' own columns."""
        return Schema(self.outputs, self.command, self.mounts)

    @property
    def encoded(self) -> tuple[str, ...]:
        """Names of the encoded state: every angle replaced by its sine and its cosine."""
        pairs = ((f"sin_{f.name}", f"cos_{f.name}") if f.kind == "angle" else (f.name,) for f in self.state)
        return tuple(name for names in pairs for name in names)


class Recording(NamedTuple):
    """One session as measured: row t is the state at time t and the command sent at time t."""

    name: str
    time_s: Float[np.ndarray, " T"]
    state: Float[np.ndarray, "T s"]
    command: Float[np.ndarray, "T u"]


class Sessions(NamedTuple):
    """Recordings by what they serve: fitted to, held out to judge by, and a baseline from before (may be empty).
    exchangeable: whether other sessions may be held out instead, because these were taken by rule."""

    training: Sequence[Recording]
    heldout: Sequence[Recording]
    baseline: Sequence[Recording] = ()
    exchangeable: bool = False

    @property
    def fitted(self) -> list[Recording]:
        """All that are fitted to, those of the baseline first."""
        return [*self.baseline, *self.training]

    @property
    def by_purpose(self) -> dict[str, Sequence[Recording]]:
        """The sessions of each purpose."""
        return {"training": self.training, "heldout": self.heldout, "baseline": self.baseline}

    def each(self, change: Callable[[Recording], Recording]) -> Sessions:
        """The sessions with every recording changed."""
        return self._replace(**{purpose: [change(r) for r in part] for purpose, part in self.by_purpose.items()})


class Transitions(NamedTuple):
    """Rows for supervised learning: x = [encoded state, u_{t-2}, u_{t-1}, u_t], y = change of the encoded state."""

    x: Float[Array, "N x"]
    y: Float[Array, "N y"]
    session: Int[Array, " N"]


class Prediction(NamedTuple):
    """A predictive mixture with equal weights, in original units: component l predicts `mean[l]` with independent noise
    of scale `scale` and tails `dof` (degrees of freedom of a Student t; infinite for Gaussian noise) per output."""

    mean: Float[Array, "L y"]
    scale: Float[Array, " y"]
    dof: Float[Array, " y"]


class StepModel(Protocol):
    """What a diagnosis needs of a simulator: pure, differentiable, with parameters in plausible ranges."""

    @property
    def schema(self) -> Schema:
        """The columns of its recordings."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters phi, in order."""
        ...

    @property
    def time_step(self) -> float:
        """Nominal interval between rows [s]."""
        ...

    def step(
        self, params: Float[Array, " p"], state: Float[Array, " s"], command: Float[Array, " u"]
    ) -> Float[Array, " s"]:
        """The next state."""
        ...


class Simulator(StepModel, Protocol):
    """A hand-made model of a robot that also gives the coordinates in which functional priors are compared."""

    def to_body(self, state: Float[Array, " s"]) -> Float[Array, " s"]:
        """The state in coordinates whose ranges are independent of each other, such as the robot's own frame."""
        ...

    def from_body(self, body: Float[Array, " s"]) -> Float[Array, " s"]:
        """Inverse of `to_body`."""
        ...


@runtime_checkable
class Remembering(Protocol):
    """A simulator whose next state depends on past commands too."""

    def step_from_history(
        self, params: Float[Array, " p"], state: Float[Array, " s"], commands: Float[Array, "3 u"]
    ) -> Float[Array, " s"]:
        """The next state, given u_{t-2}, u_{t-1}, u_t."""
        ...


class Prior(NamedTuple):
    """Gaussian approximation of a functional prior's marginals at one measurement set X of k points: output i has mean
    `mean[:, i]` and precision `precision[i]`; where o = 1, one precision serves all outputs."""

    mean: Float[Array, "k y"]
    precision: Float[Array, "o k k"]


class Policy(Protocol):
    """What chooses commands; pure, and a pytree of arrays, so that it runs compiled."""

    def command(
        self, state: Float[Array, " s"], past: Float[Array, "2 u"], goal: Float[Array, " 3"]
    ) -> Float[Array, " u"]:
        """The command on measuring a state, after the commands u_{t-2} and u_{t-1}, the hand's goal [m] being given."""
        ...


class Robot(Protocol):
    """What a policy is run on: the virtual Spot, or a real one behind its own interface."""

    @property
    def time_step(self) -> float:
        """Time between commands [s]."""
        ...

    def reset(self) -> None:
        """Make ready for a run: standing still, the arm at rest before it."""
        ...

    def observe(self) -> Float[np.ndarray, " s"]:
        """The state as measured now, in the columns of the schema."""
        ...

    def command(self, command: Float[np.ndarray, " u"]) -> Float[np.ndarray, " u"]:
        """Send a command for one time step; returns it as the robot admits it, clipped to its limits."""
        ...

    def stop(self) -> None:
        """Stand still at once; the run is over."""
        ...


Report = Callable[[int, dict[str, float]], None]
"""`report(step, metrics)`: how long work tells its caller of progress, on the host, between compiled chunks."""
