"""How a stage is started from the command line: `python -m flows.<stage> SOURCE`.

Nothing heavy is imported here: what is wrong with a command is said before Prefect, MLflow and JAX are loaded.
"""

import argparse
import fcntl
import os
import shlex
import signal
import socket
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from datetime import datetime
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from flows import running
from simgap.types import ConfigError, SimgapError
from tasks import progress
from tasks.sessions import session_files
from tasks.workspace import Workspace

PARAMS = Path("params.yaml")
FOLDERS = [Path(name) for name in ("data", "models", "scores", "policies", "tracks", "reports")]
"""What stages write to in the project."""
_HEARD_S = 3.0
"""Time for work to end on Ctrl-C before it is said that it does not [s]."""
_HOLDER_BYTES = 4096


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
        from tasks.params import load_params

        params = load_params(PARAMS, *read_overrides(arguments))
        params.source(arguments.source)
        flow = prepared(stage)
        from tasks.files.atomic import remove_unfinished

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
        own = {"recordings": {arguments.source: {"folder": str(arguments.recordings)}}}
        if arguments.recordings:
            session_files(arguments.recordings)
        from tasks.params import load_params

        params = load_params(PARAMS, *read_overrides(arguments), *([own] if arguments.recordings else []))
        params.source(arguments.source)
        flow = prepared(stage)
        with alone(arguments.workspace, arguments.source):
            flow.run(arguments.source, params, arguments.workspace)

    guarded(work)
    sys.exit(0)


def prepared(stage: str) -> Any:
    """The module of a flow, imported; a flow without a server starts one, whose database is for its owner alone."""
    from tasks.files.folders import keep_private

    if "PREFECT_API_URL" not in os.environ:
        keep_private(Path(os.environ["PREFECT_HOME"]) / running.DATABASE)
    return import_module(stage)


def check_files(*paths: Path) -> None:
    """ConfigError that names the first that is not there."""
    for path in paths:
        if not path.is_file():
            raise ConfigError(f"{path}: there is no such file here. Start the command in the folder that holds it.")


@contextmanager
def alone(root: Path, source: str = "") -> Iterator[None]:
    """Hold a run's folder, and in it what belongs to a source, and clear it of what a killed run was writing.

    Raises SimgapError where another process works there.
    """
    from tasks.files.atomic import remove_unfinished

    with held(root / ".lock"), held(Workspace(root, source).lock) if source else nullcontext():
        remove_unfinished(root)
        yield


@contextmanager
def held(lock: Path) -> Iterator[None]:
    """Hold a lock file, which says by whom, as long as the block runs and the process lives.

    Raises SimgapError that names the holder where there is one: it would lose what it is writing.
    """
    from tasks.files.folders import make_folder

    make_folder(lock.parent)
    try:
        file = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise SimgapError(f"{lock}: cannot be opened ({error.strerror}). Fix its permissions, or delete it.") from None
    try:
        _take(file, lock)
        yield
        _write(file, "")
    finally:
        os.close(file)


def _take(file: int, lock: Path) -> None:
    """Lock the open file, and say in it who did."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = os.pread(file, _HOLDER_BYTES, 0).decode(errors="replace") or "another process"
        raise SimgapError(
            f"{lock}: held by {holder}. Two commands at work in one folder would delete each other's results. Wait "
            "until that one has ended, end it, or use another workspace or name."
        ) from None
    since = f"{datetime.now():%Y-%m-%d %H:%M:%S}"
    _write(file, f"process {os.getpid()} on {socket.gethostname()} since {since}: {shlex.join(sys.orig_argv)}")


def _write(file: int, holder: str) -> None:
    """What the lock file says; on a full disk nothing, and the lock holds all the same."""
    with suppress(OSError):
        os.ftruncate(file, 0)
        os.pwrite(file, holder.encode()[:_HOLDER_BYTES], 0)


def add_overrides(parser: argparse.ArgumentParser) -> None:
    """The option `--overrides`, as often as one likes."""
    parser.add_argument("--overrides", type=Path, action="append", default=[], help="YAML file merged into params.yaml")


def read_overrides(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """What the files given as `--overrides` hold."""
    from tasks.yaml_files import read_yaml

    found = {path: read_yaml(path) for path in arguments.overrides}
    for path, values in found.items():
        if not isinstance(values, dict):
            raise ConfigError(f"{path}: must hold blocks as params.yaml does, such as `train:`; it holds "
                              f"{'nothing' if values is None else 'none'}.")  # fmt: skip
    return list(found.values())


def guarded(work: Callable[[], Any]) -> None:
    """Call `work`. What it raises ends the process with a message, not a traceback, and status 1, or 130 for Ctrl-C.

    The traceback of an error that nobody expected is kept in a file that the message names.
    """
    progress.quiet_libraries()
    running.end_left_over()
    try:
        with _interruptible():
            work()
    except SimgapError as error:
        progress.say(f"error: {error}")
        sys.exit(1)
    except KeyboardInterrupt:
        progress.say("stopped")
        sys.exit(130)
    except (Exception, SystemExit) as error:  # code of the user's may even exit, with status 0
        if _is_server_gone(error):
            progress.say(
                f"error: Prefect's server does not answer ({error or type(error).__name__}). What is finished is kept. "
                "Start the server (`make up`), or unset PREFECT_API_URL, and give the same command again."
            )
        else:
            progress.say(_unexpected(error))
        sys.exit(1)


def _is_server_gone(error: BaseException) -> bool:
    import httpx

    # The second is Prefect's own.
    return isinstance(error, httpx.HTTPError) or str(error).startswith("Failed to reach API")


def _unexpected(error: BaseException) -> str:
    """What to say of an error that no one foresaw; its traceback goes to a file."""
    command = " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])
    text = f"{command}\n\n{''.join(traceback.format_exception(error))}"
    name = f"error-{time.strftime('%Y%m%d-%H%M%S')}-{os.getpid()}.txt"
    for folder in (running.LOGS, Path(tempfile.gettempdir())):
        try:
            folder.mkdir(exist_ok=True)
            (folder / name).write_text(text)
        except OSError:
            continue
        kept = f"The whole traceback is in {folder / name}: please report this error together with that file."
        break
    else:
        kept = f"It could not be written to a file:\n{text}"
    (first, *_) = str(error).strip().splitlines() or ["no message"]
    return f"error: `{command}` ended with an unexpected error, {type(error).__name__}: {first}\n{kept}"


@contextmanager
def _interruptible() -> Iterator[None]:
    """A second Ctrl-C ends the process at once: Python does not hear of the first before compiled code returns."""
    receiver, sender = socket.socketpair()
    sender.setblocking(False)
    before = signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)
    threading.Thread(target=_count, args=(receiver,), daemon=True).start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        sender.close()


def _count(receiver: socket.socket) -> None:
    """End the process on the second Ctrl-C; until the other end is closed."""
    asked = 0
    with receiver:
        while number := _next(receiver):
            asked += number[0] == signal.SIGINT
            if asked == 1:
                receiver.settimeout(_HEARD_S)
            if asked == 2:
                os.write(1, b"stopped\n")
                os._exit(130)


def _next(receiver: socket.socket) -> bytes:
    """The number of the next signal; it is said once if that takes long after a Ctrl-C."""
    try:
        return receiver.recv(1)
    except TimeoutError:
        os.write(1, b"Still stopping. Ctrl-C again ends it at once.\n")
        receiver.settimeout(None)
        return receiver.recv(1)
