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


def main() -> None:
    """A subcommand: status 0 whatever it finds, 1 with an explained error, 2 for wrong arguments."""
    given = parser().parse_args()
    environment.settle({**environment.NUMERICS, "JAX_COMPILATION_CACHE_DIR": str(environment.cache())})
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
    _path(diagnose, "recordings", "folder of sessions, CSV or Parquet")
    _add_simulator(diagnose)
    _path(diagnose, "--heldout", "folder of sessions to judge by; else some are held out")
    _path(diagnose, "--baseline", "folder of sessions from before the machine changed")
    _path(diagnose, "--out", "folder for the results (default: diagnosis)", default=Path("diagnosis"))
    diagnose.add_argument("--seed", type=int, default=0, metavar="N", help="of what is drawn (default: 0)")
    diagnose.add_argument("--json", action="store_true", help="print diagnosis.json, and all else on standard error")


def _diagnose(given: argparse.Namespace) -> None:
    found = {f: len(sessions.session_files(f)) for f in (given.recordings, given.heldout, given.baseline) if f}
    progress.say(f"{', '.join(f'{count} files in {folder}' for folder, count in found.items())}; trying the simulator "
                 f"{given.simulator}")  # fmt: skip
    trial.check(given.simulator)
    from simgap.cli.diagnose import diagnose_folder
    from simgap.formats.purposes import Folders

    folders = Folders(given.recordings, given.heldout, given.baseline)
    diagnose_folder(folders, given.simulator, given.out, given.seed, given.json)


def _add_import(commands: Any) -> None:
    bring = _added(commands, "import", "turn bags and tables of one's own robot into recordings", _import)
    _path(bring, "source", "MCAP file, ROS 2 bag, CSV or Parquet, or a folder of these")
    _path(bring, "--mapping", "YAML file that says where every column comes from", required=True)
    _path(bring, "--out", "folder for the recordings", required=True)
    _add_simulator(bring)


def _import(given: argparse.Namespace) -> None:
    sessions.sources(given.source)
    sessions.mapping_file(given.mapping)
    trial.check(given.simulator)
    from simgap.cli.importing import import_recordings

    import_recordings(given.source, given.mapping, given.out, given.simulator)


def _add_check(commands: Any) -> None:
    look = _added(commands, "check", "say what recordings hold, and what looks wrong in them", _check)
    _path(look, "recordings", "folder of sessions, CSV or Parquet")
    _add_simulator(look)
    _path(look, "--out", "folder for the page (default: diagnosis)", default=Path("diagnosis"))


def _check(given: argparse.Namespace) -> None:
    sessions.session_files(given.recordings)
    trial.check(given.simulator)
    from simgap.cli.check import check_folder

    check_folder(given.recordings, given.simulator, given.out)


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
    command.add_argument("--simulator", default="spot", help="spot, or one's own as package.module:name")


if __name__ == "__main__":
    main()
