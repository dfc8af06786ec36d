"""How the stage `external` is started: `python -m flows.external`."""

import argparse
import sys
from pathlib import Path
from typing import NoReturn

from flows.errors import guarded
from flows.start import add_overrides, check_files, read_overrides

PARAMS = Path("pipelines/external/params.yaml")


def main() -> NoReturn:
    """Diagnose the machines of the file of parameters, and end the process."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workspace", type=Path, default=Path(), help="folder for the table of runs")
    add_overrides(parser)
    arguments = parser.parse_args()

    def work() -> None:
        check_files(PARAMS, *arguments.overrides)
        from flows import external
        from tasks import fingerprint
        from tasks.params import load_external

        params = load_external(PARAMS, *read_overrides(arguments))
        fingerprint.diagnosing_code(model_file=True)
        external.run(params, arguments.workspace)

    guarded(work)
    sys.exit(0)
