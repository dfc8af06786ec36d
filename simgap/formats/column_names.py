"""Column names in messages: which are not used, and which were probably meant."""

from collections.abc import Collection, Iterable
from difflib import get_close_matches

_SHOWN = 40  # names that a message lists
_MEANT = 8  # names for which a message says what was probably meant
_LIKE = 0.5  # minimum similarity of a name that was probably meant, from 0 to 1


def listed(names: Collection[str]) -> str:
    """`a, b, c`; of many names the first ones, and how many more there are."""
    known = list(names)
    more = f" and {len(known) - _SHOWN} more" if len(known) > _SHOWN else ""
    return f"{', '.join(known[:_SHOWN])}{more}"


def nearest(wanted: Iterable[str], there: Collection[str]) -> str:
    """`; nearest to tilt_pos is lift_pos`, for missing names that resemble an existing one; at most `_MEANT`."""
    pairs = [(name, get_close_matches(name, there, n=1, cutoff=_LIKE)) for name in wanted if name not in there]
    return "".join([f"; nearest to {name} is {like[0]}" for name, like in pairs if like][:_MEANT])


def unused(there: Iterable[str], used: Collection[str]) -> str:
    """`Not used: a, b.`, or that all others are used."""
    rest = [name for name in there if name not in used]
    return f"Not used: {listed(rest)}." if rest else "All others are used."
