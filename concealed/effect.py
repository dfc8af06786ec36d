"""What a key says of a cause: the words that are right for it, and why."""

from collections.abc import Sequence
from typing import Any


def of_cause(
    name: str, accept: Sequence[str], why: str, channels: Sequence[str] = (), constants: Sequence[dict[str, Any]] = ()
) -> dict[str, Any]:
    """The entry of a cause; its id is the first of the words, or its own name if there are none."""
    return {"id": accept[0] if accept else name, "accept": list(accept), "why": why, "cause": name,
            "channels": list(channels), "outputs": [], "constants": list(constants)}  # fmt: skip


def constants_of(constant: tuple[str, float, str] | None) -> list[dict[str, Any]]:
    """A constant as name, value and unit, if there is one."""
    return [] if constant is None else [dict(zip(("name", "value", "unit"), constant, strict=True))]
