"""How a sweep is started from the command line: `python -m flows.sweep SOURCE`."""

import argparse
import sys
from importlib import import_module
from pathlib import Path
from typing import NoReturn

from flows.errors import guarded
from flows.start import PARAMS, check_files, check_source
from simgap.formats.sessions import session_files
from tasks import names


def main() -> NoReturn:
    """Run the sweep that the arguments ask for, and end the process."""
    given = parser().parse_args()
    guarded(lambda: _sweep(given))
    sys.exit(0)


def parser() -> argparse.ArgumentParser:
    """What Prefect's form takes, as options; what is not given is as in params.yaml."""
    parser = argparse.ArgumentParser(
        "flows.sweep", description="Train and score models over N, seeds and hyperparameters."
    )
    parser.add_argument("source", nargs="?", default="virtual", help="a block of params.yaml's recordings")
    parser.add_argument("--name", default="", help="of the sweep and its folder; one that is there is gone on with")
    parser.add_argument("--recordings", default="", metavar="FOLDER", help="folder in the project, for the source's")
    parser.add_argument("--models", nargs="+")
    parser.add_argument("--noises", nargs="+")
    parser.add_argument("--sample-sizes", nargs="+", type=int, metavar="N")
    parser.add_argument("--seeds", nargs="+", type=int)
    parser.add_argument(
        "--try", nargs="+", default=[], dest="values", metavar="BLOCK.NAME=VALUE,VALUE",
        help="hyperparameters, such as bnn.learning_rate=0.001,0.01; every combination is trained",
    )  # fmt: skip
    return parser


def _sweep(given: argparse.Namespace) -> None:
    if given.name:
        names.check_run(given.name)
    check_files(PARAMS)
    check_source(given.source, PARAMS)
    if given.recordings:
        session_files(Path(given.recordings))
    from simgap.formats.validation import check
    from tasks import forms
    from tasks.params import load_params

    asked = forms.defaults(load_params(PARAMS), given.source)
    asked["recordings"] |= {"folder": given.recordings} if given.recordings else {}
    asked |= check(
        forms.Grid, {name: getattr(given, name) or asked[name] for name in forms.Grid.model_fields}
    ).model_dump()
    asked["hyperparameters"] = forms.read_values(given.values)
    import_module("flows.sweep").start(given.name, asked)
