"""A function of rows gives the same by batches, for any number of rows and any leading axes."""

import jax.numpy as jnp
import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from simgap.rows import ROWS, by_row


def scaled(factor: float, x, y):
    return factor * x + y.sum(), jnp.outer(x, x)


@settings(max_examples=10)
@given(st.lists(st.integers(0, 40), min_size=1, max_size=2))
@example([0])
@example([ROWS])
@example([ROWS + 1])
@example([2, ROWS])
def test_it_is_the_function_of_every_row(lead: list[int]) -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(*lead, 3)), rng.normal(size=(*lead, 2, 2))
    moved, product = by_row(scaled, 2.0, x, y)
    np.testing.assert_allclose(moved, 2 * x + y.sum((-1, -2))[..., None], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(product, x[..., None] * x[..., None, :], rtol=1e-5, atol=1e-6)
