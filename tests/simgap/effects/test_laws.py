"""Laws of the vocabulary, on a walking arm, a car and a one-axis drive: what holds of every effect at every site."""

import string
from dataclasses import dataclass
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax.flatten_util import ravel_pytree

from examples.car import CAR, Car
from examples.drive import DRIVE
from simgap.diagnosis.likelihood.scales import measure
from simgap.effects import CATALOGUE, dry_friction, resistance
from simgap.effects.augmented import Augmented, Slot
from simgap.effects.command_filters import fading_of
from simgap.effects.effect import HISTORY_ROWS, SENSED_ROWS, Effect, Memory, Row, Scales, Step
from simgap.effects.step import advance, follow, sense, unsense
from simgap.kinematics import motion
from simgap.simulators.spot import Spot
from simgap.types import Recording

VOCABULARY = {
    "delay", "lag", "rate_limit", "saturation", "deadband", "backlash", "quantization", "gain", "asymmetric_gain",
    "gain_drift", "dropout", "coulomb_friction", "viscous_drag", "quadratic_drag", "gravity_sag", "payload",
    "arm_base_coupling", "base_arm_coupling", "cross_axis_coupling", "rotation_centre", "centripetal", "slip",
    "slope", "body_frame_bias", "external_push", "reach_limit", "ground_contact", "gait_oscillation",
    "relative_smoothing", "frame_misalignment", "sampling_interval", "integration_rule", "motion_dependent_noise",
    "sensor_delay", "sensor_bias", "sensor_scale", "nonlinear_spring", "joint_gravity", "output_limit",
    "tyre_slip", "stribeck_friction", "load_friction", "hysteresis", "rectified_sensor",
}  # fmt: skip
ADDITIONS = {"induced_velocity", "constant_load", "resonance"}
ABOUT_A_WORLD_DIRECTION = {"slope", "external_push"}
ABOUT_A_PLACE = {"sensor_scale", "nonlinear_spring", "output_limit", "rectified_sensor"}
ABOUT_A_WORLD_COORDINATE = {*ABOUT_A_PLACE, "sensor_bias"}

ROBOTS = {"spot": Augmented(Spot()), "car": Augmented(CAR), "drive": Augmented(DRIVE)}
PHI = {
    # Isotropic, and without biases in the world's frame, so that its directions are alike.
    "spot": np.array([0.5, 0.5, 0.4, 0.1, 0.1, 0.3, *[0.0] * 12, 1.1, 1.1, 1.2, 1.3, 1.3, 1.4], np.float32),
    "car": np.array([0.32, 0.3, 1.1, 0.02], np.float32),
    "drive": np.array([2.0, 4.0], np.float32),
}
ROW = Row(jnp.array(7.0), jnp.array(1.3))
robots = pytest.mark.parametrize("robot", ROBOTS)
effects = pytest.mark.parametrize("effect", CATALOGUE, ids=lambda e: e.key)
seeds = st.integers(0, 2**31 - 1)


def sizes(robot: str) -> tuple[int, int]:
    schema = ROBOTS[robot].simulator.schema
    return len(schema.state), len(schema.command)


@cache
def scales(robot: str) -> Scales:
    """Of a random recording whose rows are 'typical' states and commands."""
    s, u = sizes(robot)
    rng = np.random.default_rng(0)
    augmented = ROBOTS[robot]
    time_s = np.arange(200) * augmented.simulator.time_step
    recording = Recording("a", time_s, rng.normal(size=(200, s)), 0.5 * rng.normal(size=(200, u)))
    # Such rows say nothing of the time by which positions advance.
    return measure(augmented, [recording])._replace(interval=np.full(s, augmented.simulator.time_step))


def scene(robot: str, seed: int) -> tuple[Memory, jnp.ndarray, jnp.ndarray]:
    """Memory, state and command at random."""
    s, u = sizes(robot)
    rng = np.random.default_rng(seed)
    draw = lambda *shape: jnp.asarray(rng.normal(size=shape), jnp.float32)  # noqa: E731
    bent = {k: jnp.clip(draw(len(ROBOTS[robot].layout.bodies), 4), -1, 1) for k in memories(robot, "hysteresis")}
    filters = {k: draw(*z.shape) for k, z in rested(robot, jnp.zeros(u)).items()}
    memory = Memory(draw(HISTORY_ROWS, u), filters, bent, draw(SENSED_ROWS, s), forgets(robot))
    return memory, draw(s), draw(u)


@cache
def forgets(robot: str) -> jnp.ndarray:
    return fading_of(ROBOTS[robot].simulator, ROBOTS[robot].layout, jnp.asarray(PHI[robot]))


def at_rest(robot: str) -> tuple[Memory, jnp.ndarray, jnp.ndarray]:
    memory, state, command = jax.tree.map(jnp.zeros_like, scene(robot, 0))
    return memory._replace(fading=forgets(robot)), state, command


def rested(robot: str, command: jnp.ndarray) -> dict[str, jnp.ndarray]:
    """Memories of filters that have settled on a command."""
    return {e.key: e.rest(command) for e in CATALOGUE if e.key in memories(robot, "filter")}


def memories(robot: str, place: str) -> list[str]:
    return [e.key for e, sites in zip(CATALOGUE, ROBOTS[robot].sites, strict=True) if e.place == place and sites]


def sites_of(robot: str, effect: Effect) -> tuple:
    return ROBOTS[robot].sites[CATALOGUE.index(effect)]


def theta(robot: str, effect: Effect, constants: list[float], sites: list[int]) -> jnp.ndarray:
    augmented = ROBOTS[robot]
    out = np.zeros(len(augmented.slots), np.float32)
    for k, c in enumerate(constants):
        for site in sites:
            out[augmented.index[Slot(CATALOGUE.index(effect), k, site)]] = c
    return jnp.asarray(out)


@partial(jax.jit, static_argnames="robot")
def one_step(robot: str, theta, memory: Memory, state, command, measures):
    """The step's result and what is measured of it."""
    memory, then = advance(ROBOTS[robot], PHI[robot], theta, measures, memory, state, command, ROW)
    return memory, then, sense(ROBOTS[robot], theta, memory, then, ROW)


@partial(jax.jit, static_argnames="robot")
def bare(robot: str, state, command):
    return ROBOTS[robot].simulator.step(PHI[robot], state, command)


# Nil at zero


@robots
@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_with_all_constants_zero_it_is_the_simulator(robot: str, seed: int) -> None:
    zero = jnp.zeros(len(ROBOTS[robot].slots))
    memory, state, command = scene(robot, seed)
    _, then, measured = one_step(robot, zero, memory, state, command, scales(robot))
    # Compiled apart, sums round otherwise.
    np.testing.assert_allclose(then, bare(robot, state, command), rtol=1e-6, atol=2e-6)
    np.testing.assert_array_equal(measured, then)
    np.testing.assert_array_equal(unsense(ROBOTS[robot], zero, then, ROW.time_s), then)


@robots
def test_with_all_constants_zero_it_is_the_simulator_to_the_last_bit(robot: str) -> None:
    zero = jnp.zeros(len(ROBOTS[robot].slots))
    memory, state, command = scene(robot, 5)
    memory = memory._replace(filters=rested(robot, command))
    with jax.disable_jit():
        after, then = advance(ROBOTS[robot], PHI[robot], zero, scales(robot), memory, state, command, ROW)
        np.testing.assert_array_equal(then, ROBOTS[robot].simulator.step(PHI[robot], state, command))
        np.testing.assert_array_equal(sense(ROBOTS[robot], zero, after, then, ROW), then)


@robots
@given(seed=seeds)
@settings(max_examples=5, deadline=None)
def test_commands_pass_to_the_last_bit_when_all_constants_are_zero(robot: str, seed: int) -> None:
    memory, _, command = scene(robot, seed)
    with jax.disable_jit():
        _, u = follow(ROBOTS[robot], jnp.zeros(len(ROBOTS[robot].slots)), memory, command, ROW)
    np.testing.assert_array_equal(u, command)


@robots
def test_memory_keeps_what_was_sent_and_where_the_robot_was(robot: str) -> None:
    memory, state, command = scene(robot, 1)
    after, _, _ = one_step(robot, jnp.zeros(len(ROBOTS[robot].slots)), memory, state, command, scales(robot))
    np.testing.assert_array_equal(after.commands, jnp.concatenate([command[None], memory.commands[:-1]]))
    np.testing.assert_array_equal(after.states, jnp.concatenate([state[None], memory.states[:-1]]))


@robots
def test_constants_known_before_tracing_give_the_same(robot: str) -> None:
    """Of numpy's zeros no law is computed at all."""
    gain, bias = (next(e for e in CATALOGUE if e.id == i) for i in ("gain", "sensor_bias"))
    for constants in (
        0 * theta(robot, gain, [0.1], [0]),
        theta(robot, gain, [0.1], [0]) + theta(robot, bias, [1.0], [1]),
    ):
        memory, state, command = scene(robot, 6)
        traced = one_step(robot, constants, memory, state, command, scales(robot))
        known, augmented = np.asarray(constants), ROBOTS[robot]
        after, then = advance(augmented, PHI[robot], known, scales(robot), memory, state, command, ROW)
        measured = sense(augmented, known, after, then, ROW)
        np.testing.assert_allclose(then, traced[1], rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(measured, traced[2], rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(
            *(unsense(augmented, c, measured, ROW.time_s) for c in (known, constants)), rtol=1e-6, atol=1e-6
        )


# Gradients


@partial(jax.jit, static_argnames="robot")
def slopes(robot: str, thetas, memory: Memory, state, command, measures):
    """State, filters and measurement for many thetas, after their derivatives by theta and by the state."""

    def outcome(theta, state):
        after, then = advance(ROBOTS[robot], PHI[robot], theta, measures, memory, state, command, ROW)
        values = ravel_pytree((then, after.filters, sense(ROBOTS[robot], theta, after, then, ROW)))[0]
        return values, values

    return jax.vmap(lambda t: jax.jacrev(outcome, argnums=(0, 1), has_aux=True)(t, state))(thetas)


def all_starts(robot: str) -> tuple[list[str], jnp.ndarray]:
    """Theta zero, and every effect alone at every site, at the first and the last of its starts."""
    names, thetas = ["zero"], [jnp.zeros(len(ROBOTS[robot].slots))]
    for effect in CATALOGUE:
        for site, named in enumerate(sites_of(robot, effect)):
            starts = effect.starts(scales(robot), site)
            for start in (starts[0], starts[-1])[: len(starts)]:
                names.append(f"{effect.key} on {named.name}")
                thetas.append(theta(robot, effect, start, [site]))
    return names, jnp.stack(thetas)


@robots
@pytest.mark.parametrize("where", ["at rest", "moving", "moving elsewhere"])
def test_gradients_are_finite(robot: str, where: str) -> None:
    names, thetas = all_starts(robot)
    at = at_rest(robot) if where == "at rest" else scene(robot, 3 if where == "moving" else 4)
    derivatives, _ = slopes(robot, thetas, *at, scales(robot))
    for derivative in derivatives:
        bad = [n for n, d in zip(names, derivative, strict=True) if not np.isfinite(d).all()]
        assert not bad


@robots
def test_every_effect_acts(robot: str) -> None:
    """At its starts each law changes something in some random scene: none is nil by mistake."""
    names, thetas = all_starts(robot)
    acted = np.zeros(len(names), bool)
    for seed in range(12):
        memory, state, command = scene(robot, seed)
        far = (1 + seed % 3) * state  # to where limits are
        _, values = slopes(robot, thetas, memory, far, command, scales(robot))
        acted |= (np.abs(values - values[0]) > 1e-6).any(-1)
    assert {n for n, a in zip(names, acted, strict=True) if a} == set(names) - {"zero"}


# Dissipation


def look(robot: str, seed: int) -> tuple[Step, np.ndarray]:
    """What a push sees in a random scene, and a response to a push that is positive, as robots' are."""
    augmented = ROBOTS[robot]
    _, state, command = scene(robot, seed)
    after = scene(robot, seed + 1)[1]
    now, then = motion(augmented.layout, state), motion(augmented.layout, after)
    response = np.abs(motion(augmented.layout, scene(robot, seed + 2)[1]).velocity)
    return Step(now, then, (state, after), command, augmented.layout, scales(robot), ROW), response


@robots
@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_resistances_never_add_power(robot: str, seed: int) -> None:
    step, response = look(robot, seed)
    rng = np.random.default_rng(seed)
    ending = -step.then.velocity / np.where(response != 0, response, np.inf)
    for effect in (*resistance.EFFECTS, *dry_friction.EFFECTS):
        sites, dry = sites_of(robot, effect), effect.place == "friction"
        if sites:
            assert all(c.low >= 0 for c in effect.constants)
            size = (len(effect.constants), len(sites))
            found = effect.law(jnp.asarray(rng.exponential(size=size), jnp.float32), step)
            push = dry_friction.opposed(ending, found) if dry else found
            # Dry friction works against the motion it would else leave, the others against the motion at hand.
            resisted = step.then.velocity if dry else step.now.velocity
            assert (push * resisted).max() <= 0
            assert float(jnp.abs(push).sum()) > 0
            if dry:  # it stops, it does not turn back
                left = np.asarray(step.then.velocity + push * response)
                assert (left * np.asarray(step.then.velocity) >= -1e-6).all()


@robots
def test_dry_friction_of_the_whole_robot_brings_it_to_rest(robot: str) -> None:
    """Much of it, and no command: no axis turns back, and what is commanded to stand stands.

    What is mounted stands once its carrier does: a simulator may let the carrier's motion leak into its velocity.
    """
    (coulomb,) = (e for e in CATALOGUE if e.key == "coulomb_friction")
    much = theta(robot, coulomb, [1e3], list(range(len(sites_of(robot, coulomb)))))
    memory, state, command = scene(robot, 2)
    layout = ROBOTS[robot].layout
    little = 0.05 * np.abs(motion(layout, state).velocity).max()
    memory, state, _ = one_step(robot, much, memory, state, 0 * command, scales(robot))
    assert np.abs(motion(layout, state).velocity)[[carrier is None for carrier in layout.carrier]].max() < little
    _, state, _ = one_step(robot, much, memory, state, 0 * command, scales(robot))
    assert np.abs(motion(layout, state).velocity).max() < little


def test_dry_friction_stops_a_base_though_it_turns_and_a_bias_drives_it() -> None:
    """Along all axes at once: a push that turns it is none along the others."""
    memory, state, _ = at_rest("spot")
    command = 0.1 * scene("spot", 0)[2]
    biased = PHI["spot"].copy()
    biased[6:9] = 0.02, -0.01, 0.03  # of the base's velocities
    (effect,) = (e for e in CATALOGUE if e.key == "coulomb_friction")
    much = theta("spot", effect, [1e3], list(range(len(sites_of("spot", effect)))))
    then = advance(ROBOTS["spot"], biased, much, scales("spot"), memory, state, command, ROW)[1]
    # Of eight random commands the largest rest was 0.0006 m/s: the heading turns while it brakes.
    np.testing.assert_allclose(motion(ROBOTS["spot"].layout, then).velocity[0], 0, atol=1e-3)


@robots
def test_resistances_are_nil_at_rest(robot: str) -> None:
    augmented = ROBOTS[robot]
    _, state, command = at_rest(robot)
    still = motion(augmented.layout, state)
    step = Step(still, still, (state, state), command, augmented.layout, scales(robot), ROW)
    for effect in resistance.EFFECTS:
        push = effect.law(jnp.ones((1, len(sites_of(robot, effect)))), step)
        assert not push.any()


# Where the world frame lies


def moved(robot: str, state: jnp.ndarray, angle: float, shift: float) -> jnp.ndarray:
    """The state seen from a world frame that lies elsewhere."""
    layout = ROBOTS[robot].layout
    c, s = np.cos(angle), np.sin(angle)
    out = np.array(state, float)
    for b in range(len(layout.bodies)):
        for table, by in ((layout.position, shift), (layout.velocity, 0.0)):
            ix, iy = table[b, :2]
            if ix >= 0 and iy >= 0 and layout.schema.state[ix].frame == "world":
                x, y = out[ix], out[iy]
                out[ix], out[iy] = c * x - s * y + by, s * x + c * y + by
            elif ix >= 0 and layout.schema.state[ix].kind == "position":
                out[ix] += by
        if layout.position[b, 3] >= 0:
            out[layout.position[b, 3]] += angle
    return jnp.asarray(out, jnp.float32)


def commutes(robot: str, constants: jnp.ndarray, angle: float, shift: float) -> None:
    for seed in range(3):
        memory, state, command = scene(robot, seed)
        there = memory._replace(states=jnp.stack([moved(robot, s, angle, shift) for s in memory.states]))
        here = one_step(robot, constants, memory, state, command, scales(robot))
        elsewhere = one_step(robot, constants, there, moved(robot, state, angle, shift), command, scales(robot))
        for a, b in zip(here[1:], elsewhere[1:], strict=True):
            np.testing.assert_allclose(moved(robot, a, angle, shift), b, atol=5e-5)
        for key, z in here[0].filters.items():
            np.testing.assert_allclose(z, elsewhere[0].filters[key], atol=1e-6)


def about_the_world(robot: str, effect: Effect, site: int, turned: bool) -> bool:
    """Whether the law is about a place or a direction of the world."""
    if effect.id in ABOUT_A_WORLD_COORDINATE:
        field = ROBOTS[robot].simulator.schema.state[site]
        if field.kind in ("position", "angle") and effect.id in ABOUT_A_PLACE:
            return field.axis != "z" and (turned or field.kind == "position")
        return turned and field.frame == "world" and field.axis in ("x", "y")
    return turned and effect.id in ABOUT_A_WORLD_DIRECTION


@robots
@effects
def test_the_world_frame_may_lie_elsewhere(robot: str, effect: Effect) -> None:
    sites = range(len(sites_of(robot, effect)))
    can_turn = ROBOTS[robot].layout.heading[0] is not None
    for angle, shift in ((0.0, 2.5), (0.0, -0.7), *(((2.1, 0.0), (-0.8, 1.5)) if can_turn else ())):
        free = [s for s in sites if not about_the_world(robot, effect, s, angle != 0)]
        for start in effect.starts(scales(robot), free[0])[:1] if free else []:
            # All sites alike: what acts on the world's x and y alike has no direction.
            commutes(robot, theta(robot, effect, start, free), angle, shift)


@dataclass(frozen=True)
class WrappedCar(Car):
    """A car whose simulator keeps its yaw within (-pi, pi]."""

    def step(self, params, state, command):
        then = super().step(params, state, command)
        return then.at[2].set(jnp.arctan2(jnp.sin(then[2]), jnp.cos(then[2])))


@pytest.mark.parametrize(
    "key", ["sampling_interval.constant", "sampling_interval.stamped", "sensor_delay", "gain", "viscous_drag"]
)
def test_a_simulator_may_wrap_its_angles(key: str) -> None:
    (effect,) = (e for e in CATALOGUE if e.key == key)
    constants = theta("car", effect, [0.5], [0])
    state, command = jnp.array([1.0, 2.0, 3.13, 1.5]), jnp.array([1.5, 0.3])  # turns across pi
    memory = at_rest("car")[0]._replace(states=jnp.tile(state, (SENSED_ROWS, 1)))
    measured = []
    for car in (CAR, WrappedCar()):
        augmented = Augmented(car)
        after, then = advance(augmented, PHI["car"], constants, scales("car"), memory, state, command, ROW)
        measured.append(sense(augmented, constants, after, then, ROW))
    apart = measured[0] - measured[1]
    np.testing.assert_allclose(jnp.arctan2(jnp.sin(apart[2]), jnp.cos(apart[2])), 0, atol=1e-5)


def test_a_slope_is_about_the_world() -> None:
    (slope,) = (e for e in CATALOGUE if e.id == "slope")
    with pytest.raises(AssertionError):
        commutes("spot", theta("spot", slope, [0.05, 0.05], [0]), 2.1, 0.0)


# Closed forms, on the drive's one command


def followed(key: str, constant: float, commands: list[float], before: float = 0.0, rate: float = 1e-6) -> np.ndarray:
    """The command that acts in every row; `before`: what was sent and followed until then; `rate`: of forgetting."""
    (effect,) = (e for e in CATALOGUE if e.key == key)
    augmented, c = ROBOTS["drive"], theta("drive", effect, [constant], [0])
    past = jnp.full((HISTORY_ROWS, 1), before)
    fades = jnp.array([rate], jnp.float32)
    memory = Memory(past, dict.fromkeys(memories("drive", "filter"), past[0]), {}, jnp.zeros((SENSED_ROWS, 2)), fades)
    acted = []
    for i, u in enumerate(commands):
        row = Row(jnp.array(30.0 * i), jnp.ones(()))
        memory, acts = follow(augmented, c, memory, jnp.array([u], jnp.float32), row)
        acted.append(float(acts[0]))
    return np.array(acted)


@pytest.mark.parametrize(
    ("key", "constant", "commands", "expected"),
    [
        ("delay", 1.0, [1.0, 2.0, -3.0, 4.0], [0.0, 1.0, 2.0, -3.0]),
        ("delay", 0.5, [1.0, 2.0, -3.0, 4.0], [0.5, 1.5, -0.5, 0.5]),
        ("delay", 2.25, [4.0, 8.0, 0.0, 0.0, 0.0], [0.0, 0.0, 3.0, 7.0, 2.0]),  # 3/4 of two rows ago, 1/4 of three
        ("delay", 8.0, [1.0] * 8 + [0.0], [0.0] * 8 + [1.0]),
        ("saturation", 1 / 0.5, [0.2, 0.5, 0.8, -0.9, -0.1], [0.2, 0.5, 0.5, -0.5, -0.1]),
        ("deadband", 0.1, [0.05, -0.1, 0.3, -0.25], [0.0, 0.0, 0.2, -0.15]),
        ("backlash", 0.2, [0.3, 0.5, 0.45, 0.35, 0.0, 0.05], [0.2, 0.4, 0.4, 0.4, 0.1, 0.1]),
        ("quantization", 0.25, [0.1, 0.2, 0.4, -0.3, -0.4], [0.0, 0.25, 0.5, -0.25, -0.5]),
        ("rate_limit", 1 / 0.2, [1.0, 1.0, 1.0, 0.3, 0.35, -1.0], [0.1, 0.3, 0.5, 0.5, 0.35625, 0.25]),
        # With 2 rows: exp(-1/2) of what is missing after a row, over the row 2 (1 - exp(-1/2)) of it.
        ("lag", 2.0, [1.0, 1.0, 0.0], [0.213061, 0.522698, 0.497440]),
        ("gain", -0.2, [1.0, -0.5], [0.8, -0.4]),
        ("asymmetric_gain.negative", 0.3, [1.0, -0.5], [1.0, -0.35]),
        ("asymmetric_gain.positive", 0.3, [1.0, -0.5], [0.7, -0.5]),
        ("gain_drift", -0.2, [1.0, 1.0, -1.0], [1.0, 0.9, -0.8]),  # rows at 0, 30 and 60 s
    ],
)
def test_commands_by_hand(key: str, constant: float, commands: list[float], expected: list[float]) -> None:
    np.testing.assert_allclose(followed(key, constant, commands), expected, atol=1e-6)


@pytest.mark.parametrize("memory", [0.05, 0.4, 0.8])
@pytest.mark.parametrize(("key", "constant"), [("delay", 0.3), ("delay", 1.6), ("rate_limit", 2.5), ("rate_limit", 0.7),
                                               ("lag", 0.2), ("lag", 1.7)])  # fmt: skip
def test_what_acts_leads_a_joint_to_where_the_changing_command_does(key: str, constant: float, memory: float) -> None:
    """A joint with v' = -ln(memory) (u(t) - v), t in rows, in a thousand steps a row."""
    sent, parts = [0.3, 1.0, -0.4, -0.5, 0.2], 1000
    rate = -np.log(memory)
    times = (np.arange(len(sent) * parts) + 0.5) / parts
    now = np.repeat(sent, parts)
    if key == "delay":
        u = np.array([sent[int(t - constant)] if t >= constant else 0.0 for t in times])
    else:
        u, at = np.zeros(len(now)), 0.0
        for i, goal in enumerate(now):
            step = goal - at
            step = np.clip(step, -1 / constant / parts, 1 / constant / parts) if key == "rate_limit" else step
            step = step * -np.expm1(-1 / constant / parts) if key == "lag" else step
            u[i], at = at + step / 2, at + step
    v, expected = 0.0, []
    for i, each in enumerate(u):
        v = each + (v - each) * np.exp(-rate / parts)
        if (i + 1) % parts == 0:
            expected.append(v)
    v, reached = 0.0, []
    for acts in followed(key, constant, sent, rate=rate):
        v = memory * v + (1 - memory) * acts
        reached.append(v)
    np.testing.assert_allclose(reached, expected, atol=5e-4)


def test_how_fast_a_row_is_forgotten_is_the_simulators() -> None:
    np.testing.assert_allclose(forgets("spot"), -np.log(PHI["spot"][:6]), rtol=1e-5)
    np.testing.assert_allclose(forgets("drive"), 0.0, atol=1e-5)  # of a force nothing


def test_dead_time_comes_before_the_actuators() -> None:
    (delay,), (limit,) = ([e for e in CATALOGUE if e.key == k] for k in ("delay", "saturation"))
    both = theta("drive", delay, [0.5], [0]) + theta("drive", limit, [2.0], [0])
    memory, _, _ = at_rest("drive")
    _, u = follow(ROBOTS["drive"], both, memory, jnp.array([0.8]), ROW)
    assert u[0] == pytest.approx(0.4)  # half of 0.8 is within 0.5; half of what 0.5 lets through would be 0.25


@pytest.mark.parametrize(
    ("key", "constants", "expected"),
    [
        ("delay", [1.5], 0.03), ("lag", [5.0], 0.1), ("rate_limit", [1 / 0.2], 10.0),
        ("saturation", [4.0], 0.25), ("gain", [-0.15], 0.85), ("asymmetric_gain.negative", [0.3], 0.7),
        ("sampling_interval.constant", [0.1], 0.022), ("sensor_delay", [0.5], 0.01), ("sensor_scale", [0.05], 1.05),
    ],
)  # fmt: skip
def test_physical_constants_by_hand(key: str, constants: list[float], expected: float) -> None:
    (effect,) = (e for e in CATALOGUE if e.key == key)
    got = [c.physical(v, 0, scales("drive")) for c, v in zip(effect.constants, constants, strict=True)]
    assert got == pytest.approx([expected])  # the drive's step is 0.02 s


def test_heights_are_those_of_their_own_body() -> None:
    """A body whose recorded height never changes, and one that goes from 0.2 to 0.9 m."""
    (effect,) = (e for e in CATALOGUE if e.id == "ground_contact")
    heights = scales("spot")._replace(height=np.stack([np.full(21, 0.5), np.linspace(0.2, 0.9, 21)]))
    got = [effect.constants[0].physical(c, site, heights) for site, c in enumerate((0.1, 0.8))]
    assert got == pytest.approx([0.6, 0.3])


def test_a_floor_that_nothing_touches_is_none_at_any_depth() -> None:
    """Its constant leads from nil to the first touch without a leap, which no standard deviation could tell of."""
    (effect,) = (e for e in CATALOGUE if e.id == "ground_contact")
    measures = scales("spot")
    lowest, highest = measures.height[0, [0, -1]]
    memory, state, command = at_rest("spot")
    state = state.at[8].set(lowest)  # the hand's height
    bare_z = float(bare("spot", state, command)[8])

    def height(c: float) -> float:
        return float(one_step("spot", theta("spot", effect, [c], [0]), memory, state, command, measures)[1][8])

    span = highest - lowest
    assert [height(c) for c in (0.0, 1e-3 * span, 0.5 * span, 0.99 * span)] == pytest.approx([bare_z] * 4)
    assert height(1.1 * span) == pytest.approx(lowest + 0.1 * span, abs=1e-5)


def test_reach_and_height_are_measured_of_the_hand_alone() -> None:
    """Spot's base has neither; its hand's are found at its one site."""
    base, still = np.array([2.0, -1.0]), np.zeros((5, 12))
    still[:, :2], still[:, 6:9] = base, [base[0] + 0.3, base[1] - 0.4, 0.5]
    got = measure(ROBOTS["spot"], [Recording("still", np.arange(5) / 15, still, np.zeros((5, 6)))])
    np.testing.assert_allclose(got.reach, np.full((1, 21), 0.5), rtol=1e-6)
    np.testing.assert_allclose(got.height, np.full((1, 21), 0.5), rtol=1e-6)


def test_the_clock_is_off_by_thirty_percent_at_most() -> None:
    """What goes beyond is no matter of time stamps, but of the simulator's parameters."""
    (effect,) = (e for e in CATALOGUE if e.key == "sampling_interval.constant")
    (interval,) = effect.constants
    off = [interval.physical(c, 0, scales("drive")) / DRIVE.time_step for c in (interval.low, interval.high)]
    assert off == pytest.approx([0.7, 1.3])


def test_sensors_by_hand() -> None:
    augmented = ROBOTS["drive"]
    past = jnp.array([[2.0, 20.0], [3.0, 30.0], [4.0, 40.0], [5.0, 50.0]])
    memory = Memory(jnp.zeros((HISTORY_ROWS, 1)), {}, {}, past, forgets("drive"))
    state, row = jnp.array([1.0, 10.0]), Row(jnp.asarray(30.0), jnp.ones(()))
    keys = {e.key: e for e in CATALOGUE}

    def measured(key: str, constant: float, site: int) -> np.ndarray:
        return np.asarray(sense(augmented, theta("drive", keys[key], [constant], [site]), memory, state, row))

    np.testing.assert_allclose(measured("sensor_delay", 1.0, 0), [2.0, 10.0])  # the pose only
    np.testing.assert_allclose(measured("sensor_delay", 2.5, 1), [1.0, 35.0])  # the velocities only
    np.testing.assert_allclose(measured("sensor_scale", 0.1, 1), [1.0, 11.0])
    np.testing.assert_allclose(measured("sensor_bias", -0.3, 0), [0.7, 10.0])
    np.testing.assert_allclose(measured("sensor_bias.drift", -0.6, 1), [1.0, 9.7])  # after half a minute
    all_three = sum(theta("drive", keys[key], [constant], [0]) for key, constant in
                    (("sensor_scale", 0.1), ("sensor_bias", -0.3), ("sensor_bias.drift", 0.4)))  # fmt: skip
    seen = sense(augmented, all_three, memory, state, row)
    np.testing.assert_allclose(unsense(augmented, all_three, seen, row.time_s), state, rtol=1e-6)


def test_drive_after_laws_by_hand() -> None:
    """Friction enters the force; positions follow the old velocity; all advances by a longer interval."""
    keys, command = {e.key: e for e in CATALOGUE}, jnp.array([3.0])
    memory, _, _ = at_rest("drive")
    state = jnp.array([0.5, 1.0])
    bare = np.asarray(DRIVE.step(PHI["drive"], state, command))

    def then(key: str, constant: float) -> np.ndarray:
        c = theta("drive", keys[key], [constant], [0])
        row = Row(jnp.zeros(()), jnp.array(1.5))
        return np.asarray(advance(ROBOTS["drive"], PHI["drive"], c, scales("drive"), memory, state, command, row)[1])

    def pushed(force: float) -> np.ndarray:
        return np.asarray(DRIVE.step(PHI["drive"], state, jnp.array([force])))

    close = partial(np.testing.assert_allclose, rtol=1e-5)
    close(then("viscous_drag", 0.5), pushed(2.5))
    close(then("quadratic_drag", 0.25), pushed(2.75))
    close(then("coulomb_friction", 0.5), pushed(2.5))  # well beyond where friction fades
    close(then("body_frame_bias", -0.4), pushed(2.6))
    close(then("sampling_interval.constant", 0.1), bare + 0.1 * (bare - np.array([0.5, 1.0])))
    close(then("sampling_interval.stamped", 1.0), [0.5 + 1.5 * (bare[0] - 0.5), bare[1]])
    step = scales("drive").interval[0]
    close(then("integration_rule", 1.0), [bare[0] + step * (1.0 - bare[1]), bare[1]])


# What it is called


def test_ids_are_the_vocabularys() -> None:
    assert {e.id for e in CATALOGUE} <= VOCABULARY | ADDITIONS
    keys = [e.key for e in CATALOGUE]
    assert len(keys) == len(set(keys))


def test_only_laws_that_are_switched_one_by_one_are_slight() -> None:
    """Pushes and filters are computed if one of them acts: a slight one would not count."""
    assert {e.place for e in CATALOGUE if e.slight} <= {"command", "before", "after", "sensing"}


def test_what_stands_in_theta_is_what_the_catalogue_holds() -> None:
    for augmented in ROBOTS.values():
        sizes = [len(e.constants) * len(sites) for e, sites in zip(CATALOGUE, augmented.sites, strict=True)]
        assert len(augmented.slots) == sum(sizes) == len(augmented.bounds[0])
        found = augmented.laws(jnp.arange(len(augmented.slots)), None, *{e.place for e in CATALOGUE})
        for law in found:
            for k, row in enumerate(law.c):
                for site, entry in enumerate(row):
                    assert augmented.slots[int(entry)] == Slot(CATALOGUE.index(law.effect), k, site)


@effects
def test_says_formats_with_all_its_constants(effect: Effect) -> None:
    fields = {name for _, name, _, _ in string.Formatter().parse(effect.says) if name}
    assert fields == {c.name for c in effect.constants}
    assert effect.says.format(**{c.name: "0.123 m" for c in effect.constants}).count("0.123 m") == len(fields)


# Bounds


@robots
@effects
def test_starts_lie_within_bounds_and_are_not_nil(robot: str, effect: Effect) -> None:
    for site, named in enumerate(sites_of(robot, effect)):
        starts = effect.starts(scales(robot), site)
        assert starts
        for start in starts:
            assert len(start) == len(effect.constants), named
            assert any(start)
            for c, constant in zip(start, effect.constants, strict=True):
                assert constant.low <= c <= constant.high
                assert np.isfinite(constant.physical(c, site, scales(robot)))


@robots
@effects
def test_starts_are_finite_on_recordings_where_nothing_moves(robot: str, effect: Effect) -> None:
    s, u = sizes(robot)
    time_s = np.arange(50) * ROBOTS[robot].simulator.time_step
    still = measure(ROBOTS[robot], [Recording("still", time_s, np.zeros((50, s)), np.zeros((50, u)))])
    for site in range(len(sites_of(robot, effect))):
        for start in effect.starts(still, site):
            assert np.isfinite(start).all()
            assert all(c.low <= v <= c.high for v, c in zip(start, effect.constants, strict=True))


def test_zero_lies_within_all_bounds() -> None:
    for augmented in ROBOTS.values():
        low, high = augmented.bounds
        assert (low <= 0).all()
        assert (high > 0).all()
