"""How a stage is started from the command line: `python -m flows.<stage> SOURCE`."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from simgap.types import SimgapError
from tasks import progress
from tasks.params import load_params, read_yaml

PARAMS = Path("params.yaml")


def main(run: Callable[..., Any]) -> None:
    """Run a stage's flow in the project's folders, with params.yaml; explained errors end it without a traceback.

    With `--overrides` it is a part of the experiment, or another one, which DVC does not know of.
    """
    parser = argparse.ArgumentParser(description=run.__doc__)
    parser.add_argument("source", help="a block of params.yaml's recordings, such as virtual or spot")
    add_overrides(parser)
    arguments = parser.parse_args()
    guarded(lambda: run(arguments.source, load_params(PARAMS, *read_overrides(arguments)), Path()))


def add_overrides(parser: argparse.ArgumentParser) -> None:
    """The option `--overrides`, as often as one likes."""
    parser.add_argument("--overrides", type=Path, action="append", default=[], help="YAML file merged into params.yaml")


def read_overrides(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """What the files given as `--overrides` hold."""
    return [read_yaml(path) for path in arguments.overrides]


def guarded(work: Callable[[], Any]) -> None:
    """Call `work`; an error that explains itself is printed and ends the process with status 1."""
    progress.quiet_libraries()
    try:
        work()
    except SimgapError as error:
        progress.say(f"error: {error}")
        sys.exit(1)
