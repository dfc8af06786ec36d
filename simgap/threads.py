"""Work on several threads. Compiled code and engines let others compute while they do."""

import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor

THREADS = 2
"""Batches or hypotheses computed at once; each computation uses one core."""
_here = threading.local()


def side_by_side(function: Callable, items: Iterable) -> list:
    """Applies the function to every item on `THREADS` threads; results in order.

    On one of these threads it applies it there: what it would start would only wait for its own kind.
    """
    items = list(items)
    if len(items) < 2 or getattr(_here, "working", False):
        return [function(item) for item in items]
    with ThreadPoolExecutor(THREADS, initializer=_begin) as pool:
        return list(pool.map(function, items))


def _begin() -> None:
    _here.working = True
