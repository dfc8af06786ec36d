"""Normal numbers drawn in a row are those of `jax.random`."""

import jax
import numpy as np
import pytest

from simgap import draws


@pytest.mark.parametrize("shape", [(), (5,), (3, 4), (2, 3, 4)])
def test_they_are_the_same_numbers(shape: tuple[int, ...]) -> None:
    np.testing.assert_array_equal(draws.normal(jax.random.key(1), shape), jax.random.normal(jax.random.key(1), shape))
