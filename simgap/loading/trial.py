"""Tries a user's simulator in a separate process, so that its code can only harm that process.

Cheap to import, as `names` is.
"""

import json
import os
import signal
import subprocess
import sys
from functools import cache

from simgap.loading.model_files import ModelFile
from simgap.loading.names import BUILT_IN, place
from simgap.types import ConfigError

PATIENCE_S = 300
"""Time limit for importing, making and trying a simulator [s]; a diagnosis compiles its step dozens of times."""


def check(simulator: str | ModelFile) -> None:
    """Check that the simulator exists, and try it if it is a user's own; ConfigError says what is wrong.

    For a model file, only its existence is checked: it needs recordings, and runs no user code.
    """
    if isinstance(simulator, ModelFile):
        simulator.check()
    elif simulator not in BUILT_IN:
        place(simulator)
        _try(simulator)


@cache
def _try(spec: str) -> None:
    """Find, make and check a simulator in another process, once; ConfigError also where that process was ended."""
    start = "import json, sys; sys.path[:] = json.load(sys.stdin); from simgap.loading.trial import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", start, spec, str(PATIENCE_S)], input=json.dumps(sys.path),
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    reports = [{"doing": "starting Python"}, *map(json.loads, done.stdout.splitlines())]
    if "passed" in reports[-1]:
        return
    if "wrong" in reports[-1]:
        raise ConfigError(reports[-1]["wrong"])
    doing = reports[-1]["doing"]
    if done.returncode == -signal.SIGALRM:
        raise ConfigError(
            f"{spec}: {doing} must end; it was stopped after {PATIENCE_S} s. Look for a loop that never ends, such as "
            "a jax.lax.while_loop whose condition stays true; or make the step quicker to compile."
        )
    how = f"signal {-done.returncode}" if done.returncode < 0 else f"status {done.returncode}"
    raise ConfigError(
        f"{spec}: {doing} must not end the process; it did ({how}). Look for os._exit, os.abort and os.kill, or for a "
        "compiled library that crashes."
    )


def main() -> None:
    """Find, make and check the simulator `argv[1]` within `argv[2]` seconds.

    Writes one JSON object per line to standard output: `doing`, before each stage; at the end `passed`, or `wrong` with
    the error. If neither comes, the last stage ended the process.
    """
    spec, seconds = sys.argv[1:]
    reports = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # so that output of the user's code does not mix with the reports
    signal.alarm(int(seconds))  # its default action ends the process, in compiled code too

    def report(what: str, text: str) -> None:
        print(json.dumps({what: text}), file=reports)

    report("doing", "importing JAX")
    import jax

    from simgap.loading.checks import check as check_here
    from simgap.loading.load import find, make
    from simgap.loading.user_code import reason

    jax.config.update("jax_platforms", "cpu")  # almost nothing is computed: take no accelerator memory
    try:
        report("doing", "importing its module")
        found = find(spec)
        report("doing", "making it")
        simulator = make(found, spec)
        report("doing", "trying its members and its step")
        check_here(simulator, spec)
    except ConfigError as error:
        report("wrong", str(error))
    except BaseException as error:
        report("wrong", f"{spec}: it must pass the checks of docs/how_to/own_simulator.md; they gave {reason(error)}.")
    else:
        report("passed", "")
