"""Runs: parameters, tags, curves, scores and files of a piece of work, whatever ends it."""

import json
import math
import os
import socket
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import psutil
from mlflow.entities import Dataset, DatasetInput, InputTag, Metric, Param, RunTag
from mlflow.utils.mlflow_tags import MLFLOW_DATASET_CONTEXT, MLFLOW_PARENT_RUN_ID, MLFLOW_RUN_NOTE

from tasks.tracking.store import ERROR_LENGTH, Store, StoreError

CURVES = "training/"
"""Prefix of the curves' names, so that a curve and a score of one name stay apart."""
NON_FINITE = "non_finite"
"""Tag that names the metrics that had an infinite or undefined value."""
ERROR = "error"
"""Tag with what ended a run early."""
_HOST, _PID = "simgap.host", "simgap.pid"
_POINTS = 100  # a curve's, more than a plot shows
_PARAMS_PER_BATCH, _METRICS_PER_BATCH, _DIGEST_LENGTH = 100, 1000, 36  # MLflow's
_CLOCK_SLACK_S = 60.0


@dataclass(frozen=True)
class Run:
    """A run to write to, under way or finished: scores may come from a later stage as `Run(store, run_id).scores(...)`.

    Parameters cannot be changed once logged: another attempt at a cell is another run.
    """

    store: Store
    run_id: str

    def params(self, params: Mapping[str, Any]) -> None:
        """Parameters; nested ones as `train.bnn.learning_rate`."""
        entries = [Param(key, str(value)) for key, value in _flat(params)]
        for some in _batches(entries, _PARAMS_PER_BATCH):
            self.store.client.log_batch(self.run_id, params=some)

    def tags(self, tags: Mapping[str, str]) -> None:
        """Tags, those of the same name replaced."""
        self.store.client.log_batch(self.run_id, tags=[RunTag(key, value) for key, value in tags.items()])

    def describe(self, text: str) -> None:
        """A text for people, shown on top of the run's page."""
        self.tags({MLFLOW_RUN_NOTE: text})

    def artifact(self, path: Path, folder: str | None = None) -> None:
        """A file, kept beside the run under its name, in a folder there where one is given."""
        self.store.client.log_artifact(self.run_id, str(path), folder)

    def table(self, name: str, rows: Sequence[Mapping[str, Any]]) -> None:
        """Rows of the same keys as the table `<name>.json`, which MLflow's pages show side by side for several runs."""
        self.store.client.log_table(self.run_id, pd.DataFrame(rows), f"{name}.json")

    def register(self, name: str, aliases: Sequence[str], tags: Mapping[str, str]) -> None:
        """The run's model as the next version of the registered model `name`, found by these aliases from now on."""
        client, run = self.store.client, self.store.client.get_run(self.run_id)
        model = client.get_logged_model(run.outputs.model_outputs[-1].model_id)  # type: ignore[union-attr]
        try:
            client.create_registered_model(name)
        except StoreError as error:
            if error.code != "RESOURCE_ALREADY_EXISTS":
                raise
        made = client.create_model_version(
            name, model.artifact_location, self.run_id, tags=dict(tags), model_id=model.model_id
        )
        for alias in aliases:
            client.set_registered_model_alias(name, alias, str(made.version))

    def curve(self, steps: Sequence[int], metrics: Mapping[str, Sequence[float]]) -> None:
        """Training curves, as `training/<name>`: at most 100 points each, with the first, last, least and greatest."""
        points = [
            (CURVES + name, float(values[i]), int(steps[i]))
            for name, values in metrics.items()
            for i in _representative(np.asarray(values, np.float64))
        ]
        self._log(points, model_id=None)

    def scores(self, scores: Mapping[str, float]) -> None:
        """Results, shown beside the run and, if its model was logged before, beside the model.

        One that is logged again, as when a policy is tracked anew, comes as the next step; the last one is shown.
        """
        client, run = self.store.client, self.store.client.get_run(self.run_id)
        models = run.outputs.model_outputs if run.outputs else []
        logged = {
            name: len(client.get_metric_history(self.run_id, name)) for name in scores if name in run.data.metrics
        }
        points = [(name, float(value), logged.get(name, 0)) for name, value in scores.items()]
        self._log(points, models[-1].model_id if models else None)

    def _log(self, points: list[tuple[str, float, int]], model_id: str | None) -> None:
        # Curves are logged after the fact: the step says when, and the run's start serves as time.
        time_ms = self.store.client.get_run(self.run_id).info.start_time
        # MLflow would return an infinity as 1.8e308, which ruins axes and comparisons.
        metrics = [
            Metric(name, value if math.isfinite(value) else math.nan, time_ms, step, model_id)
            for name, value, step in points
        ]
        for some in _batches(metrics, _METRICS_PER_BATCH):
            self.store.client.log_batch(self.run_id, metrics=some)
        self._tag_non_finite({name for name, value, _ in points if not math.isfinite(value)})

    def _tag_non_finite(self, names: set[str]) -> None:
        if names:
            before = self.store.client.get_run(self.run_id).data.tags.get(NON_FINITE)
            self.tags({NON_FINITE: ", ".join(sorted(names | set(before.split(", ") if before else ())))})

    def dataset(self, name: str, path: Path, digest: str, context: str) -> None:
        """A data set the run used: its digest (the first 36 characters) and the context, like `training` or `test`."""
        source = json.dumps({"uri": str(path)})
        dataset = Dataset(name, digest[:_DIGEST_LENGTH], source_type="local", source=source)
        inputs = [DatasetInput(dataset, [InputTag(MLFLOW_DATASET_CONTEXT, context)])]
        try:
            self.store.client.log_inputs(self.run_id, datasets=inputs)
        except StoreError:
            # Another run entered the same data set between MLflow's look and its insert: now it is there to be found.
            self.store.client.log_inputs(self.run_id, datasets=inputs)


@contextmanager
def grid_run(store: Store, name: str, params: Mapping[str, Any], tags: Mapping[str, str]) -> Iterator[Run]:
    """The parent run of a grid; hand its `run_id` to the cells."""
    with _run(store, name, dict(tags)) as run:
        run.params(params)
        yield run


@contextmanager
def cell_run(store: Store, parent_run_id: str, name: str, tags: Mapping[str, str]) -> Iterator[Run]:
    """The run of one cell, with a name like `sim_fsvgd-N1000-s1`."""
    with _run(store, name, {**tags, MLFLOW_PARENT_RUN_ID: parent_run_id}) as run:
        yield run


@contextmanager
def diagnosis_run(store: Store, name: str, tags: Mapping[str, str]) -> Iterator[Run]:
    """The run of one diagnosis."""
    with _run(store, name, dict(tags)) as run:
        yield run


@contextmanager
def _run(store: Store, name: str, tags: dict[str, str]) -> Iterator[Run]:
    """A run that ends FINISHED; FAILED with the error in a tag, which is raised again; or KILLED when interrupted."""
    owner = {_HOST: socket.gethostname(), _PID: str(os.getpid())}
    run = Run(store, store.client.create_run(store.experiment_id, tags=tags | owner, run_name=name).info.run_id)
    try:
        yield run
    except BaseException as error:
        with suppress(StoreError):  # what went wrong first is reported; a run left open is closed at the next start
            run.tags({ERROR: f"{type(error).__name__}: {error}"[:ERROR_LENGTH]})
            store.client.set_terminated(run.run_id, "FAILED" if isinstance(error, Exception) else "KILLED")
        raise
    store.client.set_terminated(run.run_id)


def latest_run(store: Store, tags: Mapping[str, str], parent_run_id: str | None = None) -> Run | None:
    """Of the finished runs with these tags, of that parent where it is given, the one that began last."""
    tags = {**tags, MLFLOW_PARENT_RUN_ID: parent_run_id} if parent_run_id else tags
    query = " and ".join(
        ["attributes.status = 'FINISHED'", *(f"tags.`{key}` = '{value}'" for key, value in tags.items())]
    )
    found = store.client.search_runs(
        [store.experiment_id], query, max_results=1, order_by=["attributes.start_time DESC"]
    )
    return Run(store, found[0].info.run_id) if found else None


def close_stale_runs(store: Store) -> list[str]:
    """Mark as KILLED the runs of this host whose process is gone; returns their names.

    Runs of other hosts, whose processes cannot be seen from here, are left as they are.
    """
    query = f"attributes.status = 'RUNNING' and tags.`{_HOST}` = '{socket.gethostname()}'"
    stale = [
        run
        for run in store.client.search_runs([store.experiment_id], query)
        if not _alive(int(run.data.tags[_PID]), run.info.start_time / 1000)
    ]
    for run in stale:
        store.client.set_terminated(run.info.run_id, "KILLED")
    return [str(run.info.run_name) for run in stale]


def _alive(pid: int, since_s: float) -> bool:
    """Whether the process that had this number at that time is still there; a younger one only has its number."""
    try:
        process = psutil.Process(pid)
        return process.status() != psutil.STATUS_ZOMBIE and process.create_time() <= since_s + _CLOCK_SLACK_S
    except psutil.NoSuchProcess:
        return False


def _representative(values: np.ndarray) -> list[int]:
    """Indices of at most `_POINTS` values: evenly spaced from first to last, with the least and the greatest."""
    if len(values) <= _POINTS:
        return list(range(len(values)))
    finite = np.flatnonzero(np.isfinite(values))
    extremes = [finite[values[finite].argmin()], finite[values[finite].argmax()]] if finite.size else []
    even = np.linspace(0, len(values) - 1, _POINTS - 2).round().astype(int)
    return np.unique([*even, *extremes]).astype(int).tolist()


def _flat(nested: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in nested.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


def _batches(entries: list[Any], size: int) -> Iterator[list[Any]]:
    return (entries[i : i + size] for i in range(0, len(entries), size))
