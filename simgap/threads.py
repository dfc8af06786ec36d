"""Work on several threads. Compiled code and engines let others compute while they do."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor

THREADS = 2
"""Batches or hypotheses computed at once; each computation uses one core."""


def side_by_side(function: Callable, items: Iterable) -> list:
    """Applies the function to every item on `THREADS` threads; results in order."""
    items = list(items)
    if len(items) < 2:
        return [function(item) for item in items]
    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(function, items))
