"""Numbers as text. Unknown numbers (None, not finite) are an en dash."""

import math
import re
from typing import Any

DASH, MINUS = "\N{EN DASH}", "\N{MINUS SIGN}"


def known(value: Any) -> bool:
    """Whether there is a finite number."""
    return value is not None and math.isfinite(value)


def interval(ends: Any) -> tuple[float, float] | None:
    """(low, high) of two finite ends in either order; None for anything else."""
    if ends is None or not all(known(e) for e in ends):
        return None
    return (float(min(ends)), float(max(ends)))


def percent(share: Any) -> str:
    """A share of one in whole percent; `under 1 %` or `over 99 %` instead of a share rounded to 0 or 100 %."""
    if not known(share):
        return DASH
    if 0 < share < 0.01:
        return "under 1 %"
    return "over 99 %" if 0.99 < share < 1 else _proper(f"{100 * share:.0f} %")


def number(value: Any, digits: int = 3) -> str:
    """A number to some significant digits."""
    if not known(value):
        return DASH
    return fixed(value, 0) if abs(value) >= 1000 else _proper(f"{value:.{digits}g}")


def fixed(value: Any, decimals: int) -> str:
    """A number to some decimals; without decimals from a thousand on."""
    if not known(value):
        return DASH
    return _proper(f"{value:.1e}" if abs(value) >= 1e6 else f"{value:,.{decimals if abs(value) < 1000 else 0}f}")


def signed(value: float | None) -> str:
    """A number with its sign, to one decimal."""
    return DASH if value is None else _proper(f"{value:+.1f}")


def decimals(ends: Any) -> int | None:
    """Decimals that show an interval's half width to one or two digits; None where there is no interval."""
    ends = interval(ends)
    if ends is None or ends[1] <= ends[0]:
        return None
    return min(max(-math.floor(math.log10((ends[1] - ends[0]) / 4)), 0), 8)


def with_interval(value: Any, ends: Any, places: int | None = None) -> tuple[str, str]:
    """A value to `places` decimals (default: as its interval warrants), and the interval, empty if unknown."""
    places = decimals(ends) if places is None else places
    if places is None:
        return number(value), ""
    ends = interval(ends)
    return fixed(value, places), f"{fixed(ends[0], places)} to {fixed(ends[1], places)}" if ends else ""


def width(share: Any) -> str:
    """Length of a bar [% of its maximum] for a share of one, clipped to 0 and 1."""
    return f"{100 * min(max(share, 0.0), 1.0) if known(share) else 0.0:.2f}"


def duration(seconds: float) -> str:
    """A time in seconds, or minutes from two on."""
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


def unit(name: Any) -> str:
    """A unit; empty for a pure number."""
    return "" if name in (None, "", "-") else str(name)


def count(n: int, noun: str) -> str:
    """`1 session`, `2 sessions`."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def _proper(text: str) -> str:
    """With a minus sign for a hyphen, and no sign before a number that is rounded to zero."""
    return text.lstrip("-") if not re.search("[1-9]", text) else text.replace("-", MINUS)
