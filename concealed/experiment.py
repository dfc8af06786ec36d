"""The robot of a case once more, under commands that somebody prescribes: an experiment after the recordings."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from concealed.case import Recipe, features, first, noise_of
from concealed.catalogue import make_all
from concealed.form import Array, Size
from concealed.plain import robot
from concealed.robot import Chance, Gate, Setting, run

STILL = 10
"""Rows at rest before the commands begin."""


def experiment(key: Mapping[str, Any], command: Array, repeats: int, seed: int) -> tuple[Array, Array]:
    """Measured states [R, T, 12] and commands [R, T, 6] of R runs from rest, each somewhere else in the room.

    command: [T', 6], sent after `STILL` rows of rest. The effects are those of the key, at its magnitudes: what began
    during the recordings still acts, and what acts in a regime acts there. The noise is drawn anew.
    """
    recipe = Recipe(**{**key["recipe"], "names": tuple(key["recipe"]["names"])})
    # The stream from which the case drew its effects; see `concealed.case.conceal`.
    form_rng = np.random.default_rng(np.random.SeedSequence(key["seed"]).spawn(7)[2])
    forms, place, luck, noise = (make_all(recipe.names, recipe.harder, form_rng), *np.random.default_rng(seed).spawn(3))
    sent = np.concatenate([np.zeros((STILL, 6)), command])
    size = Size(repeats, 1, len(sent))
    for form in forms:
        form.begin(size, luck)
    shape = (size.batch, size.rows, 12)
    chance = Chance(noise.normal(size=shape), noise.normal(size=shape), np.zeros(shape))
    many = robot(np.repeat(np.array(key["parameters"])[None], size.batch, axis=0))
    operate = lambda t, seen: np.repeat(sent[t][None], len(seen), axis=0)  # noqa: E731
    setting = Setting(many, operate, first(place, repeats), noise_of(recipe.level), chance, size)
    magnitude = np.repeat(np.array([[effect["magnitude"] for effect in key["effects"]]]), size.batch, axis=0)
    tape = run(setting, forms, magnitude, _gate(key))
    return tape.measured, tape.command


def _gate(key: Mapping[str, Any]) -> Gate | None:
    """Where the effects act now."""
    rule = (key["when"] or {}).get("regime")
    if rule is None:
        return None
    name, edge = rule.rsplit(" ", 1)[0].split(" > ")
    return lambda _, x, u: (features(x, u)[name] > float(edge)).astype(float)
