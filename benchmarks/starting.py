"""What commands cost before they work: seconds of processor time, and shares of Prefect's own import in the same run.

`python -m benchmarks.starting` takes a minute and prints a table; another machine's load changes the shares little.
"""

import os
import resource
import statistics
import subprocess
import sys
from collections.abc import Sequence

BASELINE = "import prefect"
REPEATS = 3
IMPORTS = ("prefect", "simgap.cli.main", "flows.recordings", "flows.transitions", "flows.train", "flows.report")
COMMANDS = {f"import {name}": ["-c", f"import flows, {name}"] for name in IMPORTS}


def processor_seconds(arguments: Sequence[str]) -> float:
    """User and system time [s] of a Python process and what it waited for; without a Prefect server, as in a shell."""
    before = _used()
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")}
    subprocess.run([sys.executable, *arguments], check=True, env=environment)
    return _used() - before


def _used() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Measure in turns and print the medians."""
    found: dict[str, list[float]] = {name: [] for name in COMMANDS}
    for _ in range(REPEATS):
        for name, arguments in COMMANDS.items():
            found[name].append(processor_seconds(arguments))
    base = statistics.median(found[BASELINE])
    for name, values in found.items():
        middle = statistics.median(values)
        print(f"{name:28}{middle:6.2f} s{middle / base:7.2f}   ({min(values):.2f} to {max(values):.2f})")


if __name__ == "__main__":
    main()
