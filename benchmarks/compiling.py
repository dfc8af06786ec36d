"""What compiling the programs of a diagnosis costs with our settings of XLA, relative to XLA's own.

    python -m benchmarks.compiling

Five minutes. The baseline is the same process without our choice of emitters (`simgap/cli/environment.py`). The two
take turns, nothing is read from the cache, and every figure is processor time. Use an idle machine: another load
changes the times to run.
"""

import json
import os
import statistics
import subprocess
import sys
import time

REPEATS, RUNS = 3, 30
BASELINE, OURS = "XLA's own", "ours"
CHOICE = "--xla_cpu_use_fusion_emitters=false"


def main() -> None:
    """Measure in turns and print the medians."""
    from simgap.cli import environment

    flags = environment.numerics()["XLA_FLAGS"]
    if CHOICE not in flags:
        raise SystemExit("This version of jaxlib keeps its own emitters: there is nothing to compare.")
    settings = {BASELINE: flags.replace(CHOICE, "").strip(), OURS: flags}
    found: dict[str, list[dict[str, float]]] = {name: [] for name in settings}
    for _ in range(REPEATS):
        for name, value in settings.items():
            own = {**os.environ, "XLA_FLAGS": value, "JAX_ENABLE_COMPILATION_CACHE": "false"}
            command = [sys.executable, "-m", "benchmarks.compiling", "once"]
            found[name].append(json.loads(subprocess.run(command, check=True, env=own, stdout=subprocess.PIPE).stdout))
    for what in found[OURS][0]:
        base, ours = (statistics.median(one[what] for one in found[name]) for name in settings)
        print(f"{what:36}{base:8.3g}{ours:8.3g}   ratio {ours / base:.2f}")


def once() -> dict[str, float]:
    """Compile the innovations and their derivatives for sessions of the virtual Spot, and run them."""
    import jax
    import numpy as np

    from simgap.diagnosis.likelihood.directions import directions
    from simgap.diagnosis.likelihood.filter import filtered, tangents
    from simgap.diagnosis.likelihood.problem import Problem, start
    from simgap.diagnosis.likelihood.scales import measure
    from simgap.diagnosis.likelihood.segments import cut
    from simgap.effects.augmented import Augmented
    from simgap.robots.operator import OperatorConfig, record
    from simgap.robots.virtual_spot import VirtualSpotConfig
    from simgap.simulators.spot import Spot

    keys = jax.random.split(jax.random.key(0), 4)
    recordings = [record(key, 15.0, VirtualSpotConfig(), OperatorConfig(), f"s{i}") for i, key in enumerate(keys)]
    augmented = Augmented(Spot())
    problem = Problem(augmented, measure(augmented, recordings), cut(recordings, Spot().time_step), np.eye(12))
    v, (free, _) = start(problem), directions(problem, ())
    along = free.phi[:16], free.gain[:16], free.cross[:16]
    sent = filtered(augmented, problem.scales, v, problem.chunks, v.phi).sent
    programs = {
        "innovations": (filtered, (augmented, problem.scales, v, problem.chunks, v.phi)),
        "derivatives": (tangents, (augmented, problem.scales, v, along, problem.chunks, sent)),
    }
    spent: dict[str, float] = {}
    for name, (program, arguments) in programs.items():
        lowered = program.lower(*arguments)
        begun = time.process_time()
        compiled = lowered.compile()
        spent[f"{name}, compiled [s]"] = time.process_time() - begun
        jax.block_until_ready(compiled(*arguments[1:]))  # the first run allocates
        begun = time.process_time()
        for _ in range(RUNS):
            jax.block_until_ready(compiled(*arguments[1:]))
        spent[f"{name}, run [ms]"] = 1e3 / RUNS * (time.process_time() - begun)
    return spent


if __name__ == "__main__":
    if sys.argv[1:] == ["once"]:
        print(json.dumps(once()))
    else:
        main()
