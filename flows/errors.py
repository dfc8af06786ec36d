"""How a command ends: with a message and an exit status, not with a traceback."""

import os
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from flows import running
from flows.signals import interruptible
from simgap.types import SimgapError
from tasks import progress


def guarded(work: Callable[[], Any]) -> None:
    """Call `work`. What it raises ends the process with a message, not a traceback, and status 1, or 130 for Ctrl-C.

    The traceback of an error that nobody expected is kept in a file that the message names.
    """
    progress.quiet_libraries()
    running.end_left_over()
    try:
        with interruptible():
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
