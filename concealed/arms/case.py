"""One case of an arm: the model that its user has, what was recorded of it, and the key."""

from typing import Any, NamedTuple

import numpy as np

from concealed.arms import design
from concealed.arms.causes import CAUSES, Drawn, effects_of
from concealed.arms.operator import commands
from concealed.arms.robot import FINE, ROW, Arm, Session, plain
from concealed.form import Array
from concealed.sessions import Columns, every_fourth

INTERVAL = ROW * FINE
"""Between rows, as the time stamps say [s]."""
POSITION, VELOCITY = 3.5e-4, 5e-3
"""Usual noise of encoders [rad, rad/s]; a case has between half and one and a half of it."""
HELD_OUT = 0.25
"""Share of the sessions that are held out."""


class Recipe(NamedTuple):
    """What a case is to be. cause: of CAUSES, or nothing. joints: three or six. speeds: whether they are recorded."""

    cause: str | None
    joints: int
    speeds: bool


class Case(NamedTuple):
    """model: MJCF of the user. columns: what is recorded. measured [S, T, s] and commanded [S, T, J], and the key."""

    model: str
    columns: Columns
    measured: Array
    command: Array
    key: dict[str, Any]


def conceal(recipe: Recipe, sessions: int, rows: int, seed: int) -> Case:
    """The case of a recipe; equal arguments give equal cases. Model and commands do not depend on the cause."""
    build, person, amount, luck = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4))
    of = design.draw(recipe.joints, build)
    sent = np.stack([commands(recipe.joints, rows, INTERVAL, person) for _ in range(sessions)])
    level = float(luck.uniform(0.5, 1.5))
    drawn = Drawn(plain(of)) if recipe.cause is None else CAUSES[recipe.cause].draw(of, sent, amount)
    arm = Arm(of, drawn.traits)
    runs = [arm.run(command) for command in sent]
    columns, noise = _columns(of, recipe.speeds), level * np.repeat([POSITION, VELOCITY], recipe.joints)
    noise = noise[: len(columns.state)]
    true = np.stack([_recorded(run, recipe.speeds) for run in runs])
    key = {
        "kind": "null" if recipe.cause is None else CAUSES[recipe.cause].kind, "cause": recipe.cause, "when": None,
        "target": 0.0, "strength": 0.0 if recipe.cause is None else _strength(of, sent, true, noise),
        "effects": [] if recipe.cause is None else effects_of(recipe.cause, drawn), "parameter": drawn.wrong,
        "verdicts": _verdicts(recipe.cause), "floor": level * POSITION, "seed": seed,
        "recipe": {
            "size": f"{recipe.joints} joints, {'velocities' if recipe.speeds else 'positions only'}",
            "poor": False, "level": level, "outliers": False, "wild": False,
        },
    }  # fmt: skip
    return Case(design.model(of), columns, true + noise * luck.normal(size=true.shape), sent, key)


def _columns(of: design.Design, speeds: bool) -> Columns:
    state = [f"{name}_{what}" for what in ("pos", "vel")[: 1 + speeds] for name in of.joints]
    return Columns(tuple(state), tuple(f"cmd_{name}" for name in of.joints), INTERVAL)


def _recorded(run: Session, speeds: bool) -> Array:
    return np.concatenate([run.angle, run.speed], axis=1) if speeds else run.angle


def _strength(of: design.Design, sent: Array, true: Array, noise: Array) -> float:
    """How far the recordings are from those of the user's model, in nats on held-out sessions: half the squared
    distance in the noise's variances. No parameter is refitted, so that no true form could gain more."""
    some = every_fourth(len(sent))
    arm = Arm(of, plain(of))
    without = np.stack([_recorded(arm.run(sent[s]), true.shape[2] > sent.shape[2]) for s in some])
    return HELD_OUT * len(sent) / len(some) * 0.5 * float((((true[some] - without) / noise) ** 2).sum())


def _verdicts(cause: str | None) -> list[str]:
    """Verdicts that are right."""
    if cause is None:
        return ["nothing", "parameters_only"]
    return ["parameters_only"] if CAUSES[cause].kind == "parameters" else ["missing_physics"]
