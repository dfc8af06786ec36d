"""One motion that disturbs another. `law(c[k, sites], step) -> push[b, 4]`."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from simgap.effects.effect import Constant, Effect, Site, Step
from simgap.effects.sites import body_sites, mounted, turning
from simgap.kinematics import on_body, rigid
from simgap.layout import YAW, Layout, X, Y


def _carriers(layout: Layout) -> list[tuple[int, int]]:
    """(mounted body, its carrier) pairs."""
    return [(b, layout.carrier[b]) for b in mounted(layout)]  # type: ignore[misc]  # mounted bodies have one


def _carrier_sites(axes: tuple[int, ...]):
    def sites(layout: Layout) -> tuple[Site, ...]:
        found = []
        for b, carrier in _carriers(layout):
            (moved,) = body_sites(layout, [carrier], axes)
            name = f"{layout.bodies[b]} on {layout.bodies[carrier]}"
            found.append(Site(name, (), moved.outputs, name, "-"))
        return tuple(found)

    return sites


def _mounted_sites(layout: Layout) -> tuple[Site, ...]:
    return body_sites(layout, mounted(layout), (X, Y))


def _arm_acceleration(c: Float[Array, "1 n"], step: Step) -> Float[Array, "b 4"]:
    """Push on the carrier, -c (w' - w), w the mounted body's relative velocity: reaction to its acceleration."""
    out = jnp.zeros_like(step.now.velocity)
    for k, (b, carrier) in enumerate(_carriers(step.layout)):
        change = step.then.velocity[b, :2] - step.now.velocity[b, :2]
        out = out - on_body(step.layout, carrier, X, c[0, k] * change)
    return out


def _arm_velocity(c: Float[Array, "1 n"], step: Step) -> Float[Array, "b 4"]:
    """Push on the carrier, -c w: it gives way in proportion to the mounted body's relative velocity."""
    out = jnp.zeros_like(step.now.velocity)
    for k, (b, carrier) in enumerate(_carriers(step.layout)):
        out = out - on_body(step.layout, carrier, X, c[0, k] * step.then.velocity[b, :2])
    return out


def _arm_moment(c: Float[Array, "1 n"], step: Step) -> Float[Array, "b 4"]:
    """Yaw push on the carrier, -c (r x (w' - w)): moment of the mounted body's acceleration."""
    out = jnp.zeros_like(step.now.velocity)
    for k, (b, carrier) in enumerate(_carriers(step.layout)):
        change, arm = step.then.velocity[b] - step.now.velocity[b], step.now.position[b]
        out = out - on_body(step.layout, carrier, YAW, c[0, k] * (arm[X] * change[Y] - arm[Y] * change[X]))
    return out


def _base_acceleration(c: Float[Array, "1 n"], step: Step) -> Float[Array, "b 4"]:
    """Push on the mounted body, -c (V' - V), V the carrier's velocity at its place: it lags behind the acceleration."""
    out = jnp.zeros_like(step.now.velocity)
    for k, (b, carrier) in enumerate(_carriers(step.layout)):
        arm = step.now.position[b]
        change = rigid(step.then.velocity[carrier], arm) - rigid(step.now.velocity[carrier], arm)
        out = out - on_body(step.layout, b, X, c[0, k] * change)
    return out


def _induced(c: Float[Array, "1 n"], step: Step) -> Float[Array, "b 4"]:
    """Push on the mounted body, c w x r: the share of the velocity induced by turning that the simulator lacks."""
    out = jnp.zeros_like(step.now.velocity)
    for k, (b, carrier) in enumerate(_carriers(step.layout)):
        arm = step.now.position[b]
        sideways = jnp.stack([-arm[Y], arm[X]])
        out = out + on_body(step.layout, b, X, c[0, k] * step.then.velocity[carrier, YAW] * sideways)
    return out


def _centripetal(c: Float[Array, "1 n"], step: Step) -> Float[Array, "b 4"]:
    """Push on the mounted body, c w^2 r, outwards."""
    out = jnp.zeros_like(step.now.velocity)
    for k, (b, carrier) in enumerate(_carriers(step.layout)):
        omega = step.then.velocity[carrier, YAW]
        out = out + on_body(step.layout, b, X, c[0, k] * omega**2 * step.now.position[b, :2])
    return out


def _rotation_centre(c: Float[Array, "2 n"], step: Step) -> Float[Array, "b 4"]:
    """Push w x (-c): the body turns about the point c of its own frame."""
    out = jnp.zeros_like(step.now.velocity)
    for k, b in enumerate(turning(step.layout)):
        omega = step.then.velocity[b, YAW]
        out = out + on_body(step.layout, b, X, omega * jnp.stack([c[1, k], -c[0, k]]))
    return out


def _turning_sites(layout: Layout) -> tuple[Site, ...]:
    return body_sites(layout, turning(layout), (X, Y))


def _with_turning_carrier(layout: Layout) -> tuple[Site, ...]:
    return _mounted_sites(layout) if turning(layout) else ()


_RATIO = (Constant("ratio", "-", low=-1.5, high=1.5),)

EFFECTS = (
    Effect(
        "arm_base_coupling", "push", _RATIO, _carrier_sites((X, Y)), lambda scales, site: [[0.1]], _arm_acceleration,
        "reaction: accelerating the arm pushes the base back, by {ratio} of the arm's acceleration",
        form="acceleration", bends=("past", "speed"),
    ),
    Effect(
        "arm_base_coupling", "push", _RATIO, _carrier_sites((X, Y)), lambda scales, site: [[0.1]], _arm_velocity,
        "reaction: moving the arm pushes the base back, by {ratio} of the arm's velocity", form="velocity",
        bends=("past", "speed"),
    ),
    Effect(
        "arm_base_coupling", "push", (Constant("ratio", "rad/m^2", low=-5.0, high=5.0),), _carrier_sites((YAW,)),
        lambda scales, site: [[0.1]], _arm_moment,
        "reaction: moving the arm turns the base, by {ratio} of the moment of the arm's acceleration", form="moment",
        bends=("past", "speed"),
    ),
    Effect(
        "base_arm_coupling", "push", _RATIO, _mounted_sites, lambda scales, site: [[0.1]], _base_acceleration,
        "accelerating the base drags the arm beyond rigid motion, by {ratio} of the acceleration",
        bends=("past", "speed"),
    ),
    Effect(
        "induced_velocity", "push", (Constant("share", "-", low=-1.5, high=1.5),), _with_turning_carrier,
        lambda scales, site: [[0.2]], _induced,
        "turning the base carries the arm along, by {share} more of yaw rate times reach than simulated",
    ),
    Effect(
        "centripetal", "push", (Constant("coefficient", "s", low=-1.0, high=1.0),), _with_turning_carrier,
        lambda scales, site: [[0.05]], _centripetal,
        "turning throws the arm outwards: {coefficient} times the squared yaw rate times its reach",
    ),
    Effect(
        "rotation_centre", "push",
        (Constant("offset x", "m", low=-1.0, high=1.0), Constant("offset y", "m", low=-1.0, high=1.0)), _turning_sites,
        lambda scales, site: [[0.05, 0.05]], _rotation_centre,
        "the base turns about a point {offset x} ahead and {offset y} to the left of its origin",
    ),
)  # fmt: skip
