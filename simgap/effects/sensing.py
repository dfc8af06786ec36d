"""What sensors measure of the state. `law(c[k, sites], state, past_states, row, layout) -> measured`."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.effects.effect import SENSED_ROWS, Constant, Effect, Row, Scales, Site
from simgap.effects.sites import output_sites
from simgap.kinematics import wrapped
from simgap.layout import Layout


def _sensors(layout: Layout) -> list[tuple[str, str, list[int]]]:
    """Groups of outputs that one sensor probably gives: a body's pose, a body's velocities, or a single output. Each
    with its name, and what it measures."""
    groups: dict[tuple[str, str], list[int]] = {}
    for i, f in enumerate(layout.schema.outputs):
        what = "velocity" if f.kind == "velocity" else "pose"
        groups.setdefault((f"{f.body} {what}", what) if f.body else (f.name, ""), []).append(i)
    return [(name, what, members) for (name, what), members in groups.items()]


def _sensor_sites(layout: Layout) -> tuple[Site, ...]:
    """Poses of all bodies may be equally old, and so may velocities: motors of one kind have the same registers."""
    names = [f.name for f in layout.schema.state]
    return tuple(
        Site(group, (), tuple(names[i] for i in members), "sensors", "s", what and f"of {what}")
        for group, what, members in _sensors(layout)
    )


def _delay(c: Float[Array, "1 n"], state: Array, past: Float[Array, "r s"], row: Row, layout: Layout) -> Array:
    """The state c rows ago, interpolated linearly between rows."""
    delay = jnp.zeros(len(layout.schema.state))
    for k, (*_, members) in enumerate(_sensors(layout)):
        delay = jnp.where(np.isin(np.arange(len(delay)), members), c[0, k], delay)
    # A sum in Python: XLA takes ten times as long to reduce one array.
    since = (jnp.maximum(0.0, 1 - jnp.abs(k - delay)) * wrapped(layout, then - state) for k, then in enumerate(past, 1))
    return state + sum(since)


def _scale(c: Float[Array, "1 s"], state: Array, past: Array, row: Row, layout: Layout) -> Array:
    """(1 + c) y."""
    return state * _slope_of_scale(c, state)


def _slope_of_scale(c: Float[Array, "1 s"], state: Array) -> Array:
    return 1 + padded(c[0], state)


def _bias(c: Float[Array, "1 s"], state: Array, past: Array, row: Row, layout: Layout) -> Array:
    """y + c."""
    return state + padded(c[0], state)


def _drift(c: Float[Array, "1 s"], state: Array, past: Array, row: Row, layout: Layout) -> Array:
    """y + c t, t in minutes."""
    return state + padded(c[0], state) * row.time_s / 60


def _rectified(c: Float[Array, "1 s"], state: Array, past: Array, row: Row, layout: Layout) -> Array:
    """y where it is positive, (1 - 2 c) y where it is negative: the size alone where c is one."""
    return state * _slope_of_rectifier(c, state)


def _slope_of_rectifier(c: Float[Array, "1 s"], state: Array) -> Array:
    return jnp.where(state < 0, 1 - 2 * padded(c[0], state), 1.0)


def padded(c: Float[Array, " o"], state: Float[Array, " s"]) -> Float[Array, " s"]:
    """Constants of the outputs, padded with zeros for the states that are not observed, which come last."""
    return c if len(c) == len(state) else jnp.pad(c, (0, len(state) - len(c)))


def _drifting(scales: Scales, site: int) -> list[list[float]]:
    """Starting value: over the longest session, the drift amounts to the starting value of a bias."""
    return [[0.05 * float(scales.output[site]) * 60 / max(scales.duration, 1e-9)]]


EFFECTS = (
    Effect(
        "sensor_delay", "sensing",
        (Constant("delay", "s", lambda c, site, scales: c * scales.time_step, 0.0, float(SENSED_ROWS)),),
        _sensor_sites, lambda scales, site: [[rows + 0.5] for rows in range(SENSED_ROWS)], _delay,
        "measurements are {delay} older than their time stamp", tie="any", basins=True,
    ),
    Effect(
        "sensor_scale", "sensing", (Constant("scale", "-", lambda c, site, scales: 1 + c, -0.9, 3.0),), output_sites,
        lambda scales, site: [[0.05]], _scale, "a measured output is scaled by {scale}", tie="any",
        slope=_slope_of_scale, slight=True,
    ),
    Effect(
        "sensor_bias", "sensing", (Constant("bias", "{u}"),), output_sites,
        lambda scales, site: [[0.05 * float(scales.output[site])]], _bias, "a measured output is off by {bias}",
        slight=True,
    ),
    Effect(
        "sensor_bias", "sensing", (Constant("drift", "{u}/min"),), output_sites, _drifting, _drift,
        "a measured output drifts off by {drift}: its sensor drifts, or what it is measured against moves",
        form="drift", slight=True,
    ),
    Effect(
        "rectified_sensor", "sensing",
        (Constant("ratio", "-", lambda c, site, scales: 2 * c - 1, 0.0, 2.0, least=lambda site, scales: 0.5),),
        output_sites, lambda scales, site: [[1.0]], _rectified,
        "a sensor loses the sign: it shows negative values as positive ones, {ratio} times as large", tie="same_unit",
        slope=_slope_of_rectifier, folds=True, slight=True,
    ),
)  # fmt: skip
