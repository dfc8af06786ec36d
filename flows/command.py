"""The command `simgap`."""

import argparse
import sys
from pathlib import Path
from typing import Any

from flows import sweep
from flows.diagnose import diagnose_folder
from flows.start import PARAMS, guarded
from tasks import forms
from tasks.params import load_params


def main() -> None:
    """A subcommand: status 0 whatever it finds, 1 with an explained error, 2 for wrong arguments."""
    parser = argparse.ArgumentParser("simgap", description="Find out what a simulator leaves out of its machine.")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    diagnose = commands.add_parser("diagnose", help="say what a simulator leaves out of recordings")
    diagnose.add_argument("recordings", type=Path, metavar="RECORDINGS", help="folder of sessions, CSV or Parquet")
    diagnose.add_argument("--simulator", default="spot", help="spot, or one's own as package.module:name")
    diagnose.add_argument(
        "--heldout", type=Path, metavar="RECORDINGS", help="folder of sessions to judge by; else some are held out"
    )
    diagnose.add_argument(
        "--baseline", type=Path, metavar="RECORDINGS", help="folder of sessions from before the machine changed"
    )
    diagnose.add_argument(
        "--out", type=Path, default=Path("diagnosis"), metavar="DIR", help="folder for the results (default: diagnosis)"
    )
    diagnose.set_defaults(
        work=lambda given: diagnose_folder(given.recordings, given.simulator, given.baseline, given.heldout, given.out)
    )
    _add_sweep(commands)
    given = parser.parse_args()
    # As `python -m` would: a simulator of one's own lies where the command is started.
    sys.path.insert(0, str(Path.cwd()))
    guarded(lambda: given.work(given))


def _add_sweep(commands: Any) -> None:
    """`simgap sweep`: what Prefect's form takes, as options; what is not given is as in params.yaml."""
    sweep = commands.add_parser("sweep", help="train and score models over N, seeds and hyperparameters")
    sweep.add_argument("source", nargs="?", default="virtual", help="a block of params.yaml's recordings")
    sweep.add_argument("--name", default="", help="of the sweep and its folder; one that is there is gone on with")
    sweep.add_argument(
        "--recordings", default="", metavar="FOLDER", help="in the project, in place of the source's own"
    )
    sweep.add_argument("--models", nargs="+")
    sweep.add_argument("--noises", nargs="+")
    sweep.add_argument("--sample-sizes", nargs="+", type=int, metavar="N")
    sweep.add_argument("--seeds", nargs="+", type=int)
    sweep.add_argument(
        "--try", nargs="+", default=[], dest="values", metavar="BLOCK.NAME=VALUE,VALUE",
        help="hyperparameters, such as bnn.learning_rate=0.001,0.01; every combination is trained",
    )  # fmt: skip
    sweep.set_defaults(work=_sweep)


def _sweep(given: argparse.Namespace) -> None:
    asked = forms.defaults(load_params(PARAMS), given.source)
    asked["recordings"] |= {"folder": given.recordings} if given.recordings else {}
    for name in ("models", "noises", "sample_sizes", "seeds"):
        asked[name] = getattr(given, name) or asked[name]
    sweep.start(given.name, {**asked, "hyperparameters": forms.read_values(given.values)})


if __name__ == "__main__":
    main()
