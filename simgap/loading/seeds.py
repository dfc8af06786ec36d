"""Checks the seed of a diagnosis' random draws. Cheap to import: a wrong seed is reported before the work starts."""

from numbers import Integral
from typing import Any

from simgap.types import ConfigError

LARGEST = 2**31 - 1
"""The largest 32-bit integer, which every random number generator takes."""


def check_seed(seed: Any) -> None:
    """ConfigError unless it is a valid seed."""
    if not isinstance(seed, Integral) or not 0 <= int(seed) <= LARGEST:
        raise ConfigError(f"seed is {seed!r:.40}; it must be a whole number from 0 to {LARGEST:,}.")
