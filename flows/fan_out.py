"""Cells side by side: threads of this process, or processes of a Dask cluster."""

import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from prefect import Task
from prefect.settings import (
    PREFECT_API_AUTH_STRING,
    PREFECT_API_URL,
    PREFECT_HOME,
    PREFECT_SERVER_API_AUTH_STRING,
    temporary_settings,
)
from prefect.task_runners import TaskRunner, ThreadPoolTaskRunner

from flows import running
from simgap.cli import progress
from simgap.formats.folders import keep_private
from tasks import artifacts, server
from tasks.workspace import Cell, Workspace

CLUSTER = "SIMGAP_CLUSTER"
"""Environment variable: a Dask scheduler's address, or how many processes to start on this machine; none: threads."""

Place = tuple[Workspace, Cell]


def fan_out(
    what: str, work: Task[..., Any], cells: Mapping[Place, Mapping[str, Any]], workers: int
) -> dict[Place, str]:
    """Call `work(workspace, cell, job, clock, ...)` for every cell, `workers` threads at a time, or on the cluster.

    Returns what went wrong, by cell. When this process is asked to end, work under way ends at its next report; what is
    finished is kept.
    """
    failed: dict[Place, str] = {}
    cluster = os.environ.get(CLUSTER)
    runner = _dask(cluster) if cluster else ThreadPoolTaskRunner(max_workers=workers)
    served = one_server() if cluster and not server.there() else nullcontext()
    with progress.bars(what, len(cells), time.monotonic) as bars, served, runner:
        page = artifacts.Progress(what, len(cells))
        with _stopping(bars):
            # Bars are of this process; on a cluster, the lines are the workers'.
            common = {"job": progress.plain_job if cluster else bars.job, "clock": time.perf_counter}
            futures = {
                place: runner.submit(work, {"workspace": place[0], "cell": place[1], **common, **more})
                for place, more in cells.items()
            }
            for done, (place, future) in enumerate(futures.items(), 1):
                future.wait()
                page.done(done)
                if not future.state.is_completed():
                    failed[place] = str(future.state.message)
    return failed


@contextmanager
def _stopping(bars: progress.Bars) -> Iterator[None]:
    """Whatever ends the wait ends the work: the threads' runner waits for them when it is left."""
    try:
        yield
    except BaseException:
        bars.stop()
        raise


@contextmanager
def one_server() -> Iterator[None]:
    """A Prefect server for a cluster's workers, with a login that only they know; it ends with the work."""
    from prefect.server.api.server import SubprocessASGIServer  # seconds of imports, for a cluster alone

    login = running.new_login()
    keep_private(Path(str(PREFECT_HOME.value())) / running.DATABASE)
    with (
        temporary_settings({PREFECT_API_AUTH_STRING: login, PREFECT_SERVER_API_AUTH_STRING: login}),
        SubprocessASGIServer() as started,
        temporary_settings({PREFECT_API_URL: started.api_url}),
    ):
        yield


def _dask(cluster: str) -> TaskRunner[Any]:
    """Workers of one thread each, which import JAX once and keep it; those that die are replaced and their cells
    begun again, three times at most."""
    from prefect_dask.task_runners import DaskTaskRunner  # seconds of imports, for a cluster alone

    if not cluster.isdigit():
        return DaskTaskRunner(address=cluster)
    local = {
        "n_workers": int(cluster),
        "threads_per_worker": 1,
        "host": "127.0.0.1",
        "dashboard_address": "127.0.0.1:0",
    }
    return DaskTaskRunner(cluster_class="distributed.LocalCluster", cluster_kwargs=local)
