"""The suite of arms: what is in it, dealt out so that every part has each cause, both arms and both ways to record."""

from collections.abc import Sequence

import numpy as np

from concealed.arms.case import Recipe
from concealed.arms.causes import CAUSES
from concealed.arms.design import JOINTS


def recipes(
    nulls: int, repeats: int, causes: Sequence[str], parts: int, rng: np.random.Generator
) -> list[list[Recipe]]:
    """The recipes in parts, each of which is a stratified sample of the suite in a random order.

    nulls: cases without a cause. repeats: cases of every cause. causes: of CAUSES; all, if none are named.
    """
    dealt: list[list[Recipe]] = [[] for _ in range(parts)]
    runs = [(cause, repeats) for cause in causes or CAUSES]
    # What fills all parts twice counts as two.
    runs += [(None, min(parts, nulls - first)) for first in range(0, nulls, parts)]
    for k, (cause, count) in enumerate(runs):
        for i in range(count):
            # Neighbours in a part have different arms, pairs of neighbours different columns; so do those of a cause.
            dealt[i % parts].append(Recipe(cause, JOINTS[(i + k) % 2], (i // 2 + k // 2) % 2 == 0))
    return [[part[i] for i in rng.permutation(len(part))] for part in dealt if part]
