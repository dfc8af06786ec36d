"""Which number may be the seed of what a diagnosis draws. Cheap to import: a wrong one is reported before the work."""

from numbers import Integral
from typing import Any

from simgap.types import ConfigError

LARGEST = 2**31 - 1
"""The greatest whole number of 32 bits, which every generator of random numbers takes."""


def check_seed(seed: Any) -> None:
    """ConfigError where it is no seed."""
    if not isinstance(seed, Integral) or not 0 <= int(seed) <= LARGEST:
        raise ConfigError(f"seed is {seed!r:.40}; it must be a whole number from 0 to {LARGEST:,}.")
