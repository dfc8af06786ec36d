"""Parts of a step, each traced once for all programs that contain it.

For constants that are variables. Where they are known before tracing, `step` leaves out the laws that are nil.
"""

import jax

from simgap.effects import step

advance, remember, sense = (jax.jit(f, static_argnames="augmented") for f in (step.advance, step.remember, step.sense))
