"""What a concealed effect may do to the robot: the base of all forms, and what they know of the row under way."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

SUBSTEPS = 8
"""Of a row."""


class Size(NamedTuple):
    """Sessions of a case, copies of the case run side by side (at other magnitudes), rows of a session."""

    sessions: int
    copies: int
    rows: int

    @property
    def batch(self) -> int:
        return self.sessions * self.copies

    def tile(self, per_session: Array) -> Array:
        """What was drawn for each session [S, ...], for every copy [B, ...]: all copies meet the same chance."""
        return np.concatenate([per_session] * self.copies)


class Now:
    """A row under way, for B robots side by side.

    t: its number. x: the true state at its start [B, 12]. sent: the command as sent [B, 6], body frame. arm: from base
    to hand in the body frame [B, 3]. v_body: velocities of base and of the arm by itself at the row's start, body
    frame [B, 6]. duration: of the row in nominal rows [B]. v_base: world velocities of the base over its substeps
    [K, B, 3], once they are known. alpha: velocity memory of this row [B, 6].
    """

    t: int
    x: Array
    sent: Array
    arm: Array
    v_body: Array
    duration: Array
    v_base: Array
    own: Array
    alpha: Array

    @property
    def reach(self) -> Array:
        """Horizontal distance from base to hand [B], m."""
        return np.hypot(self.arm[:, 0], self.arm[:, 1])

    @property
    def yaw(self) -> Array:
        return self.x[:, 2]


class Form:
    """A concealed effect. `m` [B] is its magnitude in this row, nil at zero; its constants grow with it.

    A form draws what is fixed of it (where it acts, the odds of chance) when it is made, and gets memory for a run in
    `begin`. It overrides what it needs.
    """

    id = ""
    scale = 1.0
    """Magnitude that is large: the search for a wanted strength ends there."""
    channels: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    depends: tuple[str, ...] = ()
    """What a law without an id depends on."""
    accept: tuple[str, ...] = ()
    """Other ids that are right answers too."""
    why = ""
    """Why they are."""

    def begin(self, size: Size, rng: np.random.Generator) -> None:
        """Make ready for a run; what is drawn must not depend on `size.copies`."""

    def constants(self, magnitude: float) -> list[dict[str, Any]]:
        """The true constants with units, as a diagnosis would name them; `m` is the magnitude at full strength."""
        return []

    m: Array

    def command(self, now: Now, u: Array) -> Array:
        """The command as it arrives over the substeps [K, B, 6], body frame."""
        return u

    def row(self, now: Now) -> None:
        """Change what holds for a whole row: duration, memory."""

    def drive(self, now: Now, k: int, part: str, u: Array, v: Array) -> Array:
        """The velocity that base or arm (`part`) is driven to in substep k [B, 3], body frame; v is its velocity."""
        return u

    def grip(self, now: Now, k: int, part: str, u: Array, before: Array, after: Array) -> Array:
        """The velocity after substep k, once more: what is held fast, what cannot go further."""
        return after

    def blend(self, now: Now, part: str, old: Array, relaxed: Array) -> Array:
        """The velocity at the row's end in the world frame [B, 3], once more."""
        return relaxed

    def shift(self, now: Now, v: Array) -> Array:
        """World velocities [B, 6] that positions advance by, given those at the row's end."""
        return v

    def place(self, now: Now, p: Array, v: Array) -> tuple[Array, Array]:
        """Positions and velocities [B, 12 as state] after every substep of advancing: walls and floors."""
        return p, v

    def sense(self, t: int, true: Array, seen: Array) -> Array:
        """What is measured at row t [B, 12], given the true states so far [T, B, 12] and what is measured besides."""
        return seen

    def scatter(self, t: int, true: Array, noise: Array) -> Array:
        """The measurement noise of row t [B, 12], once more."""
        return noise

    hooks = ("command", "row", "drive", "grip", "blend", "shift", "place", "sense", "scatter")

    def overrides(self, hook: str) -> bool:
        return getattr(type(self), hook) is not getattr(Form, hook)
