"""The geometry that a simulator declares: which command drives which velocity of which body, and the mounts of bodies.

Motions and pushes are expressed in each body's own frame, along x, y, z and yaw. So a law of friction is the same for a
one-axis drive and for a hand on a walking robot.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from simgap.types import Schema

AXES = ("x", "y", "z", "yaw")


X, Y, Z, YAW = range(4)


@dataclass(frozen=True)
class Layout:
    """The roles of a schema's columns.

    `position`, `velocity` [s index] and `command` [u index] are tables of bodies x `AXES`, -1 where there is none.
    """

    schema: Schema

    @cached_property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies, in the order of their first state column."""
        return tuple(dict.fromkeys(f.body for f in self.schema.state if f.body))

    @cached_property
    def position(self) -> np.ndarray:
        return self._table([(i, f) for i, f in enumerate(self.schema.state) if f.kind in ("position", "angle")])

    @cached_property
    def velocity(self) -> np.ndarray:
        return self._table([(i, f) for i, f in enumerate(self.schema.state) if f.kind == "velocity"])

    @cached_property
    def command(self) -> np.ndarray:
        """Commands in which a push can enter: velocities and forces."""
        return self._table([(i, f) for i, f in enumerate(self.schema.command) if f.kind in ("velocity", "force")])

    @cached_property
    def driven(self) -> np.ndarray:
        """Commands that drive an axis, including position set points."""
        return self._table(list(enumerate(self.schema.command)))

    @cached_property
    def joints(self) -> frozenset[str]:
        """Bodies that an engine can push by a force or torque along one axis."""
        return frozenset(f.body for f in self.schema.state if f.effort)

    @cached_property
    def jointed(self) -> bool:
        """Whether every axis that can be pushed is a joint's, so that no body moves freely."""
        moving = [b for b, row in enumerate(self.velocity) if (row >= 0).any()]
        return bool(moving) and all(self.bodies[b] in self.joints for b in moving)

    def single(self, body: int) -> bool:
        """Whether a body has one axis only and no carrier: its motion then needs no name of a direction."""
        axes = ((self.velocity[body] >= 0) | (self.position[body] >= 0)).sum()
        return bool(axes == 1) and self.carrier[body] is None

    @cached_property
    def observed(self) -> np.ndarray:
        """Which states recordings have as columns; these come first."""
        return np.array([f.observed for f in self.schema.state])

    @cached_property
    def carrier(self) -> tuple[int | None, ...]:
        """Index of the body that each body is mounted on."""
        mounts = dict(self.schema.mounts)
        return tuple(self.bodies.index(mounts[b]) if b in mounts else None for b in self.bodies)

    @cached_property
    def heading(self) -> tuple[int | None, ...]:
        """State index of the yaw that turns each body's frame: its carrier's, or its own."""
        own = [int(i) if i >= 0 else None for i in self.position[:, YAW]]
        return tuple(own[b] if c is None else own[c] for b, c in enumerate(self.carrier))

    @cached_property
    def angles(self) -> np.ndarray:
        """Which states are angles."""
        return np.array([f.kind == "angle" for f in self.schema.state])

    def in_world(self, what: Literal["position", "velocity", "command"], body: int) -> bool:
        """Whether a body's horizontal positions, velocities or commands are along the world's axes, not its own."""
        fields = self.schema.command if what == "command" else self.schema.state
        columns = getattr(self, what)[body, [X, Y]]
        return all(fields[i].frame == "world" for i in columns if i >= 0)

    @cached_property
    def integrates(self) -> np.ndarray:
        """For each state the index of the velocity whose integral it is in the same frame, -1 where there is none."""
        table = np.full(len(self.schema.state), -1)
        for p, v in zip(self.position.flat, self.velocity.flat, strict=True):
            if p >= 0 and v >= 0 and self._same_frame(int(p), int(v)):
                table[p] = v
        return table

    @cached_property
    def akin(self) -> tuple[tuple[int, int], ...]:
        """Pairs of states (i, j) that are coupled in the bodies' own frames: measuring one informs about the other.

        States of one axis are: a body carries what is mounted on it, and a velocity moves its position. So are yaw and
        y: a body that turns sweeps the arm ahead of it sideways. A joint's axis is coupled to no other body's. Of an
        unmeasured state that is `apart` no axis says what informs about it: all that is measured may.
        """
        measured = np.flatnonzero(self.observed).tolist()
        return (*self._of_one_axis, *((i, j) for i in np.flatnonzero(self.apart).tolist() for j in measured))

    @cached_property
    def apart(self) -> np.ndarray:
        """Which states are unmeasured and share no axis with a measured one.

        None of a machine with joints: its actuators' states follow the commands alone.
        """
        reached = {i for i, j in self._of_one_axis if self.observed[j]}
        fields = enumerate(self.schema.state)
        return np.array([not (f.observed or i in reached or self.joints) for i, f in fields], bool)

    @cached_property
    def _of_one_axis(self) -> tuple[tuple[int, int], ...]:
        axis = [{"yaw": "y"}.get(f.axis, f.axis) if f.body else "" for f in self.schema.state]
        kin = [f.body if f.body in self.joints else a for f, a in zip(self.schema.state, axis, strict=True)]
        return tuple((i, j) for i, a in enumerate(kin) for j, b in enumerate(kin) if i != j and a and a == b)

    def _same_frame(self, p: int, v: int) -> bool:
        """Whether a position and a velocity share a frame; in yaw, along z, and without a heading, all do."""
        position, velocity = self.schema.state[p], self.schema.state[v]
        body = self.bodies.index(position.body)
        return position.frame == velocity.frame or position.axis in ("yaw", "z") or self.heading[body] is None

    def _table(self, fields: list) -> np.ndarray:
        table = np.full((len(self.bodies), 4), -1)
        for i, f in fields:
            if f.body in self.bodies and f.axis:
                table[self.bodies.index(f.body), AXES.index(f.axis)] = i
        return table

    def outputs(self, body: int, axes: tuple[int, ...] = (X, Y, Z, YAW)) -> tuple[str, ...]:
        """Names of a body's velocities along these axes; of its positions where it has no velocity."""
        rows = [self.velocity[body, a] if self.velocity[body, a] >= 0 else self.position[body, a] for a in axes]
        return tuple(self.schema.state[i].name for i in rows if i >= 0)

    def shown_in(self, body: int, axes: tuple[int, ...]) -> tuple[str, ...]:
        """Names of the outputs that show a body's motion along these axes of its own.

        Where the velocity is in the world frame, motion along x shows in y as well, as the body turns.
        """
        turns = self.heading[body] is not None and self.in_world("velocity", body)
        across = {X, Y} if turns and {X, Y} & set(axes) else set()
        return self.outputs(body, tuple(sorted({*axes, *across})))

    def drives(self, body: int, axis: int) -> bool:
        """Whether a push on the body along the axis has any effect."""
        return bool(max(self.command[body, axis], self.velocity[body, axis], self.position[body, axis]) >= 0)
