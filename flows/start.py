"""How a stage is started from the command line: `python -m flows.<stage> SOURCE`."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from simgap.types import SimgapError
from tasks import progress
from tasks.params import load_params

PARAMS = Path("params.yaml")


def main(run: Callable[..., Any]) -> None:
    """Run a stage's flow in the project's folders, with params.yaml; explained errors end it without a traceback."""
    parser = argparse.ArgumentParser(description=run.__doc__)
    parser.add_argument("source", help="a block of params.yaml's recordings, such as virtual or spot")
    arguments = parser.parse_args()
    guarded(lambda: run(arguments.source, load_params(PARAMS), Path()))


def guarded(work: Callable[[], Any]) -> None:
    """Call `work`; an error that explains itself is printed and ends the process with status 1."""
    progress.quiet_libraries()
    try:
        work()
    except SimgapError as error:
        progress.say(f"error: {error}")
        sys.exit(1)
