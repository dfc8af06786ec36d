"""Compiles a model so that a diagnosis can change and differentiate it."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native code, unknown to type checkers.
import mujoco

from simgap.simulators.mujoco import payloads
from simgap.simulators.mujoco.reading import compiled

TOLERANCE = 1e-12
"""Tolerance of the constraint solver: friction must be differentiable by finite differences."""
ITERATIONS = 200
"""Maximum number of iterations of the solver and of its line search."""


def ready(source: mujoco.MjSpec, carriers: dict[str, tuple[float, float, float]]) -> mujoco.MjModel:
    """A compiled model in which every term can be switched on, and whose next state depends on no hidden state."""
    spec = source.copy()
    for carrier, centre in carriers.items():
        payloads.add(spec, payloads.PREFIX + carrier, carrier, centre, 0.0)
    compensation = [body.gravcomp for body in spec.bodies]
    for body in spec.bodies[1:]:
        body.gravcomp = 1.0  # MuJoCo skips the whole computation where no body has any
    for actuator in spec.actuators:
        actuator.delay, actuator.nsample = 0.0, 0  # a delay acts on commands, outside the engine
    model = compiled(spec)
    model.body_gravcomp[:] = compensation
    option = model.opt
    option.solver, option.tolerance, option.ls_tolerance = mujoco.mjtSolver.mjSOL_NEWTON, TOLERANCE, TOLERANCE
    option.iterations = option.ls_iterations = ITERATIONS
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
    return model
