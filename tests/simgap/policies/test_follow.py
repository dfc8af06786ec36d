"""Following references: shapes in closed form, errors by hand, collisions, clipping, and any robot by the protocol."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from tiny_policies import LIMIT

from simgap.policies import references
from simgap.policies.bounds import Bounds
from simgap.policies.follow import Run, collision, follow, mean_error
from simgap.policies.proportional import Proportional
from simgap.robots.virtual_robot import VirtualRobot
from simgap.robots.virtual_spot import VirtualSpotConfig
from simgap.simulators.spot import from_body
from simgap.types import Robot

BOUNDS = Bounds(shoulder=(0.29, 0.0, 0.65), reach=1.1, clearance=0.05, body_low=(-0.55, -0.25, 0.0),
                body_high=(0.45, 0.25, 0.75), look_ahead=0.3)  # fmt: skip
ELLIPSE = references.ellipse(references.Ellipse((0.5, 0.7, 0.1), period=6.0, rounds=1.0), 0.1)


def test_the_ellipse_is_one() -> None:
    x, y, z = (ELLIPSE / np.array([0.5, 0.7, 0.1])).T
    np.testing.assert_allclose(x**2 + y**2, 1.0)
    np.testing.assert_allclose(x, z)
    assert len(ELLIPSE) == 60
    np.testing.assert_allclose(ELLIPSE[0], [0.5, 0.0, 0.1])
    np.testing.assert_allclose(ELLIPSE[15], [0.0, 0.7, 0.0], atol=1e-12)


def test_the_helix_advances_by_its_pitch_a_turn() -> None:
    goals = references.helix(references.Helix(radius=0.2, advance=0.3, period=5.0, turns=2.0), 0.1)
    np.testing.assert_allclose(np.hypot(goals[:, 1], goals[:, 2]), 0.2)
    np.testing.assert_allclose(goals[50] - goals[0], [0.3, 0.0, 0.0], atol=1e-12)
    assert len(goals) == 100


def test_mean_error_by_hand() -> None:
    states, goals = np.zeros((2, 12)), np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 1.0]])
    assert mean_error(Run(states, np.zeros((2, 6)), goals, "")) == pytest.approx(3.0)
    assert np.isnan(mean_error(Run(states[:0], np.zeros((0, 6)), goals[:0], "body")))


@pytest.mark.parametrize(
    ("hand", "velocity", "expected"),
    [
        ((0.85, 0.0, 0.6), (0.0, 0.0, 0.0), ""),
        ((0.55, 0.0, 0.6), (-0.5, 0.0, 0.0), "body"),
        ((0.55, 0.0, 0.6), (0.5, 0.0, 0.0), ""),
        ((0.55, 0.0, 0.9), (-0.5, 0.0, 0.0), ""),  # above the body
        ((0.85, 0.0, 0.2), (0.0, 0.0, -0.6), "ground"),
        ((1.3, 0.0, 0.65), (0.5, 0.0, 0.0), "reach"),
        ((1.3, 0.0, 0.65), (-0.5, 0.0, 0.0), ""),
    ],
)
def test_what_a_hand_is_on_course_for(
    hand: tuple[float, float, float], velocity: tuple[float, float, float], expected: str
) -> None:
    """Whatever the base does, and wherever it is: only the hand's motion relative to it counts."""
    for pose, base in (((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), ((2.0, -1.0, 2.5), (0.5, -0.4, 0.8))):
        carried = np.array([base[0] - base[2] * hand[1], base[1] + base[2] * hand[0], 0.0])
        body = jnp.array([*pose, *base, *hand, *(np.array(velocity) + carried)])
        assert collision(np.asarray(from_body(body)), BOUNDS) == expected


class Recorder:
    """A robot that does as it is told, at once, and notes it: the protocol is all that `follow` needs."""

    time_step = 0.1

    def __init__(self) -> None:
        self.calls: list[str] = []

    def reset(self) -> None:
        self.calls.append("reset")
        self.hand = np.array([0.85, 0.0, 0.6])

    def observe(self) -> np.ndarray:
        return np.concatenate([np.zeros(6), self.hand, np.zeros(3)])

    def command(self, command: np.ndarray) -> np.ndarray:
        admitted = np.clip(command, -0.5, 0.5)
        self.hand = self.hand + 0.1 * admitted[3:]
        self.calls.append("command")
        return admitted

    def stop(self) -> None:
        self.calls.append("stop")


class Fixed:
    """A policy that wants the same, and notes what it is told of the past."""

    def __init__(self, wanted: Array) -> None:
        self.wanted = wanted

    def command(self, state: Array, past: Array, goal: Array) -> Array:  # noqa: ARG002
        return self.wanted.at[0].set(past[0, 3])


jax.tree_util.register_pytree_node(Fixed, lambda f: ((f.wanted,), None), lambda _, leaves: Fixed(*leaves))


def test_any_robot_is_followed_stopped_and_told_what_it_admits() -> None:
    robot: Robot = Recorder()
    run = follow(robot, Fixed(jnp.array([0.0, 0.0, 0.0, 0.9, 0.0, 0.0])), np.zeros((4, 3)), BOUNDS)
    assert robot.calls == ["reset", *["command"] * 4, "stop"]  # type: ignore[attr-defined]
    np.testing.assert_allclose(run.commands[:, 3], 0.5)
    # u_{t-2} as admitted, not as wanted: none at first.
    np.testing.assert_allclose(run.commands[:, 0], [0.0, 0.0, 0.5, 0.5])
    np.testing.assert_allclose(mean_error(run), np.mean([0.0, 0.05, 0.1, 0.15]), atol=1e-6)
    stopped = follow(robot, Fixed(jnp.array([0.0, 0.0, 0.0, 0.9, 0.0, 0.0])), np.zeros((40, 3)), BOUNDS)
    assert stopped.stopped == "reach"
    assert 5 < len(stopped.states) == len(stopped.goals) < 40


def test_a_robot_is_stopped_when_its_policy_fails() -> None:
    robot = Recorder()

    class Broken(Fixed):
        def command(self, state: Array, past: Array, goal: Array) -> Array:  # noqa: ARG002
            raise FloatingPointError

    jax.tree_util.register_pytree_node(Broken, lambda f: ((f.wanted,), None), lambda _, leaves: Broken(*leaves))
    with pytest.raises(FloatingPointError):
        follow(robot, Broken(jnp.zeros(6)), np.zeros((4, 3)), BOUNDS)
    assert robot.calls[-1] == "stop"


def test_the_virtual_robot_repeats_itself_and_clips() -> None:
    robot = VirtualRobot(jax.random.key(0), VirtualSpotConfig(), LIMIT)
    policy = Proportional(jnp.float32(1.5), jnp.float32(0.5), jnp.array([0.85, 0.0, 0.6]))
    first, second = (follow(robot, policy, ELLIPSE, BOUNDS) for _ in range(2))
    np.testing.assert_array_equal(first.states, second.states)
    assert not first.stopped
    assert 0.05 < mean_error(first) < 0.6
    np.testing.assert_array_equal(robot.command(np.full(6, 9.0)), LIMIT)
