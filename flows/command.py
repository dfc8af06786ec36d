"""The command `simgap`."""

import argparse
import sys
from pathlib import Path
from typing import Any

from flows.errors import guarded
from flows.start import PARAMS, check_files, prepared
from tasks import sessions
from tasks.simulators import trial


def main() -> None:
    """A subcommand: status 0 whatever it finds, 1 with an explained error, 2 for wrong arguments."""
    given = parser().parse_args()
    # A simulator of one's own lies where the command is started; behind the libraries, whose names may be the same.
    sys.path.append(str(Path.cwd()))
    guarded(lambda: given.work(given))


def parser() -> argparse.ArgumentParser:
    """Of the command's arguments; what it gives has the subcommand's `work`."""
    parser = argparse.ArgumentParser("simgap", description="Find out what a simulator leaves out of its machine.")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for add in (_add_diagnose, _add_sweep, _add_import, _add_check):
        add(commands)
    return parser


# Each looks at what it is given, then imports what it runs: Prefect, MLflow and JAX take ten seconds, and no command
# needs all of them.


def _add_diagnose(commands: Any) -> None:
    diagnose = commands.add_parser("diagnose", help="say what a simulator leaves out of recordings")
    diagnose.add_argument("recordings", type=Path, metavar="RECORDINGS", help="folder of sessions, CSV or Parquet")
    _add_simulator(diagnose)
    diagnose.add_argument(
        "--heldout", type=Path, metavar="RECORDINGS", help="folder of sessions to judge by; else some are held out"
    )
    diagnose.add_argument(
        "--baseline", type=Path, metavar="RECORDINGS", help="folder of sessions from before the machine changed"
    )
    diagnose.add_argument(
        "--out", type=Path, default=Path("diagnosis"), metavar="DIR", help="folder for the results (default: diagnosis)"
    )
    diagnose.set_defaults(work=_diagnose)


def _diagnose(given: argparse.Namespace) -> None:
    for folder in (given.recordings, given.heldout, given.baseline):
        if folder is not None:
            sessions.session_files(folder)
    trial.check(given.simulator)
    flow = prepared("flows.diagnose")
    flow.diagnose_folder(given.recordings, given.simulator, given.baseline, given.heldout, given.out)


def _add_sweep(commands: Any) -> None:
    """What Prefect's form takes, as options; what is not given is as in params.yaml."""
    sweep = commands.add_parser("sweep", help="train and score models over N, seeds and hyperparameters")
    sweep.add_argument("source", nargs="?", default="virtual", help="a block of params.yaml's recordings")
    sweep.add_argument("--name", default="", help="of the sweep and its folder; one that is there is gone on with")
    sweep.add_argument("--recordings", default="", metavar="FOLDER", help="folder in the project, for the source's")
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
    check_files(PARAMS)
    if given.recordings:
        sessions.session_files(Path(given.recordings))
    from tasks import forms
    from tasks.params import load_params

    asked = forms.defaults(load_params(PARAMS), given.source)
    asked["recordings"] |= {"folder": given.recordings} if given.recordings else {}
    for name in ("models", "noises", "sample_sizes", "seeds"):
        asked[name] = getattr(given, name) or asked[name]
    asked["hyperparameters"] = forms.read_values(given.values)
    prepared("flows.sweep").start(given.name, asked)


def _add_import(commands: Any) -> None:
    bring = commands.add_parser("import", help="turn bags and tables of one's own robot into recordings")
    bring.add_argument("source", type=Path, metavar="SOURCE", help="MCAP file, ROS 2 bag, CSV or Parquet, or a folder")
    bring.add_argument("--mapping", type=Path, required=True, metavar="FILE", help="where every column comes from")
    bring.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the recordings")
    _add_simulator(bring)
    bring.set_defaults(work=_import)


def _import(given: argparse.Namespace) -> None:
    sessions.sources(given.source)
    check_files(given.mapping)
    trial.check(given.simulator)
    from flows.importing import import_recordings

    import_recordings(given.source, given.mapping, given.out, given.simulator)


def _add_check(commands: Any) -> None:
    look = commands.add_parser("check", help="say what recordings hold, and what looks wrong in them")
    look.add_argument("recordings", type=Path, metavar="RECORDINGS", help="folder of sessions, CSV or Parquet")
    look.add_argument("--out", type=Path, default=Path("diagnosis"), metavar="DIR", help="folder for the page")
    _add_simulator(look)
    look.set_defaults(work=_check)


def _check(given: argparse.Namespace) -> None:
    sessions.session_files(given.recordings)
    trial.check(given.simulator)
    from flows.check import check_folder

    check_folder(given.recordings, given.simulator, given.out)


def _add_simulator(command: argparse.ArgumentParser) -> None:
    command.add_argument("--simulator", default="spot", help="spot, or one's own as package.module:name")


if __name__ == "__main__":
    main()
