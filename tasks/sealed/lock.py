"""What keeps a diagnosing process from the keys: a hook of the interpreter that no later code can take away."""

import os
import sys
from pathlib import Path
from typing import Any

from simgap.types import SimgapError

_FILES = {"open", "os.listdir", "os.scandir", "os.rename", "os.link", "os.symlink", "os.chmod", "os.remove",
          "os.utime", "os.truncate", "os.chdir", "os.mkdir", "shutil.copyfile", "shutil.move", "glob.glob"}  # fmt: skip
_PROCESSES = {"subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork", "os.forkpty"}


def lock(forbidden: Path) -> None:
    """From now on, for good, this process opens and lists nothing under `forbidden`, and starts no other process.

    An audit hook sees what Python code opens, whoever runs it, root included; native code it does not see. What is
    there to be read is encrypted besides. SimgapError if the lock does not hold.
    """
    away = os.path.realpath(forbidden)

    def refuse(event: str, arguments: tuple[Any, ...]) -> None:
        if event in _PROCESSES:
            raise PermissionError(f"{event}: a process that diagnoses sealed recordings starts no other")
        if event in _FILES:
            for path in arguments[:2]:
                if isinstance(path, bytes):
                    path = os.fsdecode(path)
                if isinstance(path, str | os.PathLike) and _under(os.path.realpath(path), away):
                    raise PermissionError(f"{path}: lies with the keys of sealed recordings")

    sys.addaudithook(refuse)
    for path in (away, *(os.path.join(away, name) for name in ("secret", "keys.sealed"))):
        try:
            with open(path, "rb"):
                pass
        except PermissionError:
            continue
        except OSError:
            pass
        raise SimgapError(f"{path}: must be closed to a process that diagnoses, and is not. It does not run.")


def _under(path: str, folder: str) -> bool:
    return path == folder or path.startswith(folder + os.sep)
