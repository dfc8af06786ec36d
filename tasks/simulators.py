"""Simulators of a user's own: found by name, and checked before anything is computed with them.

What a simulator gets wrong shows up far from its cause, as a fit that does not converge; so every member is looked at
here, and a message says what must hold, what came and what to do. The check runs the user's code for the first time: it
runs in a process of its own (`tasks.trial`), as that code may end its process or never end.
"""

import importlib
import importlib.util
import inspect
import math
import sys
import sysconfig
import traceback
from collections.abc import Iterable, Sequence
from numbers import Real
from types import FunctionType, ModuleType
from typing import Any, NamedTuple, cast, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simgap.simulators.spot import Spot
from simgap.types import Axis, ConfigError, Field, Frame, Kind, Parameter, Schema, StepModel
from tasks import simulator_names, trial
from tasks.simulator_names import BUILT_IN

MEMBERS = ("schema", "parameters", "time_step", "step")
"""What a `StepModel` has."""
_TYPICAL = {"position": 0.3, "angle": 0.3, "velocity": 0.2, "force": 1.0}
# Kinds that say the same of a body's axis: where it is, how fast it moves, what drives it.
_STATE_ROLES = {"position": "position or angle", "angle": "position or angle", "velocity": "velocity"}
_COMMAND_ROLES = {"velocity": "velocity or force", "force": "velocity or force"}
_HELP = "docs/simulators.md has a complete example."
_RAISED = (Exception, SystemExit)
"""What a user's code may raise: anything, and a script without a guard even exits."""


def load(spec: str) -> StepModel:
    """The simulator that `spec` names: a built-in one, or `package.module:name`, an object or what makes one.

    `name` may be an instance, or a class or function of that module that gives one when called without arguments. The
    module must be importable as it stands. Raises ConfigError when there is no such simulator, when it fails `check`,
    or when its code ends its process or does not end.
    """
    if spec in BUILT_IN:
        return Spot()
    trial.check(spec)
    return cast(StepModel, make(find(spec), spec))


def find(spec: str) -> Any:
    """What `package.module:name` names, as it stands there."""
    module, name = simulator_names.place(spec)
    try:
        found = _imported(module)
    except ImportError as error:
        raise ConfigError(
            f"{spec}: the module {module} must be importable; importing it gave {reason(error)}. Install what it needs "
            "into this environment."
        ) from None
    except _RAISED as error:
        raise ConfigError(
            f"{spec}: the module {module} must import without an error; importing it gave {reason(error)}. Correct the "
            "module, and keep what a script does below `if __name__ == '__main__':`."
        ) from None
    if hasattr(found, name):
        return getattr(found, name)
    there = [n for n, value in vars(found).items() if not n.startswith("_") and _has(value, "step")]
    raise ConfigError(
        f"{spec}: the module must have the object {name}; it has not. Correct the name behind the colon (objects with "
        f"a step are {', '.join(there) or 'none'})."
    )


def _imported(module: str) -> ModuleType:
    """The module; the user's own where a library's has its name, under another name: the library keeps its place."""
    top, dot, rest = module.partition(".")
    own = simulator_names.users_own(top)
    if own is None:
        return importlib.import_module(module)
    alias = f"own_{top}"
    if alias not in sys.modules:
        found = importlib.util.spec_from_file_location(
            alias, own.origin, submodule_search_locations=own.submodule_search_locations
        )
        assert found is not None  # it has a loader
        assert found.loader is not None
        sys.modules[alias] = importlib.util.module_from_spec(found)
        try:
            found.loader.exec_module(sys.modules[alias])
        except BaseException:
            del sys.modules[alias]
            raise
    return importlib.import_module(f"{alias}{dot}{rest}")


def make(found: Any, spec: str) -> Any:
    """The object itself, or what the class or function gives that its module defines; nothing else is called."""
    if not isinstance(found, type | FunctionType):
        return found
    module, name = simulator_names.place(spec)
    if found.__module__ not in (module, f"own_{module}"):
        raise ConfigError(
            f"{spec}: a class or function that makes the simulator must be defined in {module}; this one is of "
            f"{found.__module__}. Name it there, as {found.__module__}:{found.__name__}, or write "
            f"`SIMULATOR = {name}()` in {module} and give {module}:SIMULATOR."
        )
    try:
        return found()
    except _RAISED as error:
        raise ConfigError(
            f"{spec}: a class or function must give the simulator when called without arguments; it gave "
            f"{reason(error)}. Give its arguments defaults, or name an object that is made already."
        ) from None


def check(simulator: Any, name: str) -> None:
    """Raise a ConfigError that begins with `name` unless the object is a usable `StepModel`.

    The step is tried at the nominal parameters, with all states and commands zero and with typical ones: it must give
    a finite next state, the same each time, under jax.jit, jax.vmap and jax.jacfwd.
    """
    missing = [m for m in MEMBERS if not _has(simulator, m)]
    if missing:
        raise ConfigError(
            f"{name}: a simulator must have {', '.join(MEMBERS)}; {type(simulator).__name__} lacks "
            f"{', '.join(missing)}. Add what is missing: {_HELP}"
        )
    members = {m: _member(simulator, m, name) for m in MEMBERS}
    _check_schema(members["schema"], name)
    _check_time_step(members["time_step"], name)
    _check_parameters(members["parameters"], name)
    try:
        hash(simulator)
    except _RAISED as error:
        raise ConfigError(
            f"{name}: a simulator must be hashable, as compiled code is kept by it; {reason(error)}. Write "
            "@dataclass(frozen=True) over its class, with tuples for lists and arrays."
        ) from None
    _check_step(simulator, name)


def _has(simulator: Any, member: str) -> bool:
    """Whether it has the member, without running code of its own."""
    try:
        inspect.getattr_static(simulator, member)
    except AttributeError:
        return False
    return True


def _member(simulator: Any, member: str, name: str) -> Any:
    try:
        return getattr(simulator, member)
    except _RAISED as error:
        raise ConfigError(
            f"{name}: {member} must be there to be read; reading it gave {reason(error)}. Correct the property, or "
            "store the value when the simulator is made."
        ) from None


# Schema


def _check_schema(schema: Any, name: str) -> None:
    if not isinstance(schema, Schema):
        raise ConfigError(
            f"{name}: schema must be a simgap.types.Schema; it is {_shown(schema)}. Write "
            "Schema(state=(Field(...), ...), command=(Field(...), ...))."
        )
    for what, fields in (("state", schema.state), ("command", schema.command)):
        _check_tuple(fields, Field, "Field(...)", f"schema.{what}", name)
        for field in fields:
            _check_field(field, name)
    if not schema.state:
        raise ConfigError(
            f"{name}: schema.state must have at least one Field; it has none. What is not measured cannot be "
            "diagnosed: add the columns that its recordings have. (schema.command may be empty.)"
        )
    twice = _duplicates(schema.columns)
    if twice:
        raise ConfigError(
            f"{name}: each of time_s and the fields must have a name of its own; {', '.join(twice)} is there more than "
            "once. Rename the field: a name is a column of the recordings."
        )
    _check_geometry(schema, name)


def _check_field(field: Field, name: str) -> None:
    if not isinstance(field.name, str) or not field.name:
        raise ConfigError(
            f"{name}: a Field's name must be a column's name; {field.name!r} is none. Write it as in the recordings."
        )
    for member, allowed in (("kind", get_args(Kind)), ("frame", get_args(Frame)), ("axis", get_args(Axis))):
        value = getattr(field, member)
        if value not in allowed:
            raise ConfigError(
                f"{name}: field {field.name}: {member} must be one of {', '.join(repr(a) for a in allowed)}; it is "
                f"{value!r}. Choose one of these."
            )
    if field.kind == "angle" and field.unit != "rad":
        raise ConfigError(
            f"{name}: field {field.name}: an angle must be in rad; its unit is {field.unit!r}. Convert it to rad in "
            "simulator and recordings."
        )
    if field.axis and not field.body:
        raise ConfigError(
            f"{name}: field {field.name}: an axis must come with the body that moves along it; the axis is "
            f"{field.axis!r} and the body is empty. Name the body, or leave both out."
        )


def _check_geometry(schema: Schema, name: str) -> None:
    """Bodies and axes are told apart, and mounts join bodies that there are."""
    # In the order of their first state column, as simgap.layout counts them.
    bodies = list(dict.fromkeys(f.body for f in schema.state if f.body))
    known = ", ".join(bodies) or "none"
    for field in schema.command:
        if field.body and field.body not in bodies:
            raise ConfigError(
                f"{name}: field {field.name}: a command's body must be the body of a state too; {field.body!r} is not "
                f"(bodies of the state: {known}). Name one of them, or leave body and axis out."
            )
    for fields, roles in ((schema.state, _STATE_ROLES), (schema.command, _COMMAND_ROLES)):
        taken: dict[tuple[str, str, str], str] = {}
        for field in fields:
            if not field.body or not field.axis:
                continue
            key = (field.body, field.axis, roles.get(field.kind, field.kind))
            if key in taken:
                raise ConfigError(
                    f"{name}: fields {taken[key]} and {field.name}: a body must have one {key[2]} along an axis; both "
                    f"are of body {field.body!r}, axis {field.axis!r}. Give one of them its own body or axis, or leave "
                    "body and axis out."
                )
            taken[key] = field.name
    _check_tuple(schema.mounts, tuple, "('hand', 'base')", "schema.mounts", name)
    for mount in schema.mounts:
        if len(mount) != 2 or not all(body in bodies for body in mount):
            raise ConfigError(
                f"{name}: a mount must be a pair (body, carrier) of bodies that the state names ({known}); "
                f"{mount!r} is none. Mend the names."
            )
        body, carrier = mount
        # Motions are computed carrier first; this also rules out circles.
        if bodies.index(carrier) >= bodies.index(body):
            raise ConfigError(
                f"{name}: a mount's carrier must come before the body it carries in schema.state; in {mount!r} "
                f"{carrier!r} does not. Move the carrier's fields to the front, or swap the pair (body, carrier)."
            )
    twice = _duplicates(body for body, _ in schema.mounts)
    if twice:
        raise ConfigError(
            f"{name}: a body must be mounted on one carrier; {', '.join(twice)} is mounted more than once. Keep the "
            "carrier that turns it."
        )


# Time step and parameters


def _check_time_step(time_step: Any, name: str) -> None:
    if not _is_finite(time_step) or time_step <= 0:
        raise ConfigError(
            f"{name}: time_step must be a positive number [s], the interval between two rows; it is "
            f"{_shown(time_step)}. Write for example 0.02 for recordings at 50 Hz."
        )


def _check_parameters(parameters: Any, name: str) -> None:
    _check_tuple(parameters, Parameter, "Parameter(...)", "parameters", name)
    for p in parameters:
        if not _is_finite(p.low) or not _is_finite(p.high) or p.low >= p.high:
            raise ConfigError(
                f"{name}: parameter {p.name}: its range must be two finite numbers with low < high; it is low = "
                f"{_shown(p.low)}, high = {_shown(p.high)}. Give the plausible range in {p.unit or '-'}; a value that "
                "is known for certain is a constant, no parameter."
            )
        if p.nominal is not None and not (_is_finite(p.nominal) and p.low <= p.nominal <= p.high):
            raise ConfigError(
                f"{name}: parameter {p.name}: nominal must lie in the range, {p.low} to {p.high}; it is "
                f"{_shown(p.nominal)}. Widen the range, or mend the value."
            )
    twice = _duplicates(p.name for p in parameters)
    if twice:
        raise ConfigError(
            f"{name}: each parameter must have a name of its own; {', '.join(twice)} is there more than once. "
            "Rename it."
        )


# Step


class _Trial(NamedTuple):
    """Where a step is tried: nominal parameters; all states and commands zero, and typical ones."""

    params: Float[Array, " p"]
    states: Float[Array, "2 s"]
    commands: Float[Array, "2 u"]


_POINTS = ("all states and commands zero", "typical states and commands")


def _check_step(simulator: StepModel, name: str) -> None:
    # What compiles comes last: most mistakes show without.
    trial = _trial(simulator)
    first = _outputs(simulator, trial, name)
    # All points again in the same order: what a step remembers of one point shows at the other.
    if not np.array_equal(first, _outputs(simulator, trial, name), equal_nan=True):
        raise ConfigError(
            f"{name}: step must give the same next state for the same input; a second call gave another. Keep what it "
            "remembers in the state, and leave random numbers out: noise is estimated from the recordings."
        )
    _check_traceable(simulator, trial, name)
    for values, point in zip(first, _POINTS, strict=True):
        bad = [f.name for f, v in zip(simulator.schema.state, values, strict=True) if not np.isfinite(v)]
        if bad:
            raise ConfigError(
                f"{name}: step must return finite numbers; at nominal parameters and {point} {', '.join(bad)} is not. "
                "Look for a division by zero or a root of a negative number; choose its argument with jnp.where."
            )
    _check_differentiable(simulator, trial, name)


def _trial(simulator: StepModel) -> _Trial:
    params = [(p.low + p.high) / 2 if p.nominal is None else p.nominal for p in simulator.parameters]
    states, commands = (
        # No two values alike: a hand that lies on its base has no direction.
        jnp.array([[_TYPICAL[f.kind] * (1 + 0.1 * i) * scale for i, f in enumerate(fields)] for scale in (0, 1)])
        for fields in (simulator.schema.state, simulator.schema.command)
    )
    return _Trial(jnp.array(params, float), states, commands)


def _outputs(simulator: StepModel, trial: _Trial, name: str) -> Float[np.ndarray, "2 s"]:
    """The next states, of the right shape."""
    params, states, commands = trial
    try:
        outputs = [simulator.step(params, s, u) for s, u in zip(states, commands, strict=True)]
    except _RAISED as error:
        raise ConfigError(
            f"{name}: step must run on arrays of {len(params)} parameters, {states.shape[1]} states and "
            f"{commands.shape[1]} commands; at nominal parameters it gave {reason(error)}. Mend the step."
        ) from None
    for output in outputs:
        shape = getattr(output, "shape", None)
        if shape != states[0].shape:
            raise ConfigError(
                f"{name}: step must return the next state, one array of shape {states[0].shape}; it returned "
                f"{_shown(output) if shape is None else f'shape {shape}'}. Return jnp.stack([...]) of one number per "
                "Field of schema.state, in its order."
            )
    return np.stack([np.asarray(output) for output in outputs])


def _check_traceable(simulator: StepModel, trial: _Trial, name: str) -> None:
    params, states, commands = trial
    try:
        traced = jax.eval_shape(simulator.step, params, states[0], commands[0])
        jax.eval_shape(jax.vmap(simulator.step, (None, 0, 0)), params, states, commands)
    except _RAISED as error:
        raise ConfigError(
            f"{name}: jax.jit and jax.vmap must be able to trace step; that gave {reason(error)}. Use jax.numpy "
            "instead of numpy and math, and jnp.where instead of `if` on values."
        ) from None
    if traced.dtype != states.dtype:
        raise ConfigError(
            f"{name}: step must return an array of dtype {states.dtype}, as its inputs have; it returned "
            f"{traced.dtype}. Compute the next state from the state, without converting it."
        )


def _check_differentiable(simulator: StepModel, trial: _Trial, name: str) -> None:
    def slopes(*point: Array) -> list[Array]:
        # One argument at a time: an infinite slope makes the slopes by all that are taken together nan.
        return [jax.jacfwd(simulator.step, argument)(*point) for argument in (1, 2, 0)]

    try:
        jacobians = jax.jit(jax.vmap(slopes, (None, 0, 0)))(*trial)
    except _RAISED as error:
        raise ConfigError(
            f"{name}: jax.jacfwd must be able to differentiate step; that gave {reason(error)}. Use operations of "
            "jax.numpy, without callbacks to Python and without custom_vjp."
        ) from None
    schema = simulator.schema
    for inputs, jacobian in zip((schema.state, schema.command, simulator.parameters), jacobians, strict=True):
        bad = np.argwhere(~np.isfinite(np.asarray(jacobian)))
        if len(bad):
            point, output, column = bad[0]
            raise ConfigError(
                f"{name}: step must be differentiable at nominal parameters; at {_POINTS[point]} the derivative of "
                f"{schema.state[output].name} by {inputs[column].name} is {jacobian[point, output, column]}. Look for "
                "sqrt, a norm, arctan2, a power or a division at zero: add a small number under the root, and choose "
                "the argument (not the result) with jnp.where."
            )


# Words


def _check_tuple(values: Any, kind: type, example: str, what: str, name: str) -> None:
    good = isinstance(values, tuple)
    wrong = [v for v in values if not isinstance(v, kind)] if good else [values]
    if wrong:
        raise ConfigError(
            f"{name}: {what} must be a tuple of {kind.__name__}; {'it holds' if good else 'it is'} {_shown(wrong[0])}. "
            f"Write ({example},), with the comma also where there is only one."
        )


def _is_finite(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


def _duplicates(names: Iterable[str]) -> list[str]:
    names = list(names)
    return [n for n in dict.fromkeys(names) if names.count(n) > 1]


def _shown(value: Any) -> str:
    try:
        text = repr(value)
    except _RAISED:  # a user's own
        return f"one whose repr fails ({type(value).__name__})"
    return f"{text if len(text) <= 60 else text[:57] + '...'} ({type(value).__name__})"


def reason(error: BaseException) -> str:
    """The error in one line, and where in the user's code it arose."""
    said = f"{type(error).__name__}: {(str(error).splitlines() or [''])[0]}"
    frame = _own_frame(traceback.extract_tb(error.__traceback__))
    return f"{said} ({frame.filename}, line {frame.lineno})" if frame else said


def _own_frame(frames: Sequence[traceback.FrameSummary]) -> traceback.FrameSummary | None:
    """The innermost frame that is neither this module's nor a library's."""
    libraries = tuple(sysconfig.get_path(p) for p in ("stdlib", "purelib", "platlib"))
    own = [f for f in frames if not f.filename.startswith((*libraries, __file__, "<"))]
    return own[-1] if own else None
