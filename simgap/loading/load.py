"""Loads the simulator that a text names."""

import importlib
import importlib.util
import sys
from collections.abc import Callable
from types import FunctionType, ModuleType
from typing import Any, NamedTuple, cast

import numpy as np

from simgap.engines import Engine
from simgap.formats.peek import Seen
from simgap.loading import names, trial
from simgap.loading.model_files import ModelFile
from simgap.loading.names import BUILT_IN
from simgap.loading.user_code import RAISED, has, reason
from simgap.simulators.spot import Spot
from simgap.types import ConfigError, Sessions, StepModel


class Used(NamedTuple):
    """A simulator in use, its name, and the record of its model file, if it has one (see `recalled`).

    left_out: why joints of the model file are left out although they are recorded, in words.
    """

    simulator: StepModel | Engine
    name: str
    model_file: dict[str, Any] | None = None
    left_out: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """Parts of a model file that are left out or cannot be diagnosed, in words."""
        return () if self.model_file is None else (*self.left_out, *cast(Any, self.simulator).notes)


def prepared(simulator: str | ModelFile, see: Callable[[], Seen]) -> Used:
    """The simulator that a name or a model file stands for. `see()` looks at the recordings, which a model file needs.

    Raises as `load` and `ModelFile.engine` do.
    """
    if not isinstance(simulator, ModelFile):
        return Used(load(simulator), simulator)
    seen = see()
    return Used(simulator.engine(seen), str(simulator), simulator.remembered(seen))


def started(used: Used, sessions: Sessions, say: Callable[[str], None]) -> Used:
    """The simulator that a diagnosis of these sessions starts from.

    Where replays show that the stiffness of a model file's position servos is far off, they are rescaled, and `say`
    reports it. The search then starts near its result.
    """
    if used.model_file is None:
        return used
    from simgap.simulators.mujoco import rescaled, rescaling, scan, servo_errors

    replays = scan(cast(Any, used.simulator), sessions.fitted)
    if replays is None or not replays.far:
        return used
    engine = rescaled(cast(Any, used.simulator), replays.start)
    say(rescaling(engine))
    found = servo_errors.servo_errors(engine, engine.nominal, np.zeros(len(engine.terms)), sessions.fitted)
    if said := servo_errors.words(found, engine.time_step):
        say(said)
    return used._replace(simulator=cast(Engine, engine), model_file=used.model_file | {"start": replays.start})


def load(spec: str) -> StepModel | Engine:
    """The simulator that `spec` names: a built-in one, or `package.module:name`.

    `name` may be an instance, or a class or function of that module that returns one when called without arguments. The
    module must be importable as it is. Raises ConfigError when there is no such simulator, when it fails `check`, or
    when its code ends its process or does not end.
    """
    if spec in BUILT_IN:
        return Spot()
    trial.check(spec)
    return cast(StepModel | Engine, make(find(spec), spec))


def find(spec: str) -> Any:
    """The object that `package.module:name` names; ConfigError where there is none."""
    module, name = names.place(spec)
    try:
        imported = _imported(module)
    except ImportError as error:
        raise ConfigError(
            f"{spec}: the module {module} must be importable; importing it gave {reason(error)}. Install what it needs "
            "into this environment."
        ) from None
    except RAISED as error:
        raise ConfigError(
            f"{spec}: the module {module} must import without an error; importing it gave {reason(error)}. Correct the "
            "module, and keep what a script does below `if __name__ == '__main__':`."
        ) from None
    if hasattr(imported, name):
        return getattr(imported, name)
    there = [n for n, value in vars(imported).items() if not n.startswith("_") and has(value, "step")]
    raise ConfigError(
        f"{spec}: the module must have the object {name}; it has not. Correct the name behind the colon (objects with "
        f"a step are {', '.join(there) or 'none'})."
    )


def _imported(module: str) -> ModuleType:
    """The module. If a library has the same name, the user's own is imported under another name."""
    top, dot, rest = module.partition(".")
    own = names.users_own(top)
    if own is None:
        return importlib.import_module(module)
    alias = f"own_{top}"
    if alias not in sys.modules:
        spec = importlib.util.spec_from_file_location(
            alias, own.origin, submodule_search_locations=own.submodule_search_locations
        )
        assert spec is not None  # it has a loader
        assert spec.loader is not None
        sys.modules[alias] = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(sys.modules[alias])
        except BaseException:
            del sys.modules[alias]
            raise
    return importlib.import_module(f"{alias}{dot}{rest}")


def make(found: Any, spec: str) -> Any:
    """The object itself; for a class or function that its module defines, what it returns. Nothing else is called."""
    if not isinstance(found, type | FunctionType):
        return found
    module, name = names.place(spec)
    if found.__module__ not in (module, f"own_{module}"):
        raise ConfigError(
            f"{spec}: a class or function that makes the simulator must be defined in {module}; this one is of "
            f"{found.__module__}. Name it there, as {found.__module__}:{found.__name__}, or write "
            f"`SIMULATOR = {name}()` in {module} and give {module}:SIMULATOR."
        )
    try:
        return found()
    except RAISED as error:
        raise ConfigError(
            f"{spec}: a class or function must give the simulator when called without arguments; it gave "
            f"{reason(error)}. Give its arguments defaults, or name an object that is made already."
        ) from None
