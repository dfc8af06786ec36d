"""Disks that are full, stores that are locked, read-only or gone, files that are damaged: told, and nothing is lost."""

import multiprocessing
import os
import pickle
import re
import resource
import shlex
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import mlflow.pyfunc
import numpy as np
import psutil
import pytest
from conftest import free_port
from given import fitted_spot
from mlflow.store.tracking.sqlalchemy_store import SqlAlchemyStore
from prefect import flow
from prefect.settings import PREFECT_API_URL, temporary_settings
from sqlalchemy import text

from flows import running
from flows.errors import guarded
from flows.locks import alone, held
from simgap.cli import locks
from simgap.formats.arrays import load_arrays, save_arrays
from simgap.formats.atomic import remove_unfinished
from simgap.formats.documents import write_json
from simgap.formats.recordings import read_recordings
from simgap.simulators.spot import SCHEMA
from simgap.types import SimgapError
from tasks import artifacts
from tasks.files.digests import fingerprint_of
from tasks.files.models import save_model
from tasks.tracking.models import log_model
from tasks.tracking.runs import cell_run, close_stale_runs, grid_run
from tasks.tracking.store import Store, StoreError, open_store
from tasks.workspace import Workspace

ROOT = Path(__file__).parents[2]
ARRAYS = {"a": np.arange(1000.0)}


@contextmanager
def full_disk(limit: int) -> Iterator[None]:
    """No file of this process may grow beyond so many bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_is_told_of_and_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "model.npz"
    save_arrays(path, ARRAYS)
    before = path.read_bytes()
    with (
        full_disk(2000),
        pytest.raises(SimgapError, match=r"model\.npz: cannot be written \(File too large\). Free disk space"),
    ):
        save_arrays(path, {"a": np.arange(2000.0)})
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["model.npz"]


KILLED = """
import os, signal, sys
from pathlib import Path
import numpy as np
from simgap.formats.arrays import save_arrays
os.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
save_arrays(Path(sys.argv[1]), {"a": np.zeros(9)})
"""


def test_a_process_killed_while_it_writes_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "models" / "model.npz"
    save_arrays(path, ARRAYS)
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)], cwd=ROOT, timeout=200)
    assert done.returncode == -signal.SIGKILL
    np.testing.assert_array_equal(load_arrays(path)["a"], ARRAYS["a"])
    left = [p.name for p in path.parent.iterdir() if p != path]
    assert [name for name in left if not (name.startswith(".") and name.endswith(".tmp"))] == []
    assert len(left) == 1
    with pytest.raises(SimgapError, match="no file matches"):
        read_recordings(path.parent, SCHEMA, 0.1)
    under_way = path.parent / left[0].replace(f"-{done_by(left[0])}-", f"-{os.getpid()}-")
    under_way.touch()
    remove_unfinished(tmp_path)
    assert {p.name for p in path.parent.iterdir()} == {path.name, under_way.name}


def done_by(name: str) -> str:
    """The process that wrote a file that is not finished."""
    return name.split("-")[1]


def test_a_file_where_a_folder_must_be_is_told_of(tmp_path: Path) -> None:
    (tmp_path / "models").write_text("")
    with pytest.raises(SimgapError, match=r"x\.npz: cannot be written \(.*start again"):
        save_arrays(tmp_path / "models" / "x.npz", ARRAYS)


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 not an archive", None])
def test_a_damaged_artifact_counts_as_none(tmp_path: Path, damage: bytes | None) -> None:
    record, arrays = tmp_path / "cell.json", tmp_path / "cell.npz"
    save_arrays(arrays, ARRAYS)
    write_json(record, {"fingerprint": "f"})
    assert fingerprint_of(record, arrays) == "f"
    whole = arrays.read_bytes()
    arrays.write_bytes(whole[: len(whole) // 2] if damage is None else damage)
    assert fingerprint_of(record, arrays) is None
    arrays.write_bytes(whole)
    record.write_text('{"fingerpr')
    assert fingerprint_of(record, arrays) is None
    record.write_text("[1]")
    assert fingerprint_of(record, arrays) is None


def test_arrays_that_hold_a_pickle_are_not_loaded(tmp_path: Path) -> None:
    class Bomb:
        def __reduce__(self) -> tuple[Any, ...]:
            return os.mkdir, (str(tmp_path / "exploded"),)

    np.savez(tmp_path / "x.npz", a=np.array([Bomb()], dtype=object))
    (tmp_path / "y.npz").write_bytes(pickle.dumps(Bomb()))
    for name in ("x.npz", "y.npz"):
        with pytest.raises(SimgapError, match="is no whole file of arrays"):
            load_arrays(tmp_path / name)
    assert not (tmp_path / "exploded").exists()


# The store


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store with its tables, which take seconds to make."""
    folder = tmp_path_factory.mktemp("store")
    (folder / "mlflow.db.new").write_bytes(b"what a start killed while it made the tables leaves")
    open_store(folder, "grid")
    return folder


@pytest.fixture
def root(made: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    shutil.copy(made / "mlflow.db", tmp_path / "mlflow.db")
    return tmp_path


def logged(store: Store, params: dict[str, Any] | None = None) -> str:
    with grid_run(store, "grid", params or {"a": 1}, {}) as run:
        run.scores({"nll": 1.0})
    return run.run_id


def test_a_locked_store_is_waited_for(root: Path) -> None:
    store = open_store(root, "grid")
    holder = sqlite3.connect(root / "mlflow.db", check_same_thread=False)
    holder.execute("BEGIN EXCLUSIVE")
    release = threading.Timer(7.0, holder.rollback)  # SQLite by itself gives up after five
    release.start()
    run_id = logged(store)
    release.join()
    holder.close()
    assert store.client.get_run(run_id).data.metrics == {"nll": 1.0}


LOCKING = """
import sqlite3, sys
sqlite3.connect(sys.argv[1]).execute("BEGIN EXCLUSIVE")
print("locked", flush=True)
input()
"""


@contextmanager
def locked(database: Path) -> Iterator[None]:
    """Another process holds it."""
    holder = subprocess.Popen([sys.executable, "-c", LOCKING, database], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"locked\n"
        yield
    finally:
        holder.kill()
        holder.communicate()


def test_a_store_that_stays_locked_is_an_error_when_patience_ends(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tasks.tracking.store._PATIENCE_S", 1.0)
    store = open_store(root, "grid")
    with locked(root / "mlflow.db"):
        start = time.monotonic()
        with pytest.raises(StoreError, match=r"mlflow\.db refused .*locked.* start again"):
            logged(store)
    assert 1.0 <= time.monotonic() - start < 10.0  # MLflow's own patience is 20 s


def test_patience_is_what_the_docs_say(root: Path) -> None:
    """In a session of MLflow, which sets another one."""
    assert "database locked | Simgap waits for a minute" in (ROOT / "docs" / "how_to" / "recover.md").read_text()
    store = SqlAlchemyStore(f"sqlite:///{root / 'mlflow.db'}", str(root))
    with store.ManagedSessionMaker() as session:
        assert session.execute(text("PRAGMA busy_timeout")).scalar() == 60_000


def test_a_process_goes_on_when_a_full_disk_has_room_again(tmp_path: Path) -> None:
    """Full while the store was made, and full while a run was logged."""
    with full_disk(300_000), pytest.raises(StoreError, match=r"mlflow\.db refused .* has room"):
        open_store(tmp_path, "grid")
    assert not (tmp_path / "mlflow.db").exists()
    store = open_store(tmp_path, "grid")
    with full_disk((tmp_path / "mlflow.db").stat().st_size), pytest.raises(StoreError, match="has room"):
        logged(store, {f"key_{i}": "x" * 1000 for i in range(1000)})
    run_id = logged(store)
    assert store.client.get_run(run_id).data.metrics == {"nll": 1.0}


def test_a_store_is_for_its_owner_alone(root: Path) -> None:
    """Also one that was not."""
    (root / "mlflow.db").chmod(0o644)
    open_store(root, "grid")
    assert (root / "mlflow.db").stat().st_mode & 0o777 == 0o600


def test_a_read_only_store_is_told_of(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(root)  # MLflow makes a folder by the name of what it takes for a path
    uri = f"sqlite:///file:{root / 'mlflow.db'}?mode=ro&uri=true"
    with pytest.raises(StoreError, match=r"refused .*readonly.* may be written to"):
        logged(open_store(root, "grid", uri))


def test_a_server_that_is_gone_is_told_of(nobody: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    with pytest.raises(StoreError, match=f"{nobody} refused .* start again"):
        logged(Store(nobody, "grid", "1"))


@pytest.fixture
def nobody() -> Iterator[str]:
    """An address at which nobody answers: bound, and not listened to."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        yield f"http://127.0.0.1:{taken.getsockname()[1]}"


def test_a_prefect_server_that_is_gone_costs_the_pages_alone(nobody: str, capsys: pytest.CaptureFixture[str]) -> None:
    with temporary_settings({PREFECT_API_URL: f"{nobody}/api"}):
        progress = artifacts.Progress("cells", 2)
        progress.done(1)
        artifacts.table("results", [{"nll": 1.0}], "Results")
    assert capsys.readouterr().out.count("warning: Prefect's pages are not updated") == 2


def test_a_flow_without_its_prefect_server_says_so(nobody: str, capsys: pytest.CaptureFixture[str]) -> None:
    worked = []
    with temporary_settings({PREFECT_API_URL: f"{nobody}/api"}), pytest.raises(SystemExit) as ended:
        guarded(flow(lambda: worked.append(1), name="any"))
    assert (ended.value.code, worked) == (1, [])
    assert "error: Prefect's server does not answer" in capsys.readouterr().out


SERVING = """
import sys
import flows
from prefect.server.api.server import SubprocessASGIServer
print(SubprocessASGIServer(port=int(sys.argv[1]))._run_uvicorn_command().pid, flush=True)
input()
"""


OWN = """
import os, urllib.error, urllib.request
from pathlib import Path
import flows
from flows.fan_out import one_server
from prefect.settings import PREFECT_API_URL

with one_server():
    for path, body in (("csrf-token?client=me", None), ("flows/", b"{}")):
        try:
            urllib.request.urlopen(f"{PREFECT_API_URL.value()}/{path}", body)
        except urllib.error.HTTPError as error:
            print("refused", error.code)
    print({path.name: oct(path.stat().st_mode & 0o777) for path in Path(".prefect").glob("prefect.db*")})
"""


@pytest.mark.long
def test_a_prefect_server_that_a_cluster_starts_is_for_it_alone(tmp_path: Path) -> None:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")}
    done = subprocess.run(
        [sys.executable, "-c", OWN], env={**environment, "PYTHONPATH": str(ROOT)}, cwd=tmp_path, timeout=300,
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.count("refused 401") == 2, done
    for name in ("prefect.db", "prefect.db-wal", "prefect.db-shm"):
        assert f"'{name}': '0o600'" in done.stdout


def test_a_prefect_server_left_by_a_killed_command_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As soon as its command is gone, and of this folder alone."""
    command = subprocess.Popen(
        [sys.executable, "-c", SERVING, str(free_port())], env={**os.environ, "PREFECT_HOME": str(tmp_path)}, cwd=ROOT,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert command.stdout is not None
    server = psutil.Process(int(command.stdout.readline()))
    try:
        for gone, home in ((False, tmp_path), (True, tmp_path / "another")):
            if gone:
                command.kill()
                command.wait()
            monkeypatch.setenv("PREFECT_HOME", str(home))
            running.end_left_over()
            assert psutil.wait_procs([server], timeout=0.5)[1]
        monkeypatch.setenv("PREFECT_HOME", str(tmp_path))
        running.end_left_over()
        server.wait(60)
    finally:
        for process in (server, command):
            with suppress(psutil.NoSuchProcess):
                process.kill()


def test_a_store_lost_midway_does_not_hide_what_went_wrong_first(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tasks.tracking.store._PATIENCE_S", 0.2)
    store = open_store(root, "grid")

    def work() -> None:
        with sqlite3.connect(root / "mlflow.db") as holder, grid_run(store, "grid", {}, {}):
            holder.execute("BEGIN EXCLUSIVE")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        work()
    assert close_stale_runs(store) == [], "its process, this one, is there"


def _write(root: str, name: str, count: int, together: Any) -> None:
    store = open_store(Path(root), "grid")
    together.wait(200)
    for i in range(count):
        with cell_run(store, "none", f"{name}-{i}", {"sweep": name}) as run:
            run.params({"i": i})
            run.curve(range(20), {"loss": list(range(20))})


def test_two_at_once_lose_nothing(root: Path) -> None:
    """Two processes write to one store."""
    spawn = multiprocessing.get_context("spawn")
    together = spawn.Barrier(2)
    other = spawn.Process(target=_write, args=(str(root), "other", 40, together))
    other.start()
    _write(str(root), "one", 40, together)
    other.join(200)
    assert other.exitcode == 0
    store = open_store(root, "grid")
    runs = store.client.search_runs([store.experiment_id])
    assert len(runs) == 80
    assert {run.info.status for run in runs} == {"FINISHED"}


def test_one_name_is_one_run_at_a_time(tmp_path: Path) -> None:
    """A folder is held whole, what belongs to a source is held where a stage works on it, and others are free."""
    mine, source = tmp_path / "mine", Workspace(tmp_path / "mine", "virtual").lock
    holder = f"lock: held by process {os.getpid()} on .* since .*{re.escape(shlex.join(sys.orig_argv))}"
    with alone(mine, "virtual"):
        for taken in (lambda: locks.alone(mine), lambda: alone(mine, "spot"), lambda: held(source)):
            with pytest.raises(SimgapError, match=holder), taken():
                pass
        with alone(tmp_path / "other", "virtual"), held(Workspace(mine, "spot").lock):
            pass
    assert source.read_text() == ""
    with held(source), pytest.raises(SimgapError, match=r"\.virtual\.lock: held by"), alone(mine, "virtual"):
        pass
    with alone(mine, "virtual"):
        pass


HOLDING = """
import sys
import flows
from pathlib import Path
from flows.locks import alone
with alone(Path(sys.argv[1]), "virtual"):
    print("held", flush=True)
    input()
"""


def test_a_lock_is_free_again_when_its_holder_is_killed(tmp_path: Path) -> None:
    """And says of whom it is until then."""
    holder = subprocess.Popen([sys.executable, "-c", HOLDING, str(tmp_path)], cwd=ROOT, text=True,
                              stdin=subprocess.PIPE, stdout=subprocess.PIPE)  # fmt: skip
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    with pytest.raises(SimgapError, match=f"held by process {holder.pid} on "), locks.alone(tmp_path):
        pass
    holder.kill()
    holder.wait()
    with alone(tmp_path, "virtual"):
        pass


def test_a_lock_that_cannot_be_opened_is_named(tmp_path: Path) -> None:
    (tmp_path / ".lock").mkdir()
    with pytest.raises(SimgapError, match=r"\.lock: cannot be opened \(Is a directory\)"), locks.alone(tmp_path):
        pass


def test_the_best_is_registered_again_and_again(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = open_store(root, "grid")
    save_model(tmp_path / "model.npz", fitted_spot())
    for sweep in ("one", "other"):
        with cell_run(store, "none", "cell", {}) as run:
            log_model(run, tmp_path / "model.npz")
        run.register("dynamics", [sweep, "newest"], {"cell": "cell"})
    versions = {a: store.client.get_model_version_by_alias("dynamics", a).version for a in ("one", "other", "newest")}
    assert versions == {"one": 1, "other": 2, "newest": 2}
    monkeypatch.setenv("MLFLOW_TRACKING_URI", store.uri)
    assert mlflow.pyfunc.load_model("models:/dynamics@one")
