"""One case of a machine: what was recorded of it, its user's simulator, and the key."""

from typing import Any, NamedTuple

import numpy as np

from concealed.effect import constants_of, of_cause
from concealed.form import Array
from concealed.kinds.causes import CAUSES
from concealed.kinds.robots import KINDS, Kind
from concealed.kinds.session import PLAIN, chance, record
from concealed.kinds.strength import strength

LEVELS = (0.5, 1.5)
"""Noise of a case, as a share of what is usual, from and to."""


class Recipe(NamedTuple):
    """What a case is to be. kind: of KINDS. cause: of CAUSES, or nothing."""

    kind: str
    cause: str | None


class Case(NamedTuple):
    """machine: of whose kind it is. measured [S, T, s] and commanded [S, T, u], and the key."""

    machine: Kind
    measured: Array
    command: Array
    key: dict[str, Any]


def conceal(recipe: Recipe, sessions: int, rows: int, seed: int) -> Case:
    """The case of a recipe; equal arguments give equal cases. Machine, goals and noise do not depend on the cause."""
    build, person, amount = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3))
    of = KINDS[recipe.kind]
    p, level = build.uniform(of.low, of.high), float(build.uniform(*LEVELS))
    luck = chance(of, sessions, rows, person)
    recorded = record(of, p, PLAIN, luck, level)
    effects: list[dict[str, Any]] = []
    kind, verdicts, nats = "null", ["nothing", "parameters_only"], 0.0
    if recipe.cause is not None:
        cause = CAUSES[recipe.cause]
        drawn = cause.draw(of, recorded.command, amount)
        recorded = record(of, p, drawn.traits, luck, level)
        nats = strength(of, p, drawn.traits, recorded, level)
        effects = [of_cause(recipe.cause, cause.accept, cause.why, drawn.channels, constants_of(drawn.constant))]
        kind, verdicts = ("single", ["missing_physics"]) if cause.accept else ("outside", ["unexplained"])
    key = {
        "kind": kind, "cause": recipe.cause, "when": None, "target": 0.0, "strength": nats,
        "effects": effects, "verdicts": verdicts, "seed": seed,
        "recipe": {"size": recipe.kind, "poor": False, "level": level, "outliers": False, "wild": False},
    }  # fmt: skip
    measured, command = (np.ascontiguousarray(np.swapaxes(a, 0, 1)) for a in recorded)
    return Case(of, measured, command, key)
