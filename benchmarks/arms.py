"""Processor time of a diagnosis of a MuJoCo arm, from recordings to the page, relative to one with whole tables.

    python -m benchmarks.arms

About ten minutes. Three joints, four sessions of 8 s at 50 Hz, friction left out of the model. The baseline is the
same diagnosis where every table of the engine has all derivatives and is made anew whenever a fit has moved; ours has
only those that the fit can use, and keeps them while it moves little. The two take turns, each in a process of its own
that reads what is compiled from one cache. Prints a table and writes benchmarks/arms.json.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from unittest.mock import patch

OUTPUT = Path(__file__).with_name("arms.json")
REPEATS = 1
BASELINE, OURS = "whole tables", "ours"


def main() -> None:
    """Measure in turns, print and write the medians."""
    found: dict[str, list[dict[str, float]]] = {BASELINE: [], OURS: []}
    with tempfile.TemporaryDirectory() as folder:
        record = [sys.executable, "-m", "examples.record", "arm", f"{folder}/arm", "--sessions", "4"]
        subprocess.run(record, check=True, stdout=subprocess.DEVNULL)
        own = {**os.environ, "JAX_COMPILATION_CACHE_DIR": f"{folder}/jax"}
        for repeat in range(-1, REPEATS):  # the first turn only compiles
            for name in found:
                command = [sys.executable, "-m", "benchmarks.arms", name, f"{folder}/arm"]
                answer = subprocess.run(command, check=True, env=own, stdout=subprocess.PIPE).stdout
                if repeat >= 0:
                    found[name].append(json.loads(answer))
    median = {name: {k: statistics.median(one[k] for one in runs) for k in runs[0]} for name, runs in found.items()}
    ratios = {k: median[OURS][k] / median[BASELINE][k] for k in median[OURS]}
    OUTPUT.write_text(json.dumps({**median, "ratio": ratios}, indent=1) + "\n")
    for k, ratio in ratios.items():
        print(f"{k:24}{median[BASELINE][k]:12.3g}{median[OURS][k]:12.3g}   ratio {ratio:.2f}")


def once(tables: str, folder: str) -> dict[str, float]:
    """Diagnose with these tables: processor time [s], and rows of the engine that were computed."""
    from simgap.cli import environment

    environment.settle(environment.numerics())
    from simgap.api import diagnose
    from simgap.diagnosis.inference import explain, relinearise
    from simgap.diagnosis.likelihood.linearised import tabulated
    from simgap.simulators.mujoco.engine import MujocoEngine

    def whole(problem, v, chunks, *_):
        return tabulated(problem, v, chunks)

    def counted(engine, phi, terms, *given):
        computed.append(len(terms))
        return rows(engine, phi, terms, *given)

    computed, rows = [], MujocoEngine.rows
    with ExitStack() as stack:
        stack.enter_context(patch.object(MujocoEngine, "rows", counted))
        for module in (explain, relinearise) if tables == BASELINE else ():
            stack.enter_context(patch.object(module, "tabulated", whole))
        diagnose("examples/arm.xml", folder)
    return {"processor time [s]": time.process_time(), "rows of the engine": float(sum(computed))}


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print(json.dumps(once(*sys.argv[1:])))
    else:
        main()
