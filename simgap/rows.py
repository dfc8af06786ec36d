"""Applies a function to every row of some arrays, compiled once for any number of rows."""

from collections.abc import Callable, Hashable
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

ROWS = 1024
"""Rows that are computed in one batch."""


def by_row(function: Callable, fixed: Hashable, *arrays: Float[np.ndarray, "..."]) -> Any:
    """`function(fixed, *row)` of every row, in 32 bits, as NumPy arrays.

    function: defined in a module; a new lambda or partial would be compiled again. fixed: the same for all rows, such
    as a layout. arrays: they and the results have the same leading axes. Rows of the first array are vectors.
    """
    axes = arrays[0].ndim - 1
    lead = arrays[0].shape[:axes]
    count = int(np.prod(lead))
    flat = [np.asarray(a, np.float32).reshape(count, *a.shape[axes:]) for a in arrays]
    # The last batch is filled by repeating a row. Without rows, one row of zeros gives the shapes of the results.
    flat = flat if count else [np.zeros((1, *a.shape[1:]), np.float32) for a in flat]
    parts = []
    for first in range(0, max(count, 1), ROWS):
        index = np.minimum(np.arange(first, first + ROWS), max(count, 1) - 1)
        parts.append(_batch(function, fixed, *(a[index] for a in flat)))
    return jax.tree.map(lambda *p: np.concatenate(p)[:count].reshape(*lead, *p[0].shape[1:]), *parts)


@partial(jax.jit, static_argnums=(0, 1))
def _batch(function: Callable, fixed: Hashable, *rows: Float[np.ndarray, "n ..."]) -> Any:
    return jax.vmap(partial(function, fixed))(*rows)
