"""Pictures and tables of numbers that a page may show, made elsewhere."""

import base64
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple


class Figures(NamedTuple):
    """Pictures are SVG documents (`svg`, bytes); one that is absent is left out.

    heat: outputs [o], regimes [r], values [o][r] and the top of their colour scale [nats a row].
    strips: svg of all sessions over time, top of its colour scale [nats a row].
    laws: effect, form and where (of which effect), title, caption, svg; any number of an effect.
    rollouts: session, models (those drawn), svg; one of a session.
    commands: svg of the experiment, still (names of the channels at zero).
    """

    heat: Mapping[str, Any] | None = None
    strips: Mapping[str, Any] | None = None
    laws: Sequence[Mapping[str, Any]] = ()
    rollouts: Sequence[Mapping[str, Any]] = ()
    commands: Mapping[str, Any] | None = None


def source(svg: bytes) -> str:
    """A picture as the address of an `img`, so that the page needs no other file."""
    return f"data:image/svg+xml;base64,{base64.b64encode(svg).decode()}"
