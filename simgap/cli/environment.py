"""How a process that computes is set up, before any library is imported."""

import gc
import os
from collections.abc import Mapping
from pathlib import Path

EMITTERS = "0.10."
"""Versions of jaxlib with new emitters of fused code: without them the programs of a diagnosis take about half as long
to compile, and about as long to run (benchmarks/README.md). XLA ends a process that sets a flag it does not know, so
other versions keep what they come with."""


def numerics() -> dict[str, str]:
    """Settings of a process that computes."""
    from jaxlib.version import __version__ as jaxlib  # of no use to a command that only prints its help

    # Threads of the diagnosis and of the training compute side by side: no library may spread one over the cores.
    flags = ["--xla_cpu_multi_thread_eigen=false"]
    if jaxlib.startswith(EMITTERS):
        flags.append("--xla_cpu_use_fusion_emitters=false")
    return {
        "XLA_FLAGS": " ".join(flags),
        "OPENBLAS_NUM_THREADS": "1",
        # All is compiled once for all processes, what takes less than a second too: there are dozens of these in each.
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }


def collect_seldom() -> None:
    """Look for garbage seldom: tracing makes millions of small objects that live on, and looking through them again
    and again takes a tenth of a diagnosis."""
    gc.set_threshold(50_000, 20, 100)


def settle(values: Mapping[str, str]) -> None:
    """Set what the user has not set."""
    for name, value in values.items():
        os.environ.setdefault(name, value)


def cache() -> Path:
    """Where the command keeps compiled code, outside of the current folder."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "simgap" / "jax"
