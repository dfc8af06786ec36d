"""The figures and tables of numbers that a page may show."""

import base64
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple


class Figures(NamedTuple):
    """Figures are SVG documents (`svg`, bytes); the page leaves out those that are absent.

    heat: outputs [o], regimes [r], values [o][r] and the top of their colour scale [nats a row].
    strips: svg of all sessions over time, top of its colour scale [nats a row].
    laws: effect, form and where (which effect it is of), title, caption, svg; any number per effect.
    rollouts: session, models (those drawn), svg; one per session.
    commands: svg of the experiment, still (names of the channels at zero).
    """

    heat: Mapping[str, Any] | None = None
    strips: Mapping[str, Any] | None = None
    laws: Sequence[Mapping[str, Any]] = ()
    rollouts: Sequence[Mapping[str, Any]] = ()
    commands: Mapping[str, Any] | None = None


def source(svg: bytes) -> str:
    """A figure as the address of an `img`, so that the page needs no other file."""
    return f"data:image/svg+xml;base64,{base64.b64encode(svg).decode()}"
