"""The form of every name that becomes a file or a folder: a source, a run, a sealed suite, a case."""

import re
from collections.abc import Collection

from simgap.types import ConfigError

PATTERN = "[A-Za-z0-9][A-Za-z0-9_-]*"
LONGEST = 100
"""Characters of a name at most; file systems admit 255, and files' names end in more than the name."""
ALIASES = r"[Ll]atest|[Nn]ewest|[Vv][0-9]+"
"""Names of versions that MLflow uses itself, or that are given to the last one: no run is called so."""


def check(name: str, what: str = "a name") -> str:
    """The name as it is; ConfigError where it could lead out of a folder, hide in it, or be read as an option.

    `what` begins the message: what is called so.
    """
    if len(name) > LONGEST or not re.fullmatch(PATTERN, name):
        raise ConfigError(
            f"{what} is {name[:LONGEST]!r}; it becomes a file or folder, so it must begin with a letter or digit and "
            f"hold only letters, digits, dashes and underscores, at most {LONGEST}. Give another name."
        )
    return name


def check_run(name: str) -> str:
    """The name of a run as it is; ConfigError where it is no folder's, or an alias of MLflow's own."""
    if re.fullmatch(ALIASES, name, re.IGNORECASE):
        raise ConfigError(f"The run's name is {name!r}, an alias that MLflow uses itself. Give another name.")
    return check(name, "the run's name")


def no_source(source: str, known: Collection[str]) -> ConfigError:
    """The error where params.yaml's `recordings` has no block of that name."""
    return ConfigError(
        f"params.yaml has no block recordings.{source}; there are {', '.join(known)}. "
        "Add one, with the keys folder, training and test."
    )
