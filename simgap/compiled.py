"""Compiled code that is kept in memory, and when there is too much of it.

Every compiled function holds a dozen maps of memory, and Linux allows a process 65,530 of them
(`vm.max_map_count`). Beyond, LLVM ends the process. A process that diagnoses machine after machine gets there.
"""

from pathlib import Path

import jax

MAPS, LIMIT = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
FULL = 0.4
"""Share of the allowed maps from which on compiled functions are forgotten: what one diagnosis adds stays below the
rest."""


def forget_if_many() -> bool:
    """Forget all compiled functions where their maps are many; returns whether they were. They are compiled again, or
    read from the cache on disk, when they are called. Elsewhere than on Linux nothing is forgotten."""
    try:
        with MAPS.open("rb") as maps:
            count = sum(1 for _ in maps)
        allowed = int(LIMIT.read_text(encoding="ascii"))
    except OSError:
        return False
    if count < FULL * allowed:
        return False
    jax.clear_caches()
    return True
