"""The parts of `step` under `jax.jit`, so that JAX traces each once for all programs that contain it.

Effects' constants are variables here. Where they are known before tracing, call `step` itself: it then skips the laws
whose constants are zero.
"""

import jax

from simgap.effects import step

fading, remember, remember_motion, follow, move, advance, sensed = (
    jax.jit(f, static_argnames="augmented")
    for f in (step.fading, step.remember, step.remember_motion, step.follow, step.move, step.advance, step.sensed)
)
