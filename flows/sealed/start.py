"""How a sealed stage is started from the command line: `python -m flows.sealed.<stage> SUITE`."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from flows.start import add_overrides, guarded, held, read_overrides
from tasks import files, fingerprint
from tasks.params import load_sealed
from tasks.sealed.conceal import SUITES
from tasks.sealed.workspace import SealedWorkspace

PARAMS = Path("sealed/params.yaml")
FOLDERS = ("data/sealed", "keys", "examinations", "reports/sealed")
"""What sealed stages write to."""


def main(run: Callable[..., Any]) -> None:
    """Run a stage's flow in the project's folders, or in those of a workspace apart."""
    parser = argparse.ArgumentParser(description=run.__doc__)
    parser.add_argument("suite", choices=SUITES)
    parser.add_argument("--workspace", type=Path, default=Path(), help="folder for recordings, keys and report")
    add_overrides(parser)
    arguments = parser.parse_args()
    fingerprint.diagnosing_code()

    def work() -> None:
        params = load_sealed(PARAMS, *read_overrides(arguments))
        with held(SealedWorkspace(arguments.workspace, arguments.suite).lock):
            for folder in FOLDERS:
                files.remove_unfinished(arguments.workspace / folder)
            run(arguments.suite, params, arguments.workspace)

    guarded(work)
