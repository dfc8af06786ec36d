"""Timing: cases that take turns, the spread of their figures, and the machine that they ran on."""

import os
import platform
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import jax

Job = Callable[[], object]


class Case(NamedTuple):
    """A job that trains `models` models, for `--steps` steps each."""

    job: Job
    models: int


def side_by_side(jobs: Sequence[Job]) -> None:
    """All jobs at once, a thread each, as the pipeline trains."""
    with ThreadPoolExecutor(len(jobs)) as pool:
        for future in [pool.submit(job) for job in jobs]:
            future.result()


def seconds(job: Job) -> float:
    """Wall-clock time of the job."""
    start = time.perf_counter()
    job()
    return time.perf_counter() - start


def measure(cases: Mapping[str, Case], steps: int, repeats: int) -> dict[str, list[float]]:
    """Milliseconds per model and step. A first call of each compiles; then they take turns, back and forth."""
    for case in cases.values():
        case.job()
    ms: dict[str, list[float]] = {name: [] for name in cases}
    for repeat in range(repeats):
        for name in list(cases)[:: 1 if repeat % 2 == 0 else -1]:
            ms[name].append(1e3 * seconds(cases[name].job) / (cases[name].models * steps))
    return ms


def spread(values: Sequence[float]) -> dict[str, float]:
    """Least, median and greatest."""
    return {"min": min(values), "median": statistics.median(values), "max": max(values)}


def ratio(ms: Mapping[str, Sequence[float]], numerator: str, denominator: str) -> dict[str, float]:
    """The ratio within each repeat."""
    return spread([a / b for a, b in zip(ms[numerator], ms[denominator], strict=True)])


def machine() -> dict[str, Any]:
    """What the figures depend on; the load average [processes] is that of the minute before the start."""
    return {
        "processor": processor(),
        "cpus": os.cpu_count(),
        "load_before": os.getloadavg()[0],
        "platform": platform.platform(),
        "python": platform.python_version(),
        "jax": jax.__version__,
        "device": str(jax.devices()[0].device_kind),
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
    }


def processor() -> str:
    """The processor's name."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
