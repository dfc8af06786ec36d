"""Tries a user's simulator in a process of its own: what its code does to the process, it does to this one alone."""

import json
import os
import signal
import sys

from simgap.types import ConfigError


def main() -> None:
    """Find, make and check the simulator `argv[1]` within `argv[2]` seconds.

    Standard output gets a JSON object a line: what is being `doing`, before it is done; last `passed`, or what is
    `wrong`. Where neither comes, the process was ended by what it was doing.
    """
    spec, seconds = sys.argv[1:]
    reports = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what the user's code prints is no report
    signal.alarm(int(seconds))  # its default action ends the process, in compiled code too

    def report(what: str, text: str) -> None:
        print(json.dumps({what: text}), file=reports)

    report("doing", "importing JAX")
    import jax

    from tasks import simulators

    jax.config.update("jax_platforms", "cpu")  # next to nothing is computed: no accelerator's memory is taken for it
    try:
        report("doing", "importing its module")
        found = simulators.find(spec)
        report("doing", "making it")
        simulator = simulators.make(found, spec)
        report("doing", "trying its members and its step")
        simulators.check(simulator, spec)
    except ConfigError as error:
        report("wrong", str(error))
    except BaseException as error:
        report("wrong", f"{spec}: it must pass the checks of docs/simulators.md; they gave {simulators.reason(error)}.")
    else:
        report("passed", "")
