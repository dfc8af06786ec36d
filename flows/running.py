"""What `make up` has running here, found by the files it leaves; cheap to import."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import psutil

LOGS = Path("logs")


class Running(NamedTuple):
    """A server's process and the address it is reached at."""

    process: psutil.Process
    address: str


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
    return Running(process, known["address"]) if same else None
