"""Speed of a diagnosis of 8 sessions with 4,800 transitions of the virtual Spot.

    python -m benchmarks.diagnosis

The baseline is the straightforward way to find one effect: every hypothesis fitted in full, one after the other. One
such fit is measured in the same run, and multiplied by the number of hypotheses. Compilation is separate: the
diagnosis runs twice, and the second run counts. Prints a table and writes benchmarks/diagnosis.json.
"""

import json
import resource
import time
from pathlib import Path

import jax
import numpy as np

from simgap.diagnosis.diagnose import Diagnosis, diagnose
from simgap.diagnosis.hypotheses.space import hypotheses_of
from simgap.diagnosis.inference.evidence.score_test import vary
from simgap.diagnosis.inference.fitting.gauss_newton import optimise
from simgap.diagnosis.likelihood.problem import Problem, evaluate, start, whitening
from simgap.diagnosis.likelihood.scales import measure
from simgap.diagnosis.likelihood.segments import cut
from simgap.effects.augmented import Augmented
from simgap.recordings import split
from simgap.robots.operator import OperatorConfig, record
from simgap.robots.virtual_spot import VirtualSpotConfig
from simgap.simulators.spot import Spot
from simgap.types import Recording, Sessions

OUTPUT = Path(__file__).with_name("diagnosis.json")
SESSIONS = 8
SECONDS = 40.0


def main() -> None:
    """Measure, print, write."""
    keys = jax.random.split(jax.random.key(0), SESSIONS)
    recordings = [record(key, SECONDS, VirtualSpotConfig(), OperatorConfig(), f"s{i}") for i, key in enumerate(keys)]
    training, heldout = split(recordings)
    compiling, _ = _timed(training, heldout)
    seconds, found = _timed(training, heldout)
    one, count = _one_fit(training)
    rounds = len(found.statement["rounds"])
    results = {
        "transitions": sum(len(r.time_s) - 1 for r in recordings),
        "seconds": seconds,
        "seconds_with_compilation": compiling,
        "rounds": rounds,
        "effects": [effect["id"] for effect in found.statement["effects"]],
        "baseline_seconds": one * count * rounds,
        "ratio": seconds / (one * count * rounds),
        "peak_memory_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }
    OUTPUT.write_text(json.dumps(results, indent=1) + "\n")
    for name, value in results.items():
        print(f"{name:26} {value:.3g}" if isinstance(value, float) else f"{name:26} {value}")


def _timed(training: list[Recording], heldout: list[Recording]) -> tuple[float, Diagnosis]:
    begun = time.perf_counter()
    found = diagnose(Spot(), "spot", Sessions(training, heldout))
    return time.perf_counter() - begun, found


def _one_fit(training: list[Recording]) -> tuple[float, int]:
    """Seconds of one hypothesis fitted in full, and the number of hypotheses."""
    augmented = Augmented(Spot())
    scales = measure(augmented, training)
    problem = Problem(augmented, scales, cut(training, Spot().time_step), np.eye(12))
    begun = evaluate(problem, start(problem), ())
    problem = problem._replace(whiten=whitening(begun.e))
    fit, _ = optimise(problem, evaluate(problem, begun.v, ()))
    every = hypotheses_of(augmented, scales)
    start_s = time.perf_counter()
    for hypothesis in every[:3]:
        optimise(problem, evaluate(problem, vary(fit.v, hypothesis, hypothesis.starts[0]), hypothesis.groups))
    return (time.perf_counter() - start_s) / 3, len(every)


if __name__ == "__main__":
    main()
