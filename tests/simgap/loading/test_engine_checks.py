"""Engines of one's own: what passes, and what is said of each mistake."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from simgap.engines import Term
from simgap.loading.checks import check
from simgap.types import ConfigError, Field, Parameter, Schema

TERM = Term("coulomb_friction", "a", ("a_vel",), (), "loss", "N m", 0.0, 1.0, (0.1,), "friction of {loss}")


FIELDS = Schema(
    (Field("a_pos", "rad", "position", "body", "a", "yaw"),
     Field("a_vel", "rad/s", "velocity", "body", "a", "yaw", observed=False, effort="N m")),
    (Field("cmd_a", "N m", "force", "body", "a", "yaw"),),
)  # fmt: skip


@dataclass(frozen=True)
class Wheel:
    """A wheel that a torque speeds up; its speed has no column."""

    schema: Schema = FIELDS
    parameters: tuple[Parameter, ...] = (Parameter("inertia", "-", -1.0, 1.0, 0.0),)
    time_step: float = 0.02
    parts: Any = 2
    terms: tuple[Term, ...] = (TERM,)
    wrong: str = ""

    def rows(self, phi: Any, terms: Any, state: Any, command: Any, effort: Any) -> Any:
        force = command.mean(1)[:, 0] + effort[:, 0] - terms[:, 0] * np.sign(state[:, 1])
        after = state[:, 1] + self.time_step * force / np.exp(phi[0])
        if self.wrong == "neighbours":
            after = after + np.arange(len(after))
        if self.wrong == "infinite":
            after = after / np.zeros(1)
        found = np.stack([state[:, 0] + self.time_step * after, after], axis=1)
        if self.wrong == "error":
            raise IndexError("no such row")
        return {"shape": found.T[:1], "single": found.astype(np.float32)}.get(self.wrong, found)


def test_an_engine_passes() -> None:
    check(Wheel(), "mine:WHEEL")


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"wrong": "neighbours"}, "a row must not depend on the other rows"),
        ({"wrong": "infinite"}, "rows must be finite at nominal parameters"),
        ({"wrong": "shape"}, r"shape \(2, 2\) in double precision; it returned shape \(1, 2\)"),
        ({"wrong": "single"}, "of float32"),
        ({"wrong": "error"}, "it gave IndexError: no such row"),
        ({"parts": 0}, "parts must be a whole number from 1 on; it is 0"),
        ({"terms": (replace(TERM, starts=(2.0,)),)}, "term coulomb_friction on a: low < high must be finite"),
        ({"terms": [TERM]}, "terms must be a tuple of Term"),
        ({"schema": Schema(FIELDS.state[::-1], FIELDS.command)}, "must come last in schema.state"),
    ],
)
def test_a_mistake_is_named(changed: dict[str, Any], words: str) -> None:
    with np.errstate(all="ignore"), pytest.raises(ConfigError, match=f"mine:WHEEL: .*{words}"):
        check(Wheel(**changed), "mine:WHEEL") if "terms" not in changed else check(_Unhashed(**changed), "mine:WHEEL")


class _Unhashed(Wheel):
    """A wheel that may hold a list."""

    __hash__ = object.__hash__


def test_what_lacks_a_member_is_named() -> None:
    class Bare:
        rows = None

    with pytest.raises(ConfigError, match="must have schema, parameters, time_step, parts, terms, rows; Bare lacks"):
        check(Bare(), "mine:BARE")
