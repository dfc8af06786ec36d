"""The command `simgap`."""

import argparse
import sys
from pathlib import Path
from typing import Any

import simgap
from simgap.cli import environment, progress
from simgap.cli.errors import guarded
from simgap.formats import sessions
from simgap.loading import trial
from simgap.loading.model_files import ModelFile, PerJoint, named
from simgap.loading.seeds import check_seed
from simgap.types import ConfigError


def main() -> None:
    """A subcommand: status 0 whatever it finds, 1 with an explained error, 2 for wrong arguments."""
    given = parser().parse_args()
    environment.collect_seldom()
    environment.settle({**environment.numerics(), "JAX_COMPILATION_CACHE_DIR": str(environment.cache())})
    progress.choose(quiet=given.quiet, verbose=given.verbose, json=getattr(given, "json", False))
    # A simulator of one's own lies where the command is started; behind the libraries, whose names may be the same.
    sys.path.append(str(Path.cwd()))
    guarded(lambda: given.work(given))


def parser() -> argparse.ArgumentParser:
    """Of the command's arguments; what it gives has the subcommand's `work`."""
    parser = argparse.ArgumentParser("simgap", description="Find out what a simulator leaves out of its machine.")
    parser.add_argument("--version", action=_Version, help="print the version and exit")
    parser.add_argument("--print-completion", action=_Completion, choices=("bash", "zsh", "tcsh"),
                        help="print a script that completes this command in a shell")  # fmt: skip
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for add in (_add_diagnose, _add_import, _add_check):
        add(commands)
    return parser


class _Version(argparse.Action):
    """Looks the version up when it is asked for."""

    def __init__(self, option_strings: Any, dest: str, **kwargs: Any) -> None:
        super().__init__(option_strings, dest, nargs=0, **kwargs)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        print(f"simgap {simgap.__version__}")
        parser.exit()


class _Completion(argparse.Action):
    """Prints the script of a shell."""

    def __call__(self, parser: argparse.ArgumentParser, _: Any, shell: Any, __: str | None = None) -> None:
        import shtab

        print(shtab.complete(parser, shell))
        parser.exit()


# Each looks at what it is given, then imports what it runs: JAX and matplotlib take seconds.


def _add_diagnose(commands: Any) -> None:
    diagnose = _added(commands, "diagnose", "say what a simulator leaves out of recordings", _diagnose)
    _path(
        diagnose,
        "recordings",
        "folder of sessions, CSV or Parquet; several, of experiments with one machine",
        nargs="+",
    )
    _add_simulator(diagnose)
    _path(diagnose, "--heldout", "folder of sessions to judge by; else some are held out")
    _path(diagnose, "--baseline", "folder of sessions from before the machine changed")
    _path(diagnose, "--out", "folder for the results (default: diagnosis)", default=Path("diagnosis"))
    diagnose.add_argument("--seed", type=int, default=0, metavar="N", help="of what is drawn (default: 0)")
    diagnose.add_argument("--json", action="store_true", help="print diagnosis.json, and all else on standard error")


def _diagnose(given: argparse.Namespace) -> None:
    check_seed(given.seed)
    first, *further = given.recordings
    folders = [*given.recordings, *filter(None, (given.heldout, given.baseline))]
    found = {folder: len(sessions.session_files(folder)) for folder in folders}
    simulator = _simulator(given)
    progress.say(f"{', '.join(f'{count} files in {folder}' for folder, count in found.items())}; trying the simulator "
                 f"{simulator}")  # fmt: skip
    trial.check(simulator)
    from simgap.cli.diagnose import diagnose_folder
    from simgap.formats.purposes import Folders

    folders = Folders(first, given.heldout, given.baseline, tuple(further))
    diagnose_folder(folders, simulator, given.out, given.seed, given.json)


def _add_import(commands: Any) -> None:
    bring = _added(commands, "import", "turn bags and tables of one's own robot into recordings", _import)
    _path(bring, "source", "MCAP file, ROS 2 bag, CSV or Parquet, or a folder of these")
    _path(bring, "--mapping", "YAML file that says where every column comes from")
    bring.add_argument("--units", type=_units, metavar="UNIT", help="in place of a mapping, of a LeRobot data set "
                       "whose columns are named like the model's joints: deg, rad, percent of their range, "
                       "signed_percent (-100 to 100), m or mm; also by joint, as deg,gripper=percent")  # fmt: skip
    _path(bring, "--out", "folder for the recordings", required=True)
    _add_simulator(bring)


def _import(given: argparse.Namespace) -> None:
    sessions.sources(given.source)
    simulator = _simulator(given)
    if given.mapping is None:
        _import_data_set(given, simulator)
        return
    if given.units:
        raise ConfigError("--units and --mapping exclude each other: a mapping has a unit for every column.")
    sessions.mapping_file(given.mapping)
    trial.check(simulator)
    from simgap.cli.importing import import_recordings

    import_recordings(given.source, given.mapping, given.out, simulator)


def _import_data_set(given: argparse.Namespace, simulator: str | ModelFile) -> None:
    """Without a mapping: a LeRobot data set by the names of a model's joints."""
    if not isinstance(simulator, ModelFile) or not sessions.is_lerobot(given.source):
        raise ConfigError(f"{given.source}: --mapping is missing. Only a LeRobot data set with a model file as the "
                          "simulator needs none.")  # fmt: skip
    simulator.check()
    from simgap.cli.importing import import_data_set

    import_data_set(given.source, given.units or {}, given.out, simulator)


def _units(text: str) -> dict[str, str]:
    """Units by joint; that of all others by an empty name."""
    return {joint: unit for joint, _, unit in (part.rpartition("=") for part in text.split(","))}


def _add_check(commands: Any) -> None:
    look = _added(commands, "check", "say what recordings hold, and what looks wrong in them", _check)
    _path(look, "recordings", "folder of sessions, CSV or Parquet")
    _add_simulator(look)
    _path(look, "--out", "folder for the page (default: diagnosis)", default=Path("diagnosis"))


def _check(given: argparse.Namespace) -> None:
    sessions.session_files(given.recordings)
    simulator = _simulator(given)
    trial.check(simulator)
    from simgap.cli.check import check_folder

    check_folder(given.recordings, simulator, given.out)


def _added(commands: Any, name: str, what: str, work: Any) -> argparse.ArgumentParser:
    command = commands.add_parser(name, help=what, description=f"{what[0].upper()}{what[1:]}.")
    command.set_defaults(work=work)
    how = command.add_mutually_exclusive_group()
    how.add_argument("-q", "--quiet", action="store_true", help="print errors alone, and what --json asks for")
    how.add_argument("-v", "--verbose", action="store_true", help="keep a line of everything that is tried")
    return command


def _path(command: argparse.ArgumentParser, name: str, what: str, **options: Any) -> None:
    """An argument that is a file or folder; shells complete it."""
    added = command.add_argument(name, type=Path, metavar=name.strip("-").upper(), help=what, **options)
    added.complete = {"bash": "_shtab_compgen_files", "zsh": "_files", "tcsh": "f"}  # type: ignore[attr-defined]


def _add_simulator(command: argparse.ArgumentParser) -> None:
    command.add_argument("--simulator", default="spot",
                         help="an MJCF or URDF (robot.xml), one's own as package.module:name, or spot")  # fmt: skip
    for option, what in _SERVOS.items():
        command.add_argument(f"--{option}", type=_per_joint, metavar="VALUE",
                             help=f"of joints that have no actuator in the model: {what}; a number, or "
                                  "joint=number,joint=number")  # fmt: skip


_SERVOS = {"kp": "stiffness of a position servo [N m/rad]", "kv": "its damping [N m s/rad]",
           "force-limit": "its largest torque [N m]"}  # fmt: skip


def _per_joint(text: str) -> PerJoint:
    """A number, or numbers by joint."""
    try:
        if "=" not in text:
            return float(text)
        pairs = [(joint, float(value)) for joint, _, value in (part.partition("=") for part in text.split(","))]
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number, or joint=number,joint=number; it is {text!r}") from None
    if len(dict(pairs)) < len(pairs):
        raise argparse.ArgumentTypeError(f"must have every joint once; it is {text!r}")
    return dict(pairs)


def _simulator(given: argparse.Namespace) -> str | ModelFile:
    """What --simulator names."""
    simulator, servos = named(given.simulator), (given.kp, given.kv, given.force_limit)
    if isinstance(simulator, ModelFile):
        return ModelFile(simulator.path, *servos)
    if any(value is not None for value in servos):
        raise ConfigError(f"--kp, --kv and --force-limit are for a model file (.xml, .mjcf, .urdf), which "
                          f"{given.simulator} is not. Leave them out.")  # fmt: skip
    return simulator


if __name__ == "__main__":
    main()
