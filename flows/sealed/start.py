"""How a sealed stage is started from the command line: `python -m flows.sealed.<stage> SUITE`."""

import argparse
import sys
from importlib import import_module
from pathlib import Path
from typing import NoReturn

from flows.errors import guarded
from flows.locks import held
from flows.start import add_overrides, check_files, read_overrides
from tasks.sealed.workspace import SUITES, SealedWorkspace

PARAMS = Path("pipelines/sealed/params.yaml")
FOLDERS = ("data/sealed", "keys", "examinations", "reports/sealed")
"""What sealed stages write to."""


def main(stage: str, description: str | None) -> NoReturn:
    """Run the flow of the module `stage` in the project's folders, or in those of a workspace apart, and end."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("suite", choices=SUITES)
    parser.add_argument("--workspace", type=Path, default=Path(), help="folder for recordings, keys and report")
    add_overrides(parser)
    arguments = parser.parse_args()

    def work() -> None:
        check_files(PARAMS, *arguments.overrides)
        from simgap.formats.atomic import remove_unfinished
        from tasks import fingerprint
        from tasks.params_sealed import load_sealed

        params = load_sealed(PARAMS, *read_overrides(arguments))
        workspace = SealedWorkspace(arguments.workspace, arguments.suite)
        fingerprint.diagnosing_code(workspace.has_models)
        flow = import_module(stage)
        with held(workspace.lock):
            for folder in FOLDERS:
                remove_unfinished(arguments.workspace / folder)
            flow.run(arguments.suite, params, arguments.workspace)

    guarded(work)
    sys.exit(0)
