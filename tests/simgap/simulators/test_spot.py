"""The kinematic model against the paper's equations written out component by component, and its symmetries."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simgap.recordings import HISTORY, encode_state
from simgap.simulators import parameter_ranges, sample_parameters, state_difference
from simgap.simulators.spot import SCHEMA, Spot, from_body, step, to_body

DT = 1 / 15
seeds = st.integers(0, 2**31 - 1)


def example(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    low, high = parameter_ranges(Spot())
    return rng.uniform(low, high), rng.normal(size=12), rng.normal(size=6)


def paper(phi: np.ndarray, s: np.ndarray, u: np.ndarray) -> list[float]:
    """[Hoffman et al. 2025, eqs. 3-5], scalars only, as printed: with d, phi and arctan2."""
    a, b, g = phi[:6], phi[6:18], phi[18:]
    x, y, th, vx, vy, om, ex, ey, ez, evx, evy, evz = s
    c, n = np.cos(th), np.sin(th)
    ux, uy, uo = c * u[0] - n * u[1], n * u[0] + c * u[1], u[2]
    wx, wy, wz = c * u[3] - n * u[4], n * u[3] + c * u[4], u[5]
    vx1, vy1, om1 = (
        a[0] * vx + (1 - a[0]) * ux + b[0],
        a[1] * vy + (1 - a[1]) * uy + b[1],
        a[2] * om + (1 - a[2]) * uo + b[2],
    )
    d, angle = np.hypot(ex - x, ey - y), np.arctan2(ey - y, ex - x)
    evx1 = a[3] * evx + (1 - a[3]) * wx + b[6] + vx1 - om1 * d * np.sin(angle)
    evy1 = a[4] * evy + (1 - a[4]) * wy + b[7] + vy1 + om1 * d * np.cos(angle)
    evz1 = a[5] * evz + (1 - a[5]) * wz + b[8]
    return [
        x + DT * g[0] * vx1 + b[3], y + DT * g[1] * vy1 + b[4], th + DT * g[2] * om1 + b[5], vx1, vy1, om1,
        ex + DT * g[3] * evx1 + b[9], ey + DT * g[4] * evy1 + b[10], ez + DT * g[5] * evz1 + b[11], evx1, evy1, evz1,
    ]  # fmt: skip


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_step_is_the_papers(seed: int) -> None:
    phi, s, u = example(seed)
    np.testing.assert_allclose(step(*map(jnp.asarray, (phi, s, u)), DT), paper(phi, s, u), rtol=1e-5, atol=1e-5)


@given(seeds, st.floats(-3, 3), st.floats(-5, 5))
@settings(max_examples=20, deadline=None)
def test_world_frame_may_lie_anywhere(seed: int, angle: float, shift: float) -> None:
    """Without world-frame biases and with isotropic parameters, moving the world frame moves the prediction along."""
    phi, s, u = example(seed)
    phi[[1, 4, 19, 22]] = phi[[0, 3, 18, 21]]  # x and y alike
    phi[6:18] = 0

    def moved(s: np.ndarray) -> np.ndarray:
        c, n = np.cos(angle), np.sin(angle)
        out = np.array(s, float)
        for i in (0, 3, 6, 9):
            out[i], out[i + 1] = c * s[i] - n * s[i + 1], n * s[i] + c * s[i + 1]
        out[[0, 6]] += shift
        out[2] += angle
        return out

    after = step(*map(jnp.asarray, (phi, moved(s), u)), DT)
    np.testing.assert_allclose(after, moved(np.asarray(step(*map(jnp.asarray, (phi, s, u)), DT))), atol=1e-4)


def test_rest_stays_at_rest_with_finite_gradients() -> None:
    phi = np.concatenate([np.full(6, 0.3), np.zeros(12), np.ones(6)])
    rest = jnp.zeros(12)
    np.testing.assert_array_equal(step(jnp.asarray(phi), rest, jnp.zeros(6), DT), rest)
    gradient = jax.jacobian(lambda s: step(jnp.asarray(phi), s, jnp.zeros(6), DT))(rest)
    assert jnp.isfinite(gradient).all()


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_body_coordinates_invert(seed: int) -> None:
    _, s, _ = example(seed)
    np.testing.assert_allclose(from_body(to_body(jnp.asarray(s))), s, atol=1e-5)


def test_parameters_are_24_with_units_and_ranges() -> None:
    spot = Spot()
    assert len(spot.parameters) == 24
    assert len({p.name for p in spot.parameters}) == 24
    assert all(p.low < p.high and p.unit for p in spot.parameters)
    drawn = sample_parameters(spot, jax.random.key(0), 500)
    low, high = parameter_ranges(spot)
    assert (drawn >= low).all()
    assert (drawn <= high).all()


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_difference_uses_the_latest_command_and_wraps_yaw(seed: int) -> None:
    phi, s, u = map(jnp.asarray, example(seed))
    s = s.at[2].set(jnp.pi - 1e-3).at[5].set(2.0)  # turns across pi
    x = jnp.concatenate([encode_state(SCHEMA, s), jnp.full(6 * HISTORY, 9.0), u])
    y = state_difference(Spot(), phi, x)
    assert y.shape == (13,)
    assert jnp.abs(y[2:4]).max() < 1.0
    s_next = step(phi, s, u, DT)
    np.testing.assert_allclose(y[2], jnp.sin(s_next[2]) - jnp.sin(s[2]), atol=1e-5)


def test_time_step_scales_positions_only() -> None:
    phi, s, u = map(jnp.asarray, example(3))
    slow, fast = step(phi, s, u, 0.1), step(phi, s, u, 0.05)
    np.testing.assert_allclose(slow[3:6], fast[3:6])
    assert slow[0] - s[0] - phi[9] == pytest.approx(2 * float(fast[0] - s[0] - phi[9]), rel=1e-3)
