"""How a stage is started from the command line: `python -m flows.<stage> SOURCE`.

Nothing heavy is imported here: what is wrong with a command is said before Prefect, MLflow and JAX are loaded.
"""

import argparse
import sys
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from flows.errors import guarded
from flows.locks import alone, held
from simgap.formats.atomic import remove_unfinished
from simgap.formats.sessions import session_files
from simgap.types import ConfigError
from tasks import names
from tasks.workspace import Workspace

PARAMS = Path("params.yaml")
FOLDERS = [Path(name) for name in ("data", "models", "scores", "policies", "twins", "tracks", "reports")]
"""What stages write to in the project."""


def main(stage: str, description: str | None) -> NoReturn:
    """Run the flow of the module `stage` in the project's folders, with params.yaml, and end the process.

    The module's own first lines call it: what is wrong with the arguments is said before the rest is imported. With
    `--overrides` it is a part of the experiment, or another one, which DVC does not know of.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("source", help="a block of params.yaml's recordings, such as virtual or spot")
    add_overrides(parser)
    arguments = parser.parse_args()

    def work() -> None:
        check_files(PARAMS, *arguments.overrides)
        check_source(arguments.source, PARAMS, *arguments.overrides)
        from tasks.params import load_params

        params = load_params(PARAMS, *read_overrides(arguments))
        flow = import_module(stage)
        with held(Workspace(Path(), arguments.source).lock):
            for folder in FOLDERS:
                remove_unfinished(folder)
            flow.run(arguments.source, params, Path())

    guarded(work)
    sys.exit(0)


def main_apart(stage: str, description: str | None) -> NoReturn:
    """The same in a workspace of its own, with recordings of one's own if there are any."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("source", nargs="?", default="virtual", help="a block of params.yaml's recordings")
    parser.add_argument("--workspace", type=Path, required=True, help="folder for data, models and report")
    add_overrides(parser)
    parser.add_argument("--recordings", type=Path, help="folder that takes the place of the source's own")
    arguments = parser.parse_args()

    def work() -> None:
        check_files(PARAMS, *arguments.overrides)
        check_source(arguments.source, PARAMS, *arguments.overrides)
        own = {"recordings": {arguments.source: {"folder": str(arguments.recordings)}}}
        if arguments.recordings:
            session_files(arguments.recordings)
        from tasks.params import load_params

        params = load_params(PARAMS, *read_overrides(arguments), *([own] if arguments.recordings else []))
        flow = import_module(stage)
        with alone(arguments.workspace, arguments.source):
            flow.run(arguments.source, params, arguments.workspace)

    guarded(work)
    sys.exit(0)


def check_files(*paths: Path) -> None:
    """ConfigError that names the first that is not there."""
    for path in paths:
        if not path.is_file():
            raise ConfigError(f"{path}: there is no such file here. Start the command in the folder that holds it.")


def check_source(source: str, *files: Path) -> None:
    """ConfigError where no file has a block of that name in `recordings`. `load_params` reports all other mistakes."""
    from simgap.formats.yaml_files import read_yaml

    blocks = [values.get("recordings") for values in map(read_yaml, files) if isinstance(values, dict)]
    known = [str(name) for block in blocks if isinstance(block, dict) for name in block]
    if known and source not in known:
        raise names.no_source(source, list(dict.fromkeys(known)))


def add_overrides(parser: argparse.ArgumentParser) -> None:
    """The option `--overrides`, as often as one likes."""
    parser.add_argument("--overrides", type=Path, action="append", default=[], help="YAML file merged into params.yaml")


def read_overrides(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """What the files given as `--overrides` hold."""
    from simgap.formats.yaml_files import read_yaml

    found = {path: read_yaml(path) for path in arguments.overrides}
    for path, values in found.items():
        if not isinstance(values, dict):
            raise ConfigError(f"{path}: must hold blocks as params.yaml does, such as `train:`; it holds "
                              f"{'nothing' if values is None else 'none'}.")  # fmt: skip
    return list(found.values())
