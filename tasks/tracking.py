"""The door to MLflow: one parent run per grid, one child run per cell, one run per diagnosis, in a store that survives
kills and fan-out.

Every call names its store and its run: no active run, which is per thread, and no global tracking URI, which MLflow
would write into the environment. A `Store` and a `Run` are names only; they travel to other threads and processes.
"""

import base64
import fcntl
import json
import math
import os
import re
import shlex
import socket
import tempfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mlflow.pyfunc
import numpy as np
import pandas as pd
import psutil
from mlflow import MlflowClient
from mlflow.entities import Dataset, DatasetInput, InputTag, LoggedModelOutput, Metric, Param, RunTag
from mlflow.exceptions import MlflowException
from mlflow.models import Model, ModelSignature
from mlflow.store.tracking.sqlalchemy_store import SqlAlchemyStore
from mlflow.types import ColSpec, Schema
from mlflow.utils.mlflow_tags import MLFLOW_DATASET_CONTEXT, MLFLOW_PARENT_RUN_ID, MLFLOW_RUN_NOTE
from sqlalchemy import Engine, event
from sqlalchemy.exc import SQLAlchemyError

from simgap.types import Schema as RobotSchema
from simgap.types import SimgapError
from tasks import augmented_pyfunc, policy_pyfunc, pyfunc
from tasks.files.folders import keep_private, make_folder

MODEL = "model"
"""Name of a run's model: `mlflow.pyfunc.load_model("runs:/<run id>/model")`."""
CURVES = "training/"
"""Prefix of the curves' names, so that a curve and a score of one name stay apart."""
NON_FINITE = "non_finite"
"""Tag that names the metrics that had an infinite or undefined value."""
ERROR = "error"
"""Tag with what ended a run early."""

# The pages open in a mode for language models otherwise.
_TRAINING, _KIND, _TRAINING_KIND = "?workflowType=machine_learning", "mlflow.experimentKind", "custom_model_development"
MODELS = ("metrics.`nll`", "metrics.`validation_nll`", "metrics.`calibration_error`", "metrics.`seconds`",
          "params.`model`", "params.`sample_size`", "params.`seed`", "tags.`config`")  # fmt: skip
POLICIES = ("metrics.`helix/mean_error`", "metrics.`ellipse/mean_error`", "metrics.`return`", "metrics.`lost`",
            "params.`model`", "params.`sample_size`", "params.`seed`", "tags.`config`")  # fmt: skip
DIAGNOSES = ("metrics.`augmented/nll_1`", "metrics.`refitted/nll_1`", "metrics.`black_box/nll_1`", "tags.`verdict`",
             "tags.`effects`", "params.`simulator`", "params.`transitions`", "tags.`config`")  # fmt: skip
"""Columns one wants where runs stand side by side, in the order of the first; see `compare`."""

_HOST, _PID = "simgap.host", "simgap.pid"
_POINTS = 100  # a curve's, more than a plot shows
_PARAMS_PER_BATCH, _METRICS_PER_BATCH, _DIGEST_LENGTH, _ERROR_LENGTH = 100, 1000, 36, 1000  # MLflow's, but the last
_CLOCK_SLACK_S = 60.0
_PATIENCE_S = 60.0  # with a database that another process has locked
# The project itself is left out: it is on no index, and the name may come to be another's there.
_REQUIREMENTS = [f"{name}=={version(name)}" for name in ("mlflow", "jax", "jaxtyping", "numpy", "scipy", "pandas")]


@dataclass(frozen=True)
class Store:
    """Where runs are kept: tracking URI and experiment; the address of MLflow's pages, where they are served."""

    uri: str
    experiment: str
    experiment_id: str
    pages: str = ""

    @property
    def client(self) -> Any:
        """MLflow's client; it keeps one connection pool per URI and process, so that making one costs nothing."""
        return _Client(self.uri)


class StoreError(SimgapError):
    """The store did not do what was asked of it; that may pass. `code`: MLflow's word for it."""

    code = ""


class _Client:
    """MLflow's client, whose errors explain themselves."""

    def __init__(self, uri: str) -> None:
        # Other processes write too; SQLite would give up after five seconds.
        self._uri = uri
        with _explaining(uri):
            self._client = MlflowClient(f"{uri}?timeout={_PATIENCE_S}" if _plain_file(uri) else uri)

    def __getattr__(self, name: str) -> Any:
        method = getattr(self._client, name)

        def call(*args: Any, **kwargs: Any) -> Any:
            with _explaining(self._uri):
                return method(*args, **kwargs)

        return call


@event.listens_for(Engine, "before_cursor_execute", retval=True)
def _wait(_connection: Any, _cursor: Any, statement: str, parameters: Any, *_: Any) -> tuple[str, Any]:
    """Every session of MLflow sets 20 s, whatever its address asks for."""
    if statement.startswith("PRAGMA busy_timeout ="):
        statement = f"PRAGMA busy_timeout = {_PATIENCE_S * 1000:.0f}"
    return statement, parameters


def _plain_file(uri: str) -> bool:
    return uri.startswith("sqlite:///") and "?" not in uri


@contextmanager
def _explaining(uri: str) -> Iterator[None]:
    try:
        yield
    except (MlflowException, SQLAlchemyError, OSError) as error:
        raise _explained(uri, error) from error


def _explained(uri: str, error: Exception) -> StoreError:
    cause: BaseException = error
    while within := cause.__cause__ or cause.__context__:
        cause = within
    first = next((line for line in str(cause).splitlines() if line.strip()), type(cause).__name__)
    explained = StoreError(
        f"The MLflow store {_without_password(uri)} refused ({first[:_ERROR_LENGTH]}). What was computed is kept in "
        "its files. See that the store is there, has room, may be written to and is not locked; then start again: what "
        "is finished is not repeated."
    )
    explained.code = getattr(error, "error_code", "")
    return explained


def open_store(root: Path, experiment: str, uri: str | None = None, pages: str = "") -> Store:
    """The experiment in SQLite at `root/mlflow.db` with artifacts under `root/mlruns`, or in the store at `uri`.

    Creates what is missing, one process at a time (MLflow's migrations die when two run them at once), so call it
    before any fan-out.
    """
    root = root.resolve()
    make_folder(root)
    uri = uri or f"sqlite:///{root / 'mlflow.db'}"
    # A server says itself where artifacts go; to a database the client would write them under its working directory.
    artifacts = None if uri.startswith("http") else (root / "mlruns" / experiment).as_uri()
    with (root / "mlflow.db.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if _plain_file(uri):
            make_database(Path(uri.removeprefix("sqlite:///")), root / "mlruns")
        return Store(uri, experiment, _experiment_id(_Client(uri), experiment, artifacts), pages)


def make_database(path: Path, artifacts: Path) -> None:
    """MLflow's tables in SQLite, if the file is not there; made beside it and put in its place whole.

    MLflow's migrations, killed midway, leave a database that no start mends.
    """
    if not path.exists():
        new = path.with_name(f"{path.name}.new")
        with _explaining(f"sqlite:///{path}"):
            new.unlink(missing_ok=True)
            keep_private(new)
            engine = SqlAlchemyStore._get_or_create_engine(f"sqlite:///{new}")
            try:
                SqlAlchemyStore(f"sqlite:///{new}", artifacts.as_uri())
            finally:
                engine.dispose()  # MLflow keeps it: the next attempt would write to the file that is deleted first
            new.replace(path)
    keep_private(path)


def pages() -> Any:
    """MLflow's pages and interface, as an ASGI application."""
    from mlflow.server.fastapi_app import app  # seconds, and a store in the environment

    return app


def _experiment_id(client: Any, name: str, artifacts: str | None) -> str:
    found = client.get_experiment_by_name(name)
    if found is None:
        return client.create_experiment(name, artifact_location=artifacts, tags={_KIND: _TRAINING_KIND})
    if found.lifecycle_stage != "active":
        raise SimgapError(
            f"The MLflow experiment {name!r} must be active and is {found.lifecycle_stage}. Restore it with "
            f"`mlflow experiments restore --experiment-id {found.experiment_id}`, or end it with `mlflow gc`."
        )
    return found.experiment_id


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

        One that is told again, as when a policy is tracked anew, comes as the next step; the last one is shown.
        """
        client, run = self.store.client, self.store.client.get_run(self.run_id)
        models = run.outputs.model_outputs if run.outputs else []
        told = {name: len(client.get_metric_history(self.run_id, name)) for name in scores if name in run.data.metrics}
        points = [(name, float(value), told.get(name, 0)) for name, value in scores.items()]
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

    def model(self, model_path: Path, columns_in: Sequence[str], columns_out: Sequence[str]) -> str:
        """A file of `files.save_model`, loadable by `mlflow.pyfunc.load_model` with the URI returned.

        A table of `columns_in` goes in, one of `mean_<output>` and `std_<output>` comes out; see `tasks.pyfunc`.
        """
        predicted = [f"{moment}_{name}" for moment in ("mean", "std") for name in columns_out]
        config = pyfunc.Columns(inputs=[*columns_in], outputs=[*columns_out])
        return self._pyfunc(pyfunc.__name__, model_path, config, columns_in, predicted)

    def policy(self, policy_path: Path, columns_in: Sequence[str], columns_out: Sequence[str]) -> str:
        """A file of `files.save_policy`, as a model from `columns_in` to `columns_out`; see `tasks.policy_pyfunc`."""
        config = pyfunc.Columns(inputs=[*columns_in], outputs=[*columns_out])
        return self._pyfunc(policy_pyfunc.__name__, policy_path, config, columns_in, columns_out)

    def simulator(self, path: Path, name: str, schema: RobotSchema) -> str:
        """The constants of a diagnosed simulator called `name`, as a model; see `tasks.augmented_pyfunc`."""
        inputs, outputs = augmented_pyfunc.input_columns(schema), augmented_pyfunc.output_columns(schema)
        config = augmented_pyfunc.Origin(simulator=name)
        return self._pyfunc(augmented_pyfunc.__name__, path, config, inputs, outputs)

    def _pyfunc(
        self, loader: str, path: Path, config: Mapping[str, Any], inputs: Sequence[str], predicted: Sequence[str]
    ) -> str:
        # MLflow's own `log_model` writes to the global tracking URI; these are its steps, with the store named.
        client = self.store.client
        logged = client.create_logged_model(
            self.store.experiment_id, MODEL, self.run_id, params=client.get_run(self.run_id).data.params
        )
        description = Model(logged.artifact_location, self.run_id, model_id=logged.model_id)
        with tempfile.TemporaryDirectory() as scratch:
            _save_pyfunc(Path(scratch) / MODEL, loader, path, description, config, inputs, predicted)
            client.log_model_artifacts(logged.model_id, str(Path(scratch) / MODEL))
        client.finalize_logged_model(logged.model_id, "READY")
        client.log_outputs(self.run_id, [LoggedModelOutput(logged.model_id, step=0)])
        return f"models:/{logged.model_id}"


def _save_pyfunc(
    path: Path,
    loader: str,
    data: Path,
    description: Model,
    config: Mapping[str, Any],
    inputs: Sequence[str],
    predicted: Sequence[str],
) -> None:
    mlflow.pyfunc.save_model(
        path,
        loader_module=loader,
        data_path=data,
        model_config=dict(config),
        mlflow_model=description,
        signature=ModelSignature(_numbers(inputs), _numbers(predicted)),
        input_example=pd.DataFrame(np.zeros((1, len(inputs))), columns=list(inputs)),
        pip_requirements=_REQUIREMENTS,
    )


def _numbers(columns: Sequence[str]) -> Schema:
    return Schema([ColSpec("double", name) for name in columns])


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
        with suppress(StoreError):  # what went wrong first is told; a run left open is closed at the next start
            run.tags({ERROR: f"{type(error).__name__}: {error}"[:_ERROR_LENGTH]})
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


def link(store: Store, run_id: str) -> str:
    """How a person finds the run: its address, or the command that serves it and the address then."""
    page = f"#/experiments/{store.experiment_id}/runs/{run_id}{_TRAINING}"
    if store.pages or store.uri.startswith("http"):
        return f"{_without_password(store.pages or store.uri).rstrip('/')}/{page}"
    served = f"mlflow ui --backend-store-uri {shlex.quote(_without_password(store.uri))}"
    name = store.client.get_run(run_id).info.run_name
    return f"{name}: {served}, then http://127.0.0.1:5000/{page}"


def compare(store: Store, view: str, query: str, columns: Sequence[str]) -> str:
    """Where the runs that a query finds stand side by side in the pages, as the view of this name: these columns, the
    least value of the first on top; empty where no pages are served."""
    if not store.pages:
        return ""
    state = {"searchFilter": query, "selectedColumns": columns, "orderByKey": columns[0], "orderByAsc": True}
    # As the pages' own button for sharing a view writes it.
    packed = "deflate;" + base64.b64encode(zlib.compress(json.dumps(state).encode())).decode()
    store.client.set_experiment_tag(store.experiment_id, f"mlflow.sharedViewState.{view}", packed)
    return f"{store.pages}/#/experiments/{store.experiment_id}/runs{_TRAINING}&viewStateShareKey={view}"


def _without_password(uri: str) -> str:
    return re.sub(r"//[^/@]*@", "//", uri)


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
