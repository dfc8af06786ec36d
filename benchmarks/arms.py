"""Processor time of a diagnosis of a MuJoCo arm, with tables of what a fit can use and with whole tables.

    python -m benchmarks.arms

A quarter of an hour. Three joints, four sessions of 8 s at 50 Hz, friction left out of the model. In the baseline every
table of the engine has all derivatives and is made anew whenever a fit has moved. Each diagnosis is a process of its
own, run twice: the first time it compiles, the second time counts. Prints a table and writes benchmarks/arms.json.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from unittest.mock import patch

OUTPUT = Path(__file__).with_name("arms.json")
BASELINE, OURS = "whole tables", "ours"


def main() -> None:
    """Measure, print and write."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        record = [sys.executable, "-m", "examples.record", "arm", f"{folder}/arm", "--sessions", "4"]
        subprocess.run(record, check=True, stdout=subprocess.DEVNULL)
        own = {**os.environ, "JAX_COMPILATION_CACHE_DIR": f"{folder}/jax"}
        for name in 2 * (BASELINE, OURS):
            command = [sys.executable, "-m", "benchmarks.arms", name, f"{folder}/arm"]
            found[name] = json.loads(subprocess.run(command, check=True, env=own, stdout=subprocess.PIPE).stdout)
    ratios = {what: found[OURS][what] / found[BASELINE][what] for what in found[OURS]}
    OUTPUT.write_text(json.dumps({**found, "ratio": ratios}, indent=1) + "\n")
    for what, ratio in ratios.items():
        print(f"{what:24}{found[BASELINE][what]:12.3g}{found[OURS][what]:12.3g}   ratio {ratio:.2f}")


def once(tables: str, folder: str) -> dict[str, float]:
    """Diagnose with these tables: processor time [s], and rows of the engine that were computed."""
    from simgap.cli import environment

    environment.settle(environment.numerics())
    from simgap.api import diagnose
    from simgap.diagnosis.inference import explain
    from simgap.diagnosis.inference.fitting import relinearise
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
