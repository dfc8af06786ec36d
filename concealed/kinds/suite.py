"""The suite of machines of five kinds, dealt out so that every part has some of each."""

import numpy as np

from concealed.kinds.case import Recipe
from concealed.kinds.causes import CAUSES
from concealed.kinds.robots import KINDS


def recipes(nulls: int, repeats: int, parts: int, rng: np.random.Generator) -> list[list[Recipe]]:
    """The recipes in parts, each of which is a stratified sample of the suite in a random order.

    nulls: cases without a cause, of every kind. repeats: cases of every cause.
    """
    dealt: list[list[Recipe]] = [[] for _ in range(parts)]
    causes = sorted(CAUSES, key=lambda name: CAUSES[name].kind)
    runs = [*(Recipe(kind, None) for kind in KINDS for _ in range(nulls)),
            *(Recipe(CAUSES[name].kind, name) for name in causes for _ in range(repeats))]  # fmt: skip
    for i, recipe in enumerate(runs):
        dealt[i % parts].append(recipe)
    return [[part[i] for i in rng.permutation(len(part))] for part in dealt if part]
