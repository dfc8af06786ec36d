"""How a stage that keeps a table of runs is started: `python -m flows.<stage>`."""

import argparse
import sys
from importlib import import_module
from pathlib import Path
from typing import NoReturn

from flows.errors import guarded
from flows.locks import held
from flows.start import add_overrides, check_files, read_overrides


def main(stage: str, description: str | None) -> NoReturn:
    """Run the flow `flows.<stage>` with pipelines/<stage>/params.yaml, and end the process."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--workspace", type=Path, default=Path(), help="folder for the table of runs")
    add_overrides(parser)
    arguments = parser.parse_args()

    def work() -> None:
        file = Path("pipelines") / stage / "params.yaml"
        check_files(file, *arguments.overrides)
        from tasks import fingerprint

        flow = import_module(f"flows.{stage}")
        params = flow.load(file, *read_overrides(arguments))
        fingerprint.diagnosing_code(model_file=True)
        with held(arguments.workspace / "data" / f".{stage}.lock"):
            flow.run(params, arguments.workspace)

    guarded(work)
    sys.exit(0)
