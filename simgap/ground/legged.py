"""Kinds of missing physics that only a legged base with an arm has, each in a form that the vocabulary lacks.

Velocities v and commands u are the base's (x, y, yaw), then the hand's (x, y, z), in units of usual ones, in the
robot's own frame; places q are the base's in the world, then the hand's from its home.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from simgap.ground.family import Family, named
from simgap.ground.laws import Law, Push
from simgap.ground.spot import HOME

PLANE, HAND, HEIGHT = (0, 1), (3, 4), (5,)
"""Horizontal axes of the base and of the hand, and the hand's vertical one."""
Pushes = Callable[[Any, Any, Any], Any]


def _along(axes: tuple[int, ...], law: Pushes) -> Law:
    """A push along these axes alone."""

    def push(q: Any, v: Float[np.ndarray, " 6"], u: Any) -> Float[np.ndarray, " 6"]:
        pushed = np.zeros(6)
        pushed[list(axes)] = law(q, v, u)
        return pushed

    return Push(push)


def _arm(q: Any) -> Float[np.ndarray, " 2"]:
    """The hand's horizontal place from the base's origin [m]."""
    return q[3:5] + HOME[:2]


def _to_the_left(arm: Any) -> Float[np.ndarray, " 2"]:
    return np.array([-arm[1], arm[0]])


def _slipping(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    """Feet lose ground when the base turns."""
    power = rng.uniform(0.7, 1.4)
    return _along(PLANE, lambda q, v, u: -size * rate * np.abs(v[2]) ** power * v[:2])  # noqa: ARG005


def _sagging(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    """The farther out the hand is, the faster it sinks."""
    power = rng.uniform(0.8, 1.5)
    return _along(HEIGHT, lambda q, v, u: -2 * size * rate * np.hypot(*_arm(q)) ** power)  # noqa: ARG005


def _tilted(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    """Walking on tilted ground, the base is pulled along it."""
    towards, power = rng.uniform(0, 2 * np.pi), rng.uniform(0.7, 1.3)

    def pull(q: Any, v: Any, u: Any) -> Any:  # noqa: ARG001
        away = towards - q[2]
        return size * rate * np.hypot(v[0], v[1]) ** power * np.array([np.cos(away), np.sin(away)])

    return _along(PLANE, pull)


def _off_centre(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    """The base turns about a point that is not its origin, and that moves a little with the speed."""
    where, moves = rng.uniform(0, 2 * np.pi), rng.uniform(0, 0.3)
    centre = size * np.array([np.cos(where), np.sin(where)])
    return _along(PLANE, lambda q, v, u: -rate * (1 + moves * v[0]) * v[2] * _to_the_left(centre))  # noqa: ARG005


def _out_of_reach(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    """Beyond its reach the hand follows outward commands less and less."""
    reach, soft = rng.uniform(0.75, 1.05), rng.uniform(0.01, 0.06)

    def lost(q: Any, v: Any, u: Any) -> Any:  # noqa: ARG001
        out = _arm(q) / np.hypot(*_arm(q))
        beyond = (1 + np.tanh((np.hypot(*_arm(q)) - reach) / soft)) / 2
        return -min(4 * size, 1.0) * rate * beyond * max(u[3:5] @ out, 0.0) * out

    return _along(HAND, lost)


def _carried(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    """A turning base carries the arm along further, or less far."""
    sign, power = rng.choice([-1, 1]), rng.uniform(0.8, 1.2)
    turning = lambda v: np.sign(v[2]) * np.abs(v[2]) ** power  # noqa: E731
    return _along(HAND, lambda q, v, u: sign * size * rate * turning(v) * _to_the_left(_arm(q)))  # noqa: ARG005


def _thrown(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    """Turning throws the arm outwards."""
    power = rng.uniform(1.6, 2.4)
    return _along(HAND, lambda q, v, u: size * rate * np.abs(v[2]) ** power * _arm(q))  # noqa: ARG005


def _reaction(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    """The base gives way to an arm that speeds up, and a little to one that moves."""
    steady = rng.uniform(0, 0.2)
    return _along(PLANE, lambda q, v, u: -size * rate * (u[3:5] - (1 - steady) * v[3:5]))  # noqa: ARG005


def _left_behind(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    """The hand stays behind a base that speeds up."""
    steady = rng.uniform(0, 0.2)
    return _along(HAND, lambda q, v, u: -size * rate * (u[:2] - (1 - steady) * v[:2]))  # noqa: ARG005


def _floor(rng: np.random.Generator, size: float, row: float, rate: float) -> Law:  # noqa: ARG001
    """What the hand meets below gives way, as a spring."""
    below = rng.uniform(-0.2, 0.1)
    return _along(HEIGHT, lambda q, v, u: 10 * size * rate * max(below - q[5], 0.0))  # noqa: ARG005


def _family(
    effect: str, draw: Callable[[np.random.Generator, float, float, float], Law], axes: tuple[int, ...]
) -> Family:
    return Family(named(effect), draw, ("spot",), axes)


LEGGED = {
    "slipping": _family("slip", _slipping, PLANE),
    "sagging": _family("gravity_sag", _sagging, HEIGHT),
    "tilted": _family("slope", _tilted, PLANE),
    "off_centre": _family("rotation_centre", _off_centre, PLANE),
    "out_of_reach": _family("reach_limit", _out_of_reach, HAND),
    "carried": _family("induced_velocity", _carried, HAND),
    "thrown": _family("centripetal", _thrown, HAND),
    "reaction": _family("arm_base_coupling", _reaction, PLANE),
    "left_behind": _family("base_arm_coupling", _left_behind, HAND),
    "floor": _family("ground_contact", _floor, HEIGHT),
}
