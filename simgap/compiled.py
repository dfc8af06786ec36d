"""Compiled functions in memory, and when to clear them.

Every compiled function holds a dozen memory maps, and Linux allows a process 65,530 of them
(`vm.max_map_count`). Beyond that, LLVM ends the process. A process that diagnoses one machine after another gets there.
"""

from pathlib import Path

import jax

MAPS, LIMIT = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
FULL = 0.4
"""Share of the allowed maps from which on compiled functions are cleared: one diagnosis adds less than the rest."""


def forget_if_many() -> bool:
    """Clear all compiled functions if they hold too many maps; returns whether it did. Linux only.

    A cleared function is compiled again, or read from the cache on disk, when it is called.
    """
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
