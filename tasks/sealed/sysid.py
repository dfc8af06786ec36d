"""What MuJoCo's own toolbox makes of an arm's recordings: all parameters of its model fitted to them [mujoco.sysid].

It is used as its examples show: a sequence per session, each from its first row, and friction started off its bound. It
fits the parameters that it is given and looks for no effect.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names are native code, unknown to type checkers.
from collections.abc import Collection, Mapping, Sequence
from contextlib import redirect_stdout
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pandas as pd
from absl import logging
from jaxtyping import Float
from mujoco import rollout, sysid

from tasks.sealed.judge import Row, invented_friction, moved

RANGES = {"kp": (1 / 3, 3.0), "damping": (0.1, 10.0), "armature": (0.25, 4.0), "mass": (0.7, 1 / 0.7)}
"""How far parameters may move, in shares of the model's values."""
MOST_FRICTION = 1.0
"""Of a joint [N m]; the models have none."""
MOST_ITERATIONS = 60
"""Of a fit; those of arms with three joints end after 20 to 60."""
CLAIMED = 0.02
"""Friction [N m] from which on a joint is said to have some; concealed ones have 0.15 and more."""


class _Session(NamedTuple):
    """measured: outputs in the columns' order. command: of the servos, which the joints share their names with."""

    time_s: Float[np.ndarray, " T"]
    measured: Float[np.ndarray, "T s"]
    command: Float[np.ndarray, "T u"]


def identified(model: Path, recordings: Path, heldout: Collection[str], key: Mapping[str, Any]) -> Row:
    """Fit an arm's model to its sessions that are not held out, and replay it on those that are.

    sysid_open_loop: root mean square error of positions, in their noise. sysid_moved: parameters of the model that are
    right and were changed (see `judge.moved`). sysid_friction: joints without friction that are said to have some.
    """
    logging.set_verbosity(logging.ERROR)  # it warns in every fit that states are no sensors
    spec = mujoco.MjSpec.from_file(str(model))
    joints = [joint.name for joint in spec.joints]
    sessions = {path.stem: _read(path, joints) for path in sorted(recordings.glob("*.csv"))}
    parameters = _parameters(spec)
    nominal = dict(zip(parameters.keys(), parameters.as_nominal_vector().tolist(), strict=True))
    sequences = _sequences(spec, [s for name, s in sessions.items() if name not in heldout])
    residual = sysid.build_residual_fn(models_sequences=[sequences])
    with redirect_stdout(StringIO()):  # it prints a line per iteration
        fitted, _ = sysid.optimize(parameters.move_off_bounds(), residual, verbose=False, max_iters=MOST_ITERATIONS)
    values = dict(zip(fitted.keys(), fitted.as_vector().tolist(), strict=True))
    corrected = sysid.apply_param_modifiers(fitted, spec.copy())
    errors = [_replay_errors(corrected, sessions[name], len(joints)) for name in sorted(heldout)]
    return {
        "sysid_open_loop": float(np.sqrt(np.mean(np.square(np.concatenate(errors))))) / key["floor"],
        "sysid_moved": moved(nominal, values, key),
        "sysid_friction": invented_friction((j for j in joints if values[f"frictionloss {j}"] > CLAIMED), key),
    }


def _read(path: Path, joints: Sequence[str]) -> _Session:
    table = pd.read_csv(path)
    outputs = [f"{joint}_{what}" for what in ("pos", "vel") for joint in joints if f"{joint}_{what}" in table]
    columns = (["time_s"], outputs, [f"cmd_{joint}" for joint in joints])
    time_s, measured, command = (table[list(names)].to_numpy(float) for names in columns)
    return _Session(time_s[:, 0], measured, command)


def _parameters(spec: mujoco.MjSpec) -> Any:
    """Stiffness of the servos, damping, armature and friction of the joints, and masses of the links, as the model has
    them."""
    model, parameters = spec.compile(), sysid.ParameterDict()

    def add(name: str, value: float, low: float, high: float, change: Any) -> None:
        parameters.add(sysid.Parameter(name, value, low, high, modifier=change))

    def add_share(kind: str, owner: str, value: float, change: Any) -> None:
        low, high = RANGES[kind]
        add(f"{kind} {owner}", value, low * value, high * value, change)

    for actuator in spec.actuators:
        add_share("kp", actuator.name, actuator.gainprm[0], partial(_set_stiffness, actuator.name))
    for joint in spec.joints:
        add_share("damping", joint.name, model.joint(joint.name).damping[0], partial(_set, joint.name, "damping"))
        add_share("armature", joint.name, model.joint(joint.name).armature[0], partial(_set, joint.name, "armature"))
        add(f"frictionloss {joint.name}", 0.0, 0.0, MOST_FRICTION, partial(_set, joint.name, "frictionloss"))
    for body in spec.bodies[1:]:  # the first is the world
        mass = float(model.body(body.name).mass[0])
        add_share("mass", body.name, mass, partial(_set_mass, body.name))
    return parameters


def _set(joint: str, attribute: str, spec: mujoco.MjSpec, parameter: Any) -> None:
    value = np.array(getattr(spec.joint(joint), attribute), float)
    value.flat[0] = parameter.value[0]  # damping has further coefficients, of powers of the speed
    setattr(spec.joint(joint), attribute, value if value.ndim else float(value))


def _set_stiffness(servo: str, spec: mujoco.MjSpec, parameter: Any) -> None:
    sysid.apply_pgain(spec, servo, parameter.value[0])


def _set_mass(body: str, spec: mujoco.MjSpec, parameter: Any) -> None:
    """The mass of a link; its inertia grows with it, as its shape is that of the link's geom."""
    spec.body(body).geoms[0].mass = parameter.value[0]


def _sequences(spec: mujoco.MjSpec, sessions: Sequence[_Session]) -> Any:
    """The sessions as the toolbox takes them: measured states by row, commands by step of the model.

    States, not sensors: MuJoCo computes sensors before it integrates, so that they are a time step old.
    """
    model = spec.compile()
    starts = [_start(model, s) for s in sessions]
    controls = [sysid.TimeSeries(*_commands(model, s)) for s in sessions]
    kinds = (sysid.SignalType.MjStateQPos, sysid.SignalType.MjStateQVel)[: sessions[0].measured.shape[1] // model.nq]
    columns = [(model.joint(j).name, kind) for kind in kinds for j in range(model.njnt)]
    measured = [sysid.TimeSeries.from_names(s.time_s, s.measured, model, columns) for s in sessions]
    names = [str(i) for i in range(len(sessions))]
    return sysid.ModelSequences("arm", spec, names, starts, controls, measured, allow_missing_sensors=True)


def _start(model: mujoco.MjModel, session: _Session) -> np.ndarray:
    """The first row; at rest, where no speeds are measured."""
    speed = session.measured[0, model.nq :] if session.measured.shape[1] > model.nq else np.zeros(model.nv)
    return sysid.create_initial_state(model, session.measured[0, : model.nq], speed, np.zeros(model.na))


def _commands(model: mujoco.MjModel, session: _Session) -> tuple[np.ndarray, np.ndarray]:
    """Times and commands of the model's steps; a command is held for its row."""
    steps = round((session.time_s[1] - session.time_s[0]) / model.opt.timestep)
    held = np.repeat(session.command, steps, axis=0)[: (len(session.time_s) - 1) * steps + 1]
    return np.arange(len(held)) * model.opt.timestep, held


def _replay_errors(model: mujoco.MjModel, session: _Session, joints: int) -> Float[np.ndarray, " n"]:
    """Errors of all positions in open loop from the session's first row [rad]."""
    _, command = _commands(model, session)
    states, _ = rollout.rollout(model, mujoco.MjData(model), _start(model, session)[None], command[None, :-1])
    steps = (len(command) - 1) // (len(session.time_s) - 1)
    positions = np.asarray(states)[0, steps - 1 :: steps, 1 : 1 + joints]  # the first column is the time
    return (positions - session.measured[1:, :joints]).ravel()
