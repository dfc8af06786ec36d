"""Normal numbers drawn in a row: those of `jax.random`, in a tenth of the time that its programs take to compile.

XLA takes seconds to compile a draw of several dimensions for a CPU, anew for every shape. The virtual Spot draws its
noise without this: within its steps XLA would round what follows differently, and recordings would change.
"""

import math

import jax
from jaxtyping import Array, PRNGKeyArray


def normal(key: PRNGKeyArray, shape: tuple[int, ...]) -> Array:
    """`jax.random.normal(key, shape)`."""
    return jax.random.normal(key, (math.prod(shape),)).reshape(shape)
