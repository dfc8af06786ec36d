"""Checks that an object is a usable `StepModel` or `Engine`: its members, its time step, its parameters."""

from typing import Any

from simgap.loading.engine_checks import check_rows
from simgap.loading.schema_checks import check_schema
from simgap.loading.step_checks import check_step
from simgap.loading.user_code import RAISED, check_tuple, duplicates, has, is_finite, reason, shown
from simgap.types import ConfigError, Parameter

MEMBERS = ("schema", "parameters", "time_step", "step")
"""Members of a `StepModel`."""
ENGINE_MEMBERS = ("schema", "parameters", "time_step", "parts", "terms", "rows")
"""Members of an `Engine`."""
_HELP = "docs/how_to/own_simulator.md has a complete example."


def check(simulator: Any, name: str) -> None:
    """Raise a ConfigError that begins with `name` unless the object is a usable `StepModel` or `Engine`.

    An object with `rows` is an engine; see `check_rows`. Otherwise its step is tried at the nominal parameters, with
    all states and commands zero and with typical ones. It must give a finite next state, the same each time, under
    jax.jit, jax.vmap and jax.jacfwd.
    """
    needed = ENGINE_MEMBERS if has(simulator, "rows") else MEMBERS
    missing = [m for m in needed if not has(simulator, m)]
    if missing:
        raise ConfigError(
            f"{name}: a simulator must have {', '.join(needed)}; {type(simulator).__name__} lacks "
            f"{', '.join(missing)}. Add what is missing: {_HELP}"
        )
    members = {m: _member(simulator, m, name) for m in needed}
    check_schema(members["schema"], name)
    _check_time_step(members["time_step"], name)
    _check_parameters(members["parameters"], name)
    try:
        hash(simulator)
    except RAISED as error:
        raise ConfigError(
            f"{name}: a simulator must be hashable, as compiled code is kept by it; {reason(error)}. Write "
            "@dataclass(frozen=True) over its class, with tuples for lists and arrays."
        ) from None
    (check_rows if "rows" in needed else check_step)(simulator, name)


def _member(simulator: Any, member: str, name: str) -> Any:
    try:
        return getattr(simulator, member)
    except RAISED as error:
        raise ConfigError(
            f"{name}: {member} must be there to be read; reading it gave {reason(error)}. Correct the property, or "
            "store the value when the simulator is made."
        ) from None


def _check_time_step(time_step: Any, name: str) -> None:
    if not is_finite(time_step) or time_step <= 0:
        raise ConfigError(
            f"{name}: time_step must be a positive number [s], the interval between two rows; it is "
            f"{shown(time_step)}. Write for example 0.02 for recordings at 50 Hz."
        )


def _check_parameters(parameters: Any, name: str) -> None:
    check_tuple(parameters, Parameter, "Parameter(...)", "parameters", name)
    for p in parameters:
        if not is_finite(p.low) or not is_finite(p.high) or p.low >= p.high:
            raise ConfigError(
                f"{name}: parameter {p.name}: its range must be two finite numbers with low < high; it is low = "
                f"{shown(p.low)}, high = {shown(p.high)}. Give the plausible range in {p.unit or '-'}; a value that "
                "is known for certain is a constant, no parameter."
            )
        if p.nominal is not None and not (is_finite(p.nominal) and p.low <= p.nominal <= p.high):
            raise ConfigError(
                f"{name}: parameter {p.name}: nominal must lie in the range, {p.low} to {p.high}; it is "
                f"{shown(p.nominal)}. Widen the range, or mend the value."
            )
    twice = duplicates(p.name for p in parameters)
    if twice:
        raise ConfigError(
            f"{name}: each parameter must have a name of its own; {', '.join(twice)} is there more than once. "
            "Rename it."
        )
