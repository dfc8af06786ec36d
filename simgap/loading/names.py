"""Which simulator a text names. Cheap to import: a name that leads nowhere is reported before JAX is loaded."""

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
    """What `package.module:name` says. No user's code runs; ConfigError where it says nothing or no such module is."""
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
    """The user's own module of that name, where a library has the name too: the user means the own one.

    It must not take the library's place, which other libraries import. None where no two share the name.
    """
    folders = {library: [p for p in sys.path if _in_library(p) == library] for library in (True, False)}
    own, other = (PathFinder.find_spec(top, folders[library]) for library in (False, True))
    # Without a loader it is a mere folder, over which Python prefers any module.
    return own if own is not None and own.loader is not None and other is not None else None


def _in_library(entry: str) -> bool:
    return any(Path(entry).is_relative_to(folder) for folder in _LIBRARIES)


def _missing(module: str) -> Iterator[str]:
    """The first of the module and the packages above it that is not there."""
    parts = module.split(".")
    found = users_own(parts[0]) or _spec(parts[0])
    for k in range(len(parts)):
        name = ".".join(parts[: k + 1])
        if k and found is not None:
            inside = found.submodule_search_locations
            found = PathFinder.find_spec(name, inside) if inside else None
        if found is None:
            yield name
            return


def _spec(top: str) -> ModuleSpec | None:
    try:
        return importlib.util.find_spec(top)
    except ValueError:  # of what was not imported, such as __main__
        return None
