"""Suites of cases: what is in them, in an order and under names that tell nothing."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from concealed.case import LEVELS, Recipe
from concealed.catalogue import FORMS, OUTSIDE

DUELS = (
    ("delay", "lag"),
    ("saturation", "quadratic_drag"),
    ("deadband", "coulomb_friction"),
    ("backlash", "delay"),
    ("slope", "body_frame_bias"),
    ("rotation_centre", "centripetal"),
    ("rate_limit", "lag"),
)
"""Effects that are easily taken for each other."""
LOCAL = ("gain", "coulomb_friction", "deadband", "quadratic_drag", "cross_axis_coupling", "body_frame_bias", "lag",
         "frame_misalignment", "slip", "gravity_sag")  # fmt: skip
"""What may act in a regime only, or from a time on only."""
MIXED = ("delay", "lag", "saturation", "deadband", "backlash", "gain", "asymmetric_gain", "coulomb_friction",
         "quadratic_drag", "gravity_sag", "cross_axis_coupling", "rotation_centre", "slip", "slope", "body_frame_bias",
         "integration_rule", "sensor_delay", "relative_smoothing", "arm_base_coupling", "reach_limit")  # fmt: skip
"""What may come together with others."""


@dataclass(frozen=True)
class Config:
    """How many cases of each kind. strengths: in nats, one case of every effect each. parts: of the suite."""

    nulls: int
    effects: tuple[str, ...]
    strengths: tuple[float, ...]
    duel_strengths: tuple[float, ...]
    pairs: int
    triples: int
    regimes: int
    onsets: int
    outside_strengths: tuple[float, ...]
    parts: int
    few: float
    poor: float
    glitches: float


class Odds:
    """What cuts across all kinds, drawn alike for each: size, noise, excitation, glitches."""

    def __init__(self, config: Config, rng: np.random.Generator, harder: bool) -> None:
        self._config, self._rng, self._harder = config, rng, harder

    def recipe(
        self, kind: str, names: Sequence[str] = (), target: float = 0.0, wild: bool = False, one_session: bool = False
    ) -> Recipe:
        c, rng = self._config, self._rng
        size = "few" if rng.uniform() < c.few else "usual"
        level, poor = float(rng.choice(LEVELS)), bool(rng.uniform() < c.poor)
        outliers = bool(rng.uniform() < c.glitches)
        if self._harder:  # other strengths as well
            target *= float(np.exp(rng.uniform(-0.2, 0.2)))
        return Recipe(kind, tuple(names), target, size, level, poor, outliers, wild, one_session, self._harder)


def recipes(config: Config, harder: bool, rng: np.random.Generator) -> list[list[Recipe]]:
    """The recipes in parts, each of which is a stratified sample of the suite in a random order."""
    odds = Odds(config, rng, harder)
    kinds: list[list[Recipe]] = [[odds.recipe("null", wild=i % 4 == 3) for i in range(config.nulls)]]
    kinds.append([odds.recipe("single", (e,), s) for s in config.strengths for e in config.effects])
    kinds.append([odds.recipe("duel", (d[k],), s) for d in DUELS for k in (0, 1) for s in config.duel_strengths])
    for kind, count, many in (("pair", config.pairs, 2), ("triple", config.triples, 3)):
        kinds.append(
            [odds.recipe(kind, [str(e) for e in rng.choice(MIXED, many, replace=False)], 100.0) for _ in range(count)]
        )
    local = lambda i: (LOCAL[i % len(LOCAL)],)  # noqa: E731
    kinds.append([odds.recipe("regime", local(i), 100.0) for i in range(config.regimes)])
    kinds.append([odds.recipe("onset", local(i), 100.0, one_session=i % 2 == 1) for i in range(config.onsets)])
    kinds.append([odds.recipe("outside", (name,), s) for s in config.outside_strengths for name in OUTSIDE])
    parts: list[list[Recipe]] = [[] for _ in range(config.parts)]
    # Every kind is dealt out from where the last ended, so that parts differ by one case at most.
    place = 0
    for kind in kinds:
        for i in rng.permutation(len(kind)):
            parts[place % config.parts].append(kind[i])
            place += 1
    return [[part[i] for i in rng.permutation(len(part))] for part in parts]


def names(count: int, rng: np.random.Generator) -> list[str]:
    """As many different random names of one length."""
    found: dict[str, None] = {}
    while len(found) < count:
        found[f"{rng.integers(16**8):08x}"] = None
    return list(found)


def known(effects: Sequence[str]) -> None:
    """Raise ValueError for an id that is not concealed."""
    missing = [e for e in effects if e not in FORMS]
    if missing:
        raise ValueError(f"no form of {', '.join(missing)}; there are {', '.join(FORMS)}")
