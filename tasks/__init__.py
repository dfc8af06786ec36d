"""Prefect tasks, and what they need of MLflow, DVC and parameters. What they say is in Prefect's pages as well."""

import sys
from contextlib import suppress

from simgap.cli import progress


def _to_prefect(line: str) -> None:
    """A line for Prefect's pages, where a flow runs; in a terminal Prefect prints warnings and errors alone."""
    if "prefect" not in sys.modules:  # loading it takes seconds, and no flow runs without
        return
    from prefect.exceptions import MissingContextError
    from prefect.logging import get_run_logger

    with suppress(MissingContextError):
        get_run_logger().info(line)


progress.listeners.append(_to_prefect)
