"""Commands in a process of their own, which may be killed with SIGKILL at one of its writes."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

ROOT = Path(__file__).parents[1]
WORKER = """
import importlib, json, os, signal, sys
import flows
from flows import start
from flows.sealed import start as sealed

def work(folder, commands, writes):
    os.chdir(folder)
    replace, left = os.replace, writes
    for i, (name, *arguments) in enumerate(commands):
        def replaced(*paths, last=i == len(commands) - 1):
            nonlocal left
            left -= last
            if last and left == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            replace(*paths)
        os.replace = replaced
        sys.argv = [name, *arguments]
        try:
            (sealed if name.startswith("sealed.") else start).main(f"flows.{name}", None)
        except SystemExit as end:
            if end.code:
                raise

for name in sys.argv[1:]:
    importlib.import_module(f"flows.{name}")
for line in sys.stdin:
    child = os.fork()  # nothing has run here yet, so that a fork is safe, and spares the seconds of imports
    if not child:
        os.dup2(2, 1)
        try:
            work(*json.loads(line))
        except SystemExit as end:
            os._exit(end.code)
        os._exit(0)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""

Work = Callable[..., int]


@contextmanager
def worker(environment: Mapping[str, str], stages: Sequence[str], printed: TextIO | None = None) -> Iterator[Work]:
    """Yields `work(folder, *commands, writes=0)`, which runs commands of these stages there, such as `train virtual`,
    is killed at that write of the last one, and gives the exit status. printed: a file for what they print."""
    process = subprocess.Popen([sys.executable, "-c", WORKER, *stages], env={**environment, "PYTHONPATH": str(ROOT)},
                               stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=printed, text=True)  # fmt: skip
    assert process.stdin is not None
    assert process.stdout is not None
    stdin, stdout = process.stdin, process.stdout

    def work(folder: Path, *commands: str, writes: int = 0) -> int:
        print(json.dumps([str(folder), [command.split() for command in commands], writes]), file=stdin, flush=True)
        return int(stdout.readline())

    yield work
    stdin.close()
    assert process.wait(60) == 0
