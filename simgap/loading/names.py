"""Which simulator a text names. Cheap to import: an unknown name is reported before JAX is loaded."""

import importlib.util
import sys
import sysconfig
from collections.abc import Iterator
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import NamedTuple

from simgap.types import ConfigError

BUILT_IN = ("spot",)
"""Simulators with a name of their own."""
_LIBRARIES = tuple(Path(sysconfig.get_path(p)) for p in ("stdlib", "purelib", "platlib"))


class Place(NamedTuple):
    """Where an object is: in which module, and under what name."""

    module: str
    name: str


def place(spec: str) -> Place:
    """Module and name in `package.module:name`; runs no user code. ConfigError where the form is wrong or there is no
    such module."""
    module, colon, name = spec.partition(":")
    if not colon or not name.isidentifier() or not all(part.isidentifier() for part in module.split(".")):
        raise ConfigError(
            f"The simulator must be {' or '.join(BUILT_IN)}, a model file (.xml, .mjcf, .urdf), or given as "
            f"package.module:name, like examples.drive:DRIVE; {spec!r} is none of these. Write the module with dots, "
            "without .py, and the object's name behind a colon."
        )
    for missing in _missing(module):
        raise ConfigError(
            f"{spec}: there is no module {missing}. Start the command in the folder that holds it, correct the name, "
            "or install the package into this environment."
        )
    return Place(module, name)


def users_own(top: str) -> ModuleSpec | None:
    """The user's own module of that name, where a library has one of the same name; None otherwise.

    The user means their own. It must not replace the library's, which other libraries import.
    """
    folders = {library: [p for p in sys.path if _in_library(p) == library] for library in (True, False)}
    own, other = (PathFinder.find_spec(top, folders[library]) for library in (False, True))
    # Without a loader it is only a folder; Python prefers any module over that.
    return own if own is not None and own.loader is not None and other is not None else None


def _in_library(entry: str) -> bool:
    return any(Path(entry).is_relative_to(folder) for folder in _LIBRARIES)


def _missing(module: str) -> Iterator[str]:
    """The first of the module and its parent packages that does not exist."""
    parts = module.split(".")
    spec = users_own(parts[0]) or _spec(parts[0])
    for k in range(len(parts)):
        name = ".".join(parts[: k + 1])
        if k and spec is not None:
            inside = spec.submodule_search_locations
            spec = PathFinder.find_spec(name, inside) if inside else None
        if spec is None:
            yield name
            return


def _spec(top: str) -> ModuleSpec | None:
    try:
        return importlib.util.find_spec(top)
    except ValueError:  # for a module that was not imported, such as __main__
        return None
