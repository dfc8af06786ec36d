"""Simulators of a user's own: those that hold the protocol pass, and every breach is named with what to do."""

import dataclasses
import math
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simgap.loading import trial
from simgap.loading.checks import MEMBERS, check
from simgap.loading.load import find, load, make
from simgap.simulators.spot import Spot
from simgap.types import ConfigError, Field, Parameter, Schema

CART_X = Field("p", "m", "position", "world", "cart", "x")
CART_V = Field("v", "m/s", "velocity", "world", "cart", "x")
FORCE = Field("f", "N", "force", "world", "cart", "x")
HAND_X = Field("hand", "m", "position", "world", "hand", "x")
MASS = Parameter("mass", "kg", 1.0, 3.0)


def cart(params: jax.Array, state: jax.Array, command: jax.Array) -> jax.Array:
    v = state[1] + 0.1 * command[0] / params[0]
    return jnp.stack([state[0] + 0.1 * v, v])


@dataclasses.dataclass(frozen=True)
class Cart:
    """A simulator that holds the protocol; tests replace one member."""

    time_step: Any = 0.1
    schema: Any = Schema((CART_X, CART_V), (FORCE,))  # noqa: RUF009  # frozen
    parameters: Any = (MASS,)
    law: Callable[..., Any] = cart

    def step(self, params: jax.Array, state: jax.Array, command: jax.Array) -> jax.Array:
        return self.law(params, state, command)


def complaint(simulator: Any) -> str:
    with pytest.raises(ConfigError) as caught:
        check(simulator, "mine:CART")
    message = str(caught.value)
    assert message.startswith("mine:CART: "), message
    return message


def schema_complaint(state: Any = (CART_X, CART_V), command: Any = (FORCE,), mounts: Any = ()) -> str:
    return complaint(Cart(schema=Schema(state, command, mounts)))


# What is right


@pytest.mark.parametrize("simulator", [Cart(), Spot(), Cart(parameters=(), law=lambda _, s, u: 0.9 * s + 0 * u)])
def test_usable_simulators_pass(simulator: Any) -> None:
    check(simulator, "good")


@given(states=st.integers(1, 5), commands=st.integers(0, 4), params=st.integers(0, 4))
@settings(max_examples=8, deadline=None)
def test_any_number_of_columns_and_parameters_passes(states: int, commands: int, params: int) -> None:
    fields = tuple(Field(f"s{i}", "m", "position", "world") for i in range(states))
    inputs = tuple(Field(f"u{i}", "m/s", "velocity", "body") for i in range(commands))
    ranges = tuple(Parameter(f"c{i}", "-", -1.0, 1.0) for i in range(params))
    simulator = Cart(schema=Schema(fields, inputs), parameters=ranges, law=lambda p, s, u: s + u.sum() + p.sum())
    check(simulator, "linear")


def test_the_step_is_tried_at_nominal_parameters_or_the_middle() -> None:
    seen: list[list[float]] = []

    def law(p: jax.Array, s: jax.Array, u: jax.Array) -> jax.Array:
        if not isinstance(p, jax.core.Tracer):
            seen.append(np.asarray(p).tolist())
        return cart(p, s, u)

    check(Cart(parameters=(MASS, Parameter("b", "-", 0.0, 1.0, nominal=0.75)), law=law), "cart")
    assert seen
    assert all(p == [2.0, 0.75] for p in seen)


# Found by name

USES_SPOT = "from simgap.simulators.spot import Spot\n"


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Callable[[str], str]:
    """Writes an importable module and gives its name."""
    monkeypatch.syspath_prepend(str(tmp_path))
    name = re.sub(r"\W", "_", f"made_by_{request.node.name}")

    def write(text: str) -> str:
        (tmp_path / f"{name}.py").write_text(text)
        return name

    return write


def load_complaint(spec: str, work: Callable[[str], Any] | None = None) -> str:
    """Of what `load` runs in another process, run in this one: that other one takes two seconds to start."""
    with pytest.raises(ConfigError) as caught:
        (work or (lambda spec: check(make(find(spec), spec), spec)))(spec)
    return str(caught.value)


def test_spot_has_a_name_of_its_own() -> None:
    assert load("spot") == Spot()


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("SPOT = Spot()", "SPOT"),
        ("class Mine(Spot): pass", "Mine"),
        ("def make(time_step=0.1): return Spot(time_step)", "make"),
    ],
)
def test_an_object_a_class_or_a_function(module: Callable[[str], str], text: str, name: str) -> None:
    spec = f"{module(USES_SPOT + text)}:{name}"
    assert make(find(spec), spec).schema == Spot().schema


def test_a_simulator_is_loaded_once_it_passed_in_another_process(module: Callable[[str], str]) -> None:
    spec = f"{module(USES_SPOT + 'print(1)' + chr(10) + 'SPOT = Spot()')}:SPOT"
    assert load(spec).schema == Spot().schema


@pytest.mark.parametrize(
    "spec", ["", "sport", ":", "a:", ":b", "a b:c", "examples/drive.py:DRIVE", "a.:b", ".a:b", "a:b:c", "a:b.c", "1a:b"]
)
def test_malformed_specs(spec: str) -> None:
    message = load_complaint(spec)
    assert "package.module:name" in message
    assert repr(spec) in message


@given(st.text())
@settings(max_examples=200, deadline=None)
def test_no_text_is_a_simulator_by_chance(spec: str) -> None:
    load_complaint(f"no_such_package.{spec}")


@pytest.mark.parametrize(
    ("module", "missing"),
    [("no_such_module_here", "no_such_module_here"), ("examples.no_such", "examples.no_such"), ("a.b.c", "a"),
     ("examples.drive.no", "examples.drive.no")],
)  # fmt: skip
def test_a_module_that_is_not_there(module: str, missing: str) -> None:
    message = load_complaint(f"{module}:X")
    assert f"there is no module {missing}." in message
    assert "Start the command in the folder that holds it" in message


def test_a_module_that_needs_what_is_not_there(module: Callable[[str], str]) -> None:
    message = load_complaint(f"{module('import no_such_dependency')}:X")
    assert "No module named 'no_such_dependency'" in message
    assert "line 1" in message


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("x = 1\nx / 0", "ZeroDivisionError: division by zero"),
        ("def f(:", "SyntaxError"),
        ("raise SystemExit(2)", "SystemExit: 2"),
    ],
)
def test_a_module_that_fails_when_imported(module: Callable[[str], str], text: str, says: str) -> None:
    message = load_complaint(f"{module(text)}:X")
    assert "must import without an error" in message
    assert says in message


def test_an_object_that_is_not_there(module: Callable[[str], str]) -> None:
    name = module(USES_SPOT + "SPOT = Spot()\nother = 1")
    message = load_complaint(f"{name}:Spott")
    assert "must have the object Spott" in message
    assert "(objects with a step are Spot, SPOT)" in message


@pytest.mark.parametrize("spec", ["os:abort", "os:_exit", "os:fork", "sys:exit", "math:pi"])
def test_what_is_neither_a_simulator_nor_makes_one_is_not_called(spec: str) -> None:
    assert "a simulator must have schema, parameters, time_step, step; " in load_complaint(spec)


@pytest.mark.parametrize("name", ["Spot", "run"])
def test_only_what_the_module_itself_defines_is_called(module: Callable[[str], str], name: str) -> None:
    spec = f"{module(USES_SPOT + 'from subprocess import run')}:{name}"
    home = {"Spot": "simgap.simulators.spot", "run": "subprocess"}[name]
    message = load_complaint(spec)
    assert "that makes the simulator must be defined in" in message
    assert f"Name it there, as {home}:{name}" in message


LOOP = (
    USES_SPOT
    + """
import jax, jax.numpy as jnp

class Loop(Spot):
    def step(self, params, state, command):
        return state + jax.lax.while_loop(lambda x: x < 2.0, jnp.sin, state[0])
"""
)


@pytest.mark.parametrize(
    ("text", "name", "says"),
    [
        ("import os\nos._exit(0)", "X", "importing its module must not end the process; it did (status 0)"),
        ("import os\nos.abort()", "X", "importing its module must not end the process; it did (signal 6)"),
        ("import os\ndef make(): os._exit(3)", "make", "making it must not end the process; it did (status 3)"),
        ("def make(): raise SystemExit(0)", "make", "it gave SystemExit: 0 ("),
        ("print('noise')\nraise KeyboardInterrupt", "X", "they gave KeyboardInterrupt"),
        (USES_SPOT + "class Mine(Spot):\n def step(self, *_): raise SystemExit(0)", "Mine", "it gave SystemExit: 0"),
        (USES_SPOT + "class Mine(Spot):\n def __hash__(self): raise OSError('no')", "Mine", "must be hashable"),
    ],
)  # fmt: skip
def test_code_that_ends_its_process_ends_another_one(
    module: Callable[[str], str], text: str, name: str, says: str
) -> None:
    spec = f"{module(text)}:{name}"
    message = load_complaint(spec, load)
    assert message.startswith(f"{spec}: ")
    assert says in message


def test_a_step_that_never_ends_is_stopped(module: Callable[[str], str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial, "PATIENCE_S", 15)
    message = load_complaint(f"{module(LOOP)}:Loop", load)
    assert "trying its members and its step must end; it was stopped after 15 s" in message


@pytest.mark.parametrize("member", ["schema", "parameters", "time_step", "step"])
def test_a_property_that_raises(member: str) -> None:
    class Mine(Cart):
        pass

    for error in (RuntimeError("not today"), AttributeError("not today"), SystemExit(0)):
        raising = Mine()
        with_property = type("Mine", (), {m: getattr(raising, m) for m in MEMBERS if m != member} | {
            member: property(lambda _, error=error: _raise(error))
        })  # fmt: skip
        message = complaint(with_property())
        assert f"{member} must be there to be read; reading it gave {type(error).__name__}" in message


def _raise(error: BaseException) -> None:
    raise error


def test_the_users_module_wins_over_a_library_of_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which is not replaced: others import it later."""
    (tmp_path / "pendulum.py").write_text(USES_SPOT + "class Mine(Spot): pass")
    (tmp_path / "mcap").mkdir()
    (tmp_path / "mcap" / "__init__.py").write_text("")
    (tmp_path / "mcap" / "mine.py").write_text(USES_SPOT + "class Mine(Spot): pass")
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])
    for name in ("pendulum", "mcap"):
        monkeypatch.delitem(sys.modules, name, raising=False)
        monkeypatch.delitem(sys.modules, f"own_{name}", raising=False)
    assert type(load("pendulum:Mine")).__name__ == "Mine"
    assert type(make(find("mcap.mine:Mine"), "mcap.mine:Mine")).__name__ == "Mine"
    import pendulum

    assert pendulum.DateTime
    assert "there is no module mcap.writer" in load_complaint("mcap.writer:Writer"), "the whole of it is the user's"


def test_a_class_that_wants_arguments(module: Callable[[str], str]) -> None:
    name = module("class Mine:\n def __init__(self, mass): pass")
    message = load_complaint(f"{name}:Mine")
    assert "without arguments" in message
    assert "mass" in message


def test_what_is_no_simulator(module: Callable[[str], str]) -> None:
    name = module("number = 3")
    assert load_complaint(f"{name}:number").startswith(f"{name}:number: a simulator must have schema, parameters")


def test_an_error_names_where_in_the_users_code(module: Callable[[str], str]) -> None:
    name = module(
        "from simgap.simulators.spot import Spot\nclass Mine(Spot):\n def step(self, p, s, u):\n  return p.nonsense"
    )
    message = load_complaint(f"{name}:Mine")
    assert f"{name}.py, line 4" in message
    assert "AttributeError" in message


# Members


@pytest.mark.parametrize("member", ["schema", "parameters", "time_step", "step"])
def test_a_missing_member(member: str) -> None:
    members = {m: getattr(Cart(), m) for m in ("schema", "parameters", "time_step", "step") if m != member}
    message = complaint(type("Mine", (), members)())
    assert f"Mine lacks {member}." in message


def test_a_simulator_that_cannot_be_hashed() -> None:
    mutable = dataclasses.make_dataclass("Mutable", [], bases=(Cart,), frozen=True, eq=True)
    mutable.__hash__ = None  # type: ignore[assignment]
    assert "@dataclass(frozen=True)" in complaint(mutable())


# Schema


def test_a_schema_of_another_kind() -> None:
    assert "schema must be a simgap.types.Schema; it is {'state': 1} (dict)" in complaint(Cart(schema={"state": 1}))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"state": [CART_X]}, "schema.state must be a tuple of Field; it is [Field("),
        ({"state": CART_X}, "schema.state must be a tuple of Field; it is Field("),
        ({"command": ("f",)}, "schema.command must be a tuple of Field; it holds 'f' (str)"),
        ({"state": ()}, "schema.state must have at least one Field"),
        (
            {"mounts": ("hand", "cart")},
            "schema.mounts must be a tuple of tuple; it holds 'hand' (str). Write (('hand', 'base'),),",
        ),
        ({"command": (dataclasses.replace(FORCE, name="v"),)}, "v is there more than once"),
        ({"command": (dataclasses.replace(FORCE, name="time_s"),)}, "time_s is there more than once"),
        ({"command": (dataclasses.replace(FORCE, name=""),)}, "'' is none"),
        ({"command": (dataclasses.replace(FORCE, kind="torque"),)}, "field f: kind must be one of 'position', 'angle'"),
        ({"command": (dataclasses.replace(FORCE, frame="map"),)}, "field f: frame must be one of 'world', 'body'"),
        ({"command": (dataclasses.replace(FORCE, axis="roll"),)}, "field f: axis must be one of 'x', 'y', 'z', 'yaw'"),
        ({"state": (Field("a", "deg", "angle", "world"),)}, "an angle must be in rad; its unit is 'deg'"),
        ({"command": (dataclasses.replace(FORCE, body=""),)}, "an axis must come with the body"),
        ({"command": (dataclasses.replace(FORCE, body="kart"),)}, "'kart' is not (bodies of the state: cart)"),
        (
            {"state": (CART_X, dataclasses.replace(CART_X, name="q"))},
            "fields p and q: a body must have one position or angle along an axis; both are of body 'cart', axis 'x'",
        ),
        (
            {"command": (FORCE, dataclasses.replace(FORCE, name="g", kind="velocity"))},
            "fields f and g: a body must have one velocity or force along an axis",
        ),
    ],
)
def test_a_schema_that_cannot_be_used(change: dict[str, Any], says: str) -> None:
    assert says in schema_complaint(**change)


@pytest.mark.parametrize("mount", [("hand", "base"), ("arm", "cart"), ("hand",), ("hand", "cart", "cart"), (1, 2)])
def test_a_mount_of_unknown_bodies(mount: Any) -> None:
    message = schema_complaint((CART_X, CART_V, HAND_X), mounts=(mount,))
    assert f"(cart, hand); {mount!r} is none" in message


@pytest.mark.parametrize("mount", [("cart", "hand"), ("cart", "cart")])
def test_a_carrier_comes_first(mount: tuple[str, str]) -> None:
    assert "a mount's carrier must come before" in schema_complaint((CART_X, CART_V, HAND_X), mounts=(mount,))


def test_one_carrier_for_a_body() -> None:
    state = (CART_X, dataclasses.replace(HAND_X, name="arm", body="arm"), HAND_X)
    message = schema_complaint(state, mounts=(("hand", "cart"), ("hand", "arm")))
    assert "hand is mounted more than once" in message


# Time step and parameters


@pytest.mark.parametrize("time_step", [0, -0.1, math.nan, math.inf, "0.1", None, True])
def test_a_time_step_that_is_no_interval(time_step: Any) -> None:
    message = complaint(Cart(time_step=time_step))
    assert "time_step must be a positive number [s]" in message
    assert repr(time_step) in message


@pytest.mark.parametrize("parameters", [[MASS], MASS, ("mass",), ({"mass": (1, 3)},)])
def test_parameters_of_another_kind(parameters: Any) -> None:
    assert "parameters must be a tuple of Parameter" in complaint(Cart(parameters=parameters))


numbers = st.one_of(st.floats(width=32), st.sampled_from([-1.0, 0.0, 0.5, 1.0, 2.0]))


@given(low=numbers, high=numbers, nominal=st.none() | numbers)
@settings(max_examples=100, deadline=None)
def test_a_range_holds_its_nominal_value(low: float, high: float, nominal: float | None) -> None:
    # A step that raises, lest good ranges cost a compilation: it is tried after the ranges were found good.
    def law(*_: Any) -> None:
        raise NotImplementedError

    message = complaint(Cart(parameters=(MASS, Parameter("drag", "N", low, high, nominal)), law=law))
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        assert "parameter drag: its range must be two finite numbers with low < high" in message
    elif nominal is not None and not low <= nominal <= high:
        assert "parameter drag: nominal must lie in the range" in message
    else:
        assert "NotImplementedError" in message


def test_parameters_with_one_name() -> None:
    assert "mass is there more than once" in complaint(Cart(parameters=(MASS, MASS)))


# Step


def raises(*_: Any) -> None:
    raise RuntimeError("out of order\nand more")


def branches(p: jax.Array, s: jax.Array, u: jax.Array) -> jax.Array:
    return cart(p, s, u) if s[1] > 0 else s


def by_numpy(p: jax.Array, s: jax.Array, u: jax.Array) -> np.ndarray:
    return np.asarray(s) + np.asarray(u) / np.asarray(p)


def calls_back(_p: jax.Array, s: jax.Array, _u: jax.Array) -> jax.Array:
    return jax.pure_callback(lambda s: np.asarray(s) * 0.9, s, s, vmap_method="sequential")


def changes_dtype(p: jax.Array, s: jax.Array, u: jax.Array) -> jax.Array:
    return cart(p, s, u).astype(jnp.int32)


def adds_speed(p: jax.Array, s: jax.Array, u: jax.Array) -> jax.Array:
    """The norm has no slope at zero."""
    return cart(p, s, u) + jnp.linalg.norm(s)


@pytest.mark.parametrize(
    ("law", "says"),
    [
        (raises, "arrays of 1 parameters, 2 states and 1 commands; at nominal parameters it gave RuntimeError: out of"),
        (lambda _p, s, _u: s[:1], "one array of shape (2,); it returned shape (1,)"),
        (lambda p, s, u: cart(p, s, u)[None], "it returned shape (1, 2)"),
        (lambda p, s, u: list(cart(p, s, u)), "(list). Return jnp.stack"),
        (lambda *_: None, "it returned None (NoneType)"),
        (changes_dtype, "dtype float32, as its inputs have; it returned int32"),
        (branches, "jax.jit and jax.vmap must be able to trace step; that gave TracerBoolConversionError"),
        (by_numpy, "Use jax.numpy instead of numpy and math"),
        (lambda _p, s, _u: s + math.sin(s[0]), "must be able to trace step"),
        (lambda p, s, u: cart(p, s, u) / u[0], "at nominal parameters and all states and commands zero p, v is not"),
        (lambda p, s, u: cart(p, s, u).at[1].add(jnp.log(-u[0])), "v is not"),
        (adds_speed, "all states and commands zero the derivative of p by p is nan"),
        (lambda p, s, u: cart(p, s, u) + jnp.sqrt(p[0] - 2.0), "the derivative of p by mass is inf"),
        (calls_back, "jax.jacfwd must be able to differentiate step"),
    ],
)
def test_a_step_that_cannot_be_used(law: Callable[..., Any], says: str) -> None:
    assert says in complaint(Cart(law=law))


def test_noise_in_a_step() -> None:
    rng = np.random.default_rng(0)
    message = complaint(Cart(law=lambda p, s, u: cart(p, s, u) + rng.normal()))
    assert "a second call gave another" in message


def test_memory_in_a_step() -> None:
    last = {"u": jnp.zeros(1)}

    def law(p: jax.Array, s: jax.Array, u: jax.Array) -> jax.Array:
        last["u"], before = u, last["u"]
        return cart(p, s, before)

    assert "Keep what it remembers in the state" in complaint(Cart(law=law))
