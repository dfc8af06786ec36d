"""A small engine for tests: joints that servos move against gravity, stepped with numpy."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from simgap.engines import Term
from simgap.types import Field, Parameter, Recording, Schema

JOINTS = ("shoulder", "elbow")
INERTIA = np.array([0.05, 0.02])
WEIGHT = np.array([1.2, 0.5])
KP = np.array([25.0, 12.0])
DAMPING = np.array([1.0, 0.4])


def schema(velocities: bool) -> Schema:
    """Positions, then velocities that recordings have or lack; set positions as commands."""
    position = [Field(f"{j}_pos", "rad", "position", "body", j, "yaw") for j in JOINTS]
    velocity = [Field(f"{j}_vel", "rad/s", "velocity", "body", j, "yaw", velocities, "N m") for j in JOINTS]
    command = [Field(f"cmd_{j}", "rad", "position", "body", j, "yaw") for j in JOINTS]
    return Schema((*position, *velocity), tuple(command))


def _term(effect: str, where: str, joints: tuple[str, ...], constant: str, high: float, start: float) -> Term:
    outputs = tuple(f"{j}_pos" for j in joints) + tuple(f"{j}_vel" for j in joints)
    channels = tuple(f"cmd_{j}" for j in joints)
    unit = "N m" if effect == "coulomb_friction" else "-"
    return Term(effect, where, outputs, channels, constant, unit, 0.0, high, (start,), f"{effect} of {{{constant}}}")


@dataclass(frozen=True)
class Servos:
    """parameters: logarithms of the shares of KP and DAMPING. substeps: of a row; a finer engine is another robot."""

    velocities: bool = True
    substeps: int = 10
    time_step: float = 0.02
    parts: int = 5

    @cached_property
    def schema(self) -> Schema:
        return schema(self.velocities)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        names = [f"kp {j}" for j in JOINTS] + [f"damping {j}" for j in JOINTS]
        return tuple(Parameter(name, "-", -1.1, 1.1, 0.0) for name in names)

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        friction = [_term("coulomb_friction", j, (j,), "friction", 5.0, 0.05) for j in JOINTS]
        return (*friction, _term("joint_gravity", "all", JOINTS, "share", 1.5, 0.1))

    def rows(self, phi, terms, state, command, effort):
        kp, damping = KP * np.exp(phi[:2]), DAMPING * np.exp(phi[2:])
        q, v, h = state[:, :2], state[:, 2:], self.time_step / self.substeps
        for i in range(self.substeps):
            target = command[:, i * command.shape[1] // self.substeps]
            q = q + h / 2 * v
            force = kp * (target - q) - (1 - terms[:, 2:3]) * WEIGHT * np.sin(q) + effort
            # Damping as it is on average, so that the error is of second order in the step.
            v = (v * (1 - damping * h / INERTIA / 2) + h * force / INERTIA) / (1 + damping * h / INERTIA / 2)
            v = v - np.clip(v, -h * terms[:, :2] / INERTIA, h * terms[:, :2] / INERTIA)
            q = q + h / 2 * v
        return np.hstack([q, v])


class Push(NamedTuple):
    """A load on the shoulder [N m], in all rows of all sessions, or in some rows of one."""

    load: float = 0.0
    session: int | None = None
    rows: range = range(0)

    def acts(self, session: int, row: int) -> bool:
        return self.session is None or (session == self.session and row in self.rows)


def recorded(
    terms: tuple[float, ...] = (0.0, 0.0, 0.0),
    phi: tuple[float, ...] = (0.0,) * 4,
    velocities: bool = True,
    late_s: float = 0.0,
    sessions: int = 6,
    rows: int = 300,
    seed: int = 0,
    pushed: Push = Push(),  # noqa: B008
) -> list[Recording]:
    """Sessions of a robot of finer steps, with encoder noise of 0.35 mrad; commands act `late_s` after being sent."""
    rng = np.random.default_rng(seed)
    robot = Servos(substeps=40, parts=40)
    found = []
    for s in range(sessions):
        t = np.arange(rows) * robot.time_step
        waves = [(rng.uniform(0.1, 0.5, 2), rng.uniform(0.2, 1.5, 2), rng.uniform(0, 6.28, 2)) for _ in range(4)]
        u = sum(a * np.sin(2 * np.pi * f * t[:, None] + p) for a, f, p in waves)
        u = u + 0.5 * np.sign(np.sin(2 * np.pi * rng.uniform(0.2, 0.5, 2) * t[:, None]))
        x, states = np.concatenate([u[0], [0.0, 0.0]]), []
        fine = (np.arange(rows)[:, None] + np.arange(40) / 40 - late_s / robot.time_step + 1e-9).clip(0).astype(int)
        for row in range(rows):
            states.append(x)
            effort = np.array([[pushed.load if pushed.acts(s, row) else 0.0, 0.0]])
            x = robot.rows(np.array(phi), np.array([terms]), x[None], u[fine[row]][None], effort)[0]
        y = np.array(states)
        noise = rng.normal(size=y.shape) * np.array([3.5e-4] * 2 + [0.02] * 2)
        measured = (y + noise)[:, : 4 if velocities else 2]
        found.append(Recording(f"s{s}", t, measured, u))
    return found
