"""Colours, and the places of the marks in table cells [px]."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

INK, GREY, HELDOUT = "#1c2430", "#6b7280", "#1f5fa8"
MODELS = {
    "given": "model file", "nominal": "as is", "refitted": "refitted", "augmented": "with effects",
    "black_box": "black box",
}  # fmt: skip
"""The models that are compared, by their name in a statement; `given` only if the search did not start at it."""
COLOURS = {
    "given": "#8a63a8", "nominal": "#9aa0a8", "refitted": "#d1722d", "augmented": "#1f5fa8", "black_box": "#2c9a5f",
}  # fmt: skip
EXCESS = ("#f7f5f1", "#fbd9a5", "#ef8a43", "#bf3021", "#64101a")
"""Colours of an excess error, from none (or less) to the top of the scale, evenly spaced."""
FONTS = "system-ui, -apple-system, Segoe UI, Roboto, Helvetica Neue, Arial, Liberation Sans, sans-serif"

_DARK = 0.179  # luminance at which black and white text have the same contrast (WCAG 2)
_LOG_RATIO = 30.0  # ratio of scores beyond which their scale is logarithmic
_WHISKERS, _STEP = 210, 9
_RANGE = 100

Ends = tuple[float, float]


def labels(statement: Mapping[str, Any]) -> dict[str, str]:
    """What the models of a statement are called."""
    started = (statement.get("model_file") or {}).get("start")
    return MODELS | ({"nominal": "start"} if started else {})


def shade(share: float) -> str:
    """Colour `#rrggbb` of an excess error, given as a share of the top of its scale (clipped to 0 and 1)."""
    at = min(max(share, 0.0), 1.0) * (len(EXCESS) - 1)
    k = min(int(at), len(EXCESS) - 2)
    pairs = zip(*(bytes.fromhex(colour[1:]) for colour in EXCESS[k : k + 2]), strict=True)
    return "#" + "".join(f"{round(a + (at - k) * (b - a)):02x}" for a, b in pairs)


def ink(share: float) -> str:
    """Colour of text on `shade(share)`: black or white, whichever has more contrast (at least 4.5)."""
    parts = (k / 255 for k in bytes.fromhex(shade(share)[1:]))
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    luminance = sum(w * c for w, c in zip((0.2126, 0.7152, 0.0722), linear, strict=True))
    return "#fff" if luminance < _DARK else "#000"


def whiskers(points: Sequence[tuple[str, float, Ends | None]]) -> dict[str, Any]:
    """A mark per (model, value, interval), one below the other on a common scale, which may be logarithmic (`log`).

    Values and ends are finite, and there is at least one value.
    """
    values = [v for _, value, ends in points for v in (value, *(ends or ()))]
    low, high = min(values), max(values)
    log = low > 0 and high > _LOG_RATIO * low
    place = _scale(low, high, _WHISKERS, log)
    marks = [
        {"colour": COLOURS[m], "y": (k + 0.5) * _STEP + 1, "x": place(value), "ends": ends and _both(place, ends)}
        for k, (m, value, ends) in enumerate(points)
    ]
    return {"width": _WHISKERS, "height": len(points) * _STEP + 2, "log": log, "marks": marks}


def parameter(before: float | None, after: float, between: Ends | None, limits: Ends) -> dict[str, Any]:
    """A parameter in its plausible range `limits`: where it was, where it is now, and its interval."""
    values = [after] if before is None else [before, after]
    place = _scale(min(limits[0], *values), max(limits[1], *values), _RANGE)
    low, high = _both(place, limits)
    inside = between and tuple(min(max(x, 0.0), float(_RANGE)) for x in _both(place, between))
    return {
        "width": _RANGE, "low": low, "span": max(high - low, 1.0), "before": None if before is None else place(before),
        "after": place(after), "ends": inside,
    }  # fmt: skip


def _both(place: Callable[[float], float], ends: Ends) -> Ends:
    return (place(ends[0]), place(ends[1]))


def _scale(low: float, high: float, width: float, logarithmic: bool = False) -> Callable[[float], float]:
    """A function from values in [low, high] to pixels (rounded to tenths), with room for the marks at both ends."""
    if logarithmic:
        linear = _scale(math.log(low), math.log(high), width)
        return lambda value: linear(math.log(value))
    span = high - low or 1.0
    return lambda value: round(5 + (width - 10) * (value - low) / span, 1)
