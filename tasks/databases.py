"""SQLite files: readable by their owner alone, and waited for while another process holds them."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from sqlalchemy import Engine, event

from tasks import files

PATIENCE_S = 60.0
"""How long a process waits for a database that another one has locked [s]."""


def private(path: Path) -> None:
    """Create an empty database if there is none, and take from others the right to read it and what SQLite keeps with
    it; SimgapError where its folder cannot be written to.

    SQLite gives the files that it adds later the rights of the database. One that is there is not opened: closing it
    would end the locks that this process holds on it.
    """
    files.make_folder(path.parent)
    with suppress(OSError):  # another user's database, or a read-only disk: who opens it next says so
        if not path.exists():
            os.close(os.open(path, os.O_CREAT | os.O_EXCL, 0o600))
        for each in (path, *path.parent.glob(f"{path.name}-*")):
            each.chmod(0o600)


@event.listens_for(Engine, "before_cursor_execute", retval=True)
def _wait(
    _connection: Any, _cursor: Any, statement: str, parameters: Any, _context: Any, _many: bool
) -> tuple[str, Any]:
    """Every session of MLflow sets 20 s, whatever its address asks for."""
    if statement.startswith("PRAGMA busy_timeout ="):
        statement = f"PRAGMA busy_timeout = {PATIENCE_S * 1000:.0f}"
    return statement, parameters
