"""Names of columns in messages: which are not used, and which were probably meant."""

from collections.abc import Collection, Iterable
from difflib import get_close_matches

_SHOWN = 40  # names that a message lists
_MEANT = 8  # names for which a message says what was probably meant
_LIKE = 0.5  # least likeness of a name that was probably meant, from 0 to 1


def listed(names: Collection[str]) -> str:
    """`a, b, c`; of many the first, and how many more there are."""
    known = list(names)
    more = f" and {len(known) - _SHOWN} more" if len(known) > _SHOWN else ""
    return f"{', '.join(known[:_SHOWN])}{more}"


def nearest(wanted: Iterable[str], there: Collection[str]) -> str:
    """`; nearest to tilt_pos is lift_pos`, of names that are like one that is there; of many the first."""
    pairs = [(name, get_close_matches(name, there, n=1, cutoff=_LIKE)) for name in wanted if name not in there]
    return "".join([f"; nearest to {name} is {like[0]}" for name, like in pairs if like][:_MEANT])


def unused(there: Iterable[str], used: Collection[str]) -> str:
    """`Not used: a, b.`; that all are, where all are."""
    rest = [name for name in there if name not in used]
    return f"Not used: {listed(rest)}." if rest else "All others are used."
