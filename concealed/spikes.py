"""Effects put into recordings of a real robot afterwards: what was recorded of its commands, or of its motion, is
changed just as it would have been recorded, had the robot had the effect."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from concealed.effect import of_cause
from concealed.form import Array
from concealed.plain import TIME_STEP
from concealed.strength import of_change

Pair = tuple[Array, Array]
"""States [T, 12] and commands [T, 6] of a session."""


class Spike(NamedTuple):
    """Changes a session; the words that are right, and why."""

    apply: Callable[[Array, Array], Pair]
    accept: tuple[str, ...]
    why: str
    constants: list[dict[str, Any]]


def _earlier(rows: int, on: slice) -> Callable[[Array, Array], Pair]:
    def apply(x: Array, u: Array) -> Pair:
        sent = u.copy()
        sent[:-rows, on] = u[rows:, on]
        return x[:-rows], sent[:-rows]

    return apply


def _scaled(factor: float, on: int) -> Callable[[Array, Array], Pair]:
    def apply(x: Array, u: Array) -> Pair:
        sent = u.copy()
        sent[:, on] /= factor
        return x, sent

    return apply


def _one_way(factor: float, on: int) -> Callable[[Array, Array], Pair]:
    def apply(x: Array, u: Array) -> Pair:
        sent = u.copy()
        sent[:, on] = np.where(u[:, on] < 0, u[:, on] / factor, u[:, on])
        return x, sent

    return apply


def _clipped(limit: float, on: int) -> Callable[[Array, Array], Pair]:
    """What went beyond the limit is recorded as sent with three times what it was beyond: hardly followed there."""

    def apply(x: Array, u: Array) -> Pair:
        sent, beyond = u.copy(), np.maximum(np.abs(u[:, on]) - limit, 0.0)
        sent[:, on] += np.sign(u[:, on]) * 3.0 * beyond
        return x, sent

    return apply


def _turned(angle: float, first: int) -> Callable[[Array, Array], Pair]:
    def apply(x: Array, u: Array) -> Pair:
        sent = u.copy()
        c, s = np.cos(angle), np.sin(angle)
        sent[:, first] = c * u[:, first] + s * u[:, first + 1]
        sent[:, first + 1] = -s * u[:, first] + c * u[:, first + 1]
        return x, sent

    return apply


def _sagging(sink: float) -> Callable[[Array, Array], Pair]:
    def apply(x: Array, u: Array) -> Pair:
        x = x.copy()
        rate = sink * np.hypot(x[:, 6] - x[:, 0], x[:, 7] - x[:, 1])
        x[:, 11] -= rate
        x[:, 8] -= np.concatenate([[0.0], np.cumsum(rate[1:])]) * TIME_STEP
        return x, u

    return apply


def _scaled_sensor(scale: float, on: int) -> Callable[[Array, Array], Pair]:
    def apply(x: Array, u: Array) -> Pair:
        x = x.copy()
        x[:, on] *= scale
        return x, u

    return apply


BASE, HAND = slice(0, 3), slice(3, 6)
LATEST = 2
"""Rows that the latest commands cost a session."""


def _constant(name: str, value: float, unit: str) -> list[dict[str, Any]]:
    return [{"name": name, "value": value, "unit": unit}]


SPIKES = {
    "base commands late by a row": Spike(_earlier(1, BASE), ("delay", "lag"), "commands are recorded a row before",
                                         _constant("delay", TIME_STEP, "s")),
    "base commands late by two rows": Spike(_earlier(2, BASE), ("delay",), "commands are recorded two rows before",
                                            _constant("delay", 2 * TIME_STEP, "s")),
    "hand commands late by two rows": Spike(_earlier(2, HAND), ("delay",), "commands are recorded two rows before",
                                            _constant("delay", 2 * TIME_STEP, "s")),
    "walks with 0.7 of the command": Spike(_scaled(0.7, 0), ("gain", "viscous_drag"), "as `gain`",
                                           _constant("gain", 0.7, "-")),
    "turns with 0.8 of the command": Spike(_scaled(0.8, 2), ("gain", "viscous_drag"), "as `gain`",
                                           _constant("gain", 0.8, "-")),
    "walks backwards with 0.6 of the command": Spike(_one_way(0.6, 0), ("asymmetric_gain",), "one way only",
                                                     _constant("ratio", 0.6, "-")),
    "turning hardly followed beyond 0.3 rad/s": Spike(_clipped(0.3, 2), ("saturation", "quadratic_drag"),
                                                      "beyond the limit a quarter of the command is left",
                                                      _constant("limit", 0.3, "rad/s")),
    "base commands turned by 0.2 rad": Spike(_turned(0.2, 0), ("frame_misalignment", "cross_axis_coupling"),
                                             "what leaks across by its angle", _constant("angle", 0.2, "rad")),
    "the arm sinks": Spike(_sagging(0.08), ("gravity_sag", "payload"), "in proportion to the reach",
                           _constant("sink", 0.08, "1/s")),
    "yaw rate measured at 0.8": Spike(_scaled_sensor(0.8, 5), ("sensor_scale", "gain"),
                                      "or the command is followed less", _constant("scale", 0.8, "-")),
}  # fmt: skip
"""By what a person would say."""


def conceal(name: str | None, before: list[Pair], after: list[Pair]) -> tuple[list[Pair], dict[str, Any]]:
    """The sessions after, with a spike in each or as they are; and the key. All sessions of one length."""
    spike, effects = SPIKES.get(name or ""), []
    if spike is not None:
        effects = [of_cause(str(name), spike.accept, spike.why, constants=spike.constants)]
        after = [spike.apply(*pair) for pair in after]
    # Of one length whatever was done to them.
    rows = min(len(x) for x, _ in before) - LATEST
    after = [(x[:rows], u[:rows]) for x, u in after]
    stack = lambda pairs: (np.stack([x for x, _ in pairs]), np.stack([u for _, u in pairs]))  # noqa: E731
    key = {
        "kind": "real" if effects else "null", "effects": effects, "when": None, "target": 0.0,
        "strength": of_change(*stack(before), *stack(after)),
        "verdicts": ["missing_physics"] if effects else ["nothing", "parameters_only"],
        "recipe": {"size": "usual", "poor": False, "level": 1.0, "outliers": False, "wild": False},
    }  # fmt: skip
    return after, key
