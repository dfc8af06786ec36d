"""What is said of an effect that moves the scatter and not the mean."""

from typing import Any, NamedTuple

OWED = 10.0
"""Least gain [nats]; hypotheses on the scatter have two or three constants each."""


class Scatter(NamedTuple):
    """An effect on the scatter: constants [{name, value, unit, ci95}], gains in training and held-out rows [nats].

    rare: it is a matter of single rows. pictures: of the law over the data, by `scatter_pictures`.
    """

    id: str
    rare: bool
    constants: list[dict[str, Any]]
    outputs: tuple[str, ...]
    statement: str
    gain: float
    heldout_gain: float
    pictures: list[dict[str, Any]]
