"""Inspects and describes objects of a user's code, which may raise anything."""

import inspect
import math
import sysconfig
import traceback
from collections.abc import Iterable, Sequence
from numbers import Real
from pathlib import Path
from typing import Any

from simgap.types import ConfigError

RAISED = (Exception, SystemExit)
"""What a user's code may raise: any exception; a script without a guard may even exit."""


def has(simulator: Any, member: str) -> bool:
    """Whether the object has the member, without running its code."""
    try:
        inspect.getattr_static(simulator, member)
    except AttributeError:
        return False
    return True


def check_tuple(values: Any, kind: type, example: str, what: str, name: str) -> None:
    """ConfigError unless the values are a tuple of that kind; `example`: how to write a member."""
    good = isinstance(values, tuple)
    wrong = [v for v in values if not isinstance(v, kind)] if good else [values]
    if wrong:
        raise ConfigError(
            f"{name}: {what} must be a tuple of {kind.__name__}; {'it holds' if good else 'it is'} {shown(wrong[0])}. "
            f"Write ({example},), with the comma also where there is only one."
        )


def is_finite(value: Any) -> bool:
    """Whether it is a finite number; a bool is not."""
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


def duplicates(names: Iterable[str]) -> list[str]:
    """The names that occur more than once, each listed once."""
    names = list(names)
    return [n for n in dict.fromkeys(names) if names.count(n) > 1]


def shown(value: Any) -> str:
    """A value in at most 60 characters, with its type."""
    try:
        text = repr(value)
    except RAISED:  # from the user's own __repr__
        return f"one whose repr fails ({type(value).__name__})"
    return f"{text if len(text) <= 60 else text[:57] + '...'} ({type(value).__name__})"


def reason(error: BaseException) -> str:
    """The error in one line, with its place in the user's code."""
    summary = f"{type(error).__name__}: {(str(error).splitlines() or [''])[0]}"
    frame = _own_frame(traceback.extract_tb(error.__traceback__))
    return f"{summary} ({frame.filename}, line {frame.lineno})" if frame else summary


def _own_frame(frames: Sequence[traceback.FrameSummary]) -> traceback.FrameSummary | None:
    """The innermost frame outside this package and libraries."""
    libraries = tuple(sysconfig.get_path(p) for p in ("stdlib", "purelib", "platlib"))
    own = [f for f in frames if not f.filename.startswith((*libraries, str(Path(__file__).parent), "<"))]
    return own[-1] if own else None
