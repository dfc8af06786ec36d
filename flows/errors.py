"""How a command of the pipeline ends: as every command does; it also knows of servers that are gone."""

import logging
from collections.abc import Callable
from typing import Any

from flows import running
from simgap.cli import errors


def guarded(work: Callable[[], Any]) -> None:
    """Call `work` as `simgap.cli.errors.guarded` does; before it, end what killed commands left."""
    _quiet_libraries()
    running.end_left_over()
    errors.guarded(work, _server_is_gone, [running.LOGS])


def _server_is_gone(error: BaseException) -> str | None:
    import httpx

    # The second is Prefect's own.
    if not (isinstance(error, httpx.HTTPError) or str(error).startswith("Failed to reach API")):
        return None
    return (
        f"Prefect's server does not answer ({error or type(error).__name__}). What is finished is kept. Start the "
        "server (`make up`), or unset PREFECT_API_URL, and give the same command again."
    )


def _quiet_libraries() -> None:
    """Leave warnings and errors of the libraries' logs; drop their chatter, and tracebacks."""
    for name in ("httpx", "alembic", "distributed", "prefect"):
        logging.getLogger(name).setLevel(logging.WARNING)
    # A lost server is reported once, not for every retry.
    logging.getLogger("urllib3").setLevel(logging.ERROR)
    for name in ("prefect.flow_runs", "prefect.task_runs"):
        logging.getLogger(name).addFilter(_has_no_traceback)


def _has_no_traceback(record: logging.LogRecord) -> bool:
    # An error is reported once, where the process ends.
    return not record.exc_info
