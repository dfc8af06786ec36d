"""How a command ends: with a message and an exit status, not with a traceback."""

import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from os import getpid
from pathlib import Path
from typing import Any

from simgap.cli import progress
from simgap.cli.signals import interruptible
from simgap.types import SimgapError

Explain = Callable[[BaseException], str | None]
"""What to say of an error that is no SimgapError; None where it is not known."""


def guarded(work: Callable[[], Any], explain: Explain = lambda _: None, logs: Sequence[Path] = ()) -> None:
    """Call `work`. What it raises ends the process with a message, not a traceback, and status 1, or 130 for Ctrl-C.

    The traceback of an error that nobody expected is kept in a file that the message names, in the first of `logs` that
    can be written to, or in the folder for temporary files.
    """
    try:
        with interruptible():
            work()
    except KeyboardInterrupt:
        progress.say("stopped", always=True)
        sys.exit(130)
    except SimgapError as error:
        progress.say(f"error: {error}", always=True)
        sys.exit(1)
    except (Exception, SystemExit) as error:  # code of the user's may even exit, with status 0
        said = explain(error)
        progress.say(f"error: {said}" if said else _unexpected(error, logs), always=True)
        sys.exit(1)


def _unexpected(error: BaseException, logs: Sequence[Path]) -> str:
    """What to say of an error that no one foresaw; its traceback goes to a file."""
    command = " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])
    text = f"{command}\n\n{''.join(traceback.format_exception(error))}"
    name = f"error-{time.strftime('%Y%m%d-%H%M%S')}-{getpid()}.txt"
    for folder in (*logs, Path(tempfile.gettempdir())):
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
