"""The store: MLflow's database, its client, and errors that say what to do."""

import fcntl
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mlflow import MlflowClient
from mlflow.exceptions import MlflowException
from sqlalchemy import Engine, event
from sqlalchemy.exc import SQLAlchemyError

from simgap.formats.folders import keep_private, make_folder
from simgap.types import SimgapError

ERROR_LENGTH = 1000
"""Characters of an error that are shown and kept."""
_PATIENCE_S = 60.0  # with a database that another process has locked
# The pages open in a mode for language models otherwise.
_KIND = {"mlflow.experimentKind": "custom_model_development"}


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
        from mlflow.store.tracking.sqlalchemy_store import SqlAlchemyStore  # a second of imports

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


def _experiment_id(client: Any, name: str, artifacts: str | None) -> str:
    found = client.get_experiment_by_name(name)
    if found is None:
        return client.create_experiment(name, artifact_location=artifacts, tags=_KIND)
    if found.lifecycle_stage != "active":
        raise SimgapError(
            f"The MLflow experiment {name!r} must be active and is {found.lifecycle_stage}. Restore it with "
            f"`mlflow experiments restore --experiment-id {found.experiment_id}`, or end it with `mlflow gc`."
        )
    return found.experiment_id


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
        f"The MLflow store {without_password(uri)} refused ({first[:ERROR_LENGTH]}). What was computed is kept in "
        "its files. See that the store is there, has room, may be written to and is not locked; then start again: what "
        "is finished is not repeated."
    )
    explained.code = getattr(error, "error_code", "")
    return explained


def without_password(uri: str) -> str:
    """The address without the name and password that it may hold."""
    return re.sub(r"//[^/@]*@", "//", uri)
