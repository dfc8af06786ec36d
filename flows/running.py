"""What `make up` has running here, found by the files it leaves, and what killed commands left; cheap to import."""

import json
import os
import secrets
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import psutil

LOGS = Path("logs")
DATABASE = "prefect.db"
"""Prefect's, in its home."""
OWNER = "SIMGAP_PID"
"""Environment variable, for what a process starts: its number."""
_TEMPORARY = "prefect.server.api.server:create_app"


class Running(NamedTuple):
    """A server's process, the address it is reached at, and the login it asks for, if it does."""

    process: psutil.Process
    address: str
    login: str | None


def pid_file(name: str) -> Path:
    """Where a server's process is written down."""
    return LOGS / f"{name}.pid"


def find(name: str) -> Running | None:
    """The server of this name, if its process is still there; another's that came to have its number is not."""
    try:
        known: dict[str, Any] = json.loads(pid_file(name).read_text())
        process = psutil.Process(known["pid"])
        same = abs(process.create_time() - known["created"]) < 1 and process.status() != psutil.STATUS_ZOMBIE
    except (OSError, ValueError, KeyError, TypeError, psutil.NoSuchProcess):
        return None
    return Running(process, known["address"], known.get("login")) if same else None


def new_login() -> str:
    """A user and a password that nobody guesses, as `user:password`."""
    return f"simgap:{secrets.token_urlsafe(24)}"


def client(address: str, login: str | None) -> dict[str, str]:
    """What Prefect's clients read from the environment to reach the server at this address."""
    return {"PREFECT_API_URL": f"{address}/api", **({"PREFECT_API_AUTH_STRING": login} if login else {})}


def end_left_over() -> None:
    """End the temporary Prefect servers of this folder whose commands are gone: killed with SIGKILL, one leaves its."""
    for process in psutil.process_iter():
        with suppress(psutil.Error):  # it has ended meanwhile, or is another user's
            if _TEMPORARY not in process.cmdline():
                continue
            known = process.environ()
            own = OWNER in known and known.get("PREFECT_HOME") == os.environ.get("PREFECT_HOME")
            if own and not _there(int(known[OWNER]), process.create_time()):
                process.terminate()


def _there(pid: int, since: float) -> bool:
    """Whether the process that had this number at that time [s] is still there."""
    try:
        process = psutil.Process(pid)
        return process.status() != psutil.STATUS_ZOMBIE and process.create_time() <= since
    except psutil.NoSuchProcess:
        return False
