"""The parts of `step` under `jax.jit`, so that JAX traces each once for all programs that contain it.

They take the effects' constants as variables. Call `step` itself where the constants are known before tracing: it then
skips the laws whose constants are zero.
"""

import jax

from simgap.effects import step

advance, remember, sense = (jax.jit(f, static_argnames="augmented") for f in (step.advance, step.remember, step.sense))
