"""The form of every name that becomes a file or a folder: a source, a run, a sealed suite, a case."""

import re

from simgap.types import ConfigError

PATTERN = "[A-Za-z0-9][A-Za-z0-9_-]*"
LONGEST = 100
"""Characters of a name at most; file systems admit 255, and files' names end in more than the name."""


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
