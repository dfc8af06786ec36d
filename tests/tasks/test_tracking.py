"""The door to MLflow, against a real SQLite store."""

import base64
import json
import math
import os
import pickle
import re
import subprocess
import sys
import threading
import time
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import jax.numpy as jnp
import mlflow.pyfunc
import numpy as np
import pandas as pd
import pytest
from scipy import stats

from simgap import models, networks
from simgap.recordings import Normalisation, to_transitions
from simgap.simulators import parameter_ranges
from simgap.simulators.spot import SCHEMA, Spot
from simgap.types import DivergenceError, Recording, RecordingError, SimgapError
from tasks import pyfunc
from tasks.files.models import save_model
from tasks.tracking import links
from tasks.tracking.models import log_model
from tasks.tracking.runs import Run, cell_run, close_stale_runs, grid_run, latest_run
from tasks.tracking.store import Store, open_store

OUTPUTS = SCHEMA.encoded
DYING = """
import os, sys
from pathlib import Path
from tasks.tracking.runs import cell_run
from tasks.tracking.store import open_store

store = open_store(Path(sys.argv[1]), "grid")
with cell_run(store, "none", sys.argv[2], {}):
    os._exit(9)
"""


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    return open_store(tmp_path_factory.mktemp("store"), "grid")


def facts(run: Run):
    return run.store.client.get_run(run.run_id)


def history(run: Run, metric: str) -> dict[int, float]:
    return {m.step: m.value for m in run.store.client.get_metric_history(run.run_id, metric)}


def bnn() -> models.BNN:
    keys = iter(jax.random.split(jax.random.key(0), 4))
    spread = lambda n: jnp.exp(0.3 * jax.random.normal(next(keys), (n,)))  # noqa: E731
    return models.BNN(
        networks.init(jax.random.key(1), 5, (31, 16, 13)),
        scale=spread(13),
        dof=jnp.array([jnp.inf] * 5 + [1.2] * 4 + [7.0] * 4),
        normalisation=Normalisation(jnp.full(31, 0.5), spread(31), jnp.full(13, -0.2), spread(13)),
    )


def fitted_spot() -> models.FittedSpot:
    low, high = parameter_ranges(Spot())
    return models.FittedSpot(
        jnp.asarray((low + high) / 2), jnp.full(13, 0.1), jnp.full(13, jnp.inf), jnp.asarray(1 / 15)
    )


def recorded(rows: int) -> Recording:
    rng = np.random.default_rng(0)
    return Recording("drawn", np.arange(rows) / 15, rng.normal(size=(rows, 12)), rng.normal(size=(rows, 6)))


def test_a_grid_holds_its_cells(store: Store):
    with grid_run(store, "grid", {"train": {"bnn": {"layers": [64, 64]}}, "seeds": 5}, {"git": "f00"}) as grid:
        with cell_run(store, grid.run_id, "fsvgd-N500-s1", {"model": "fsvgd"}) as cell:
            cell.params({"sample_size": 500} | {f"knob_{i}": i for i in range(150)})
            cell.curve([0, 100], {"nll": [3.0, 1.0]})
            cell.scores({"nll": -2.5})
            cell.dataset("transitions", Path("data/spot/training.npz"), "d" * 64, "training")
        assert facts(grid).info.status == "RUNNING"
    parent, child = facts(grid), facts(cell)
    assert parent.info.status == child.info.status == "FINISHED"
    assert parent.data.params == {"train.bnn.layers": "[64, 64]", "seeds": "5"}
    assert parent.data.tags["git"] == "f00"
    assert child.info.run_name == "fsvgd-N500-s1"
    assert child.data.tags["model"] == "fsvgd"
    assert child.data.tags["mlflow.parentRunId"] == grid.run_id
    assert child.data.params["sample_size"] == "500"
    assert len(child.data.params) == 151
    assert child.data.metrics == {"training/nll": 1.0, "nll": -2.5}
    (used,) = child.inputs.dataset_inputs
    assert (used.dataset.name, used.dataset.digest) == ("transitions", "d" * 36)
    assert [(t.key, t.value) for t in used.tags] == [("mlflow.data.context", "training")]


def test_a_curve_is_thinned_and_keeps_what_matters(store: Store):
    steps = np.arange(0, 30_000, 10)
    loss = np.exp(-steps / 1e4)
    loss[[0, 1234, 1777, -1]] = 0.9, -5.0, 40.0, 0.1
    with cell_run(store, "none", "curve", {}) as run:
        run.curve(steps.tolist(), {"loss": loss.tolist(), "flat": [1.0] * len(steps)})
    kept = history(run, "training/loss")
    assert len(kept) <= 100
    assert {s: kept[s] for s in (0, 12340, 17770, 29990)} == {0: 0.9, 12340: -5.0, 17770: 40.0, 29990: 0.1}
    assert np.diff(sorted(kept)).max() < 400
    assert len(history(run, "training/flat")) <= 100


def test_more_points_than_a_batch_takes(store: Store):
    with cell_run(store, "none", "many", {}) as run:
        run.curve(list(range(100)), {f"m{i:02}": [float(i)] * 100 for i in range(25)})
    assert all(len(history(run, f"training/m{i:02}")) == 100 for i in range(25))


def test_what_is_not_finite_is_nan_and_named(store: Store):
    with cell_run(store, "none", "diverged", {}) as run:
        run.curve([0, 1, 2], {"loss": [1.0, math.inf, math.nan], "fine": [1.0, 2.0, 3.0]})
        run.scores({"nll": -math.inf, "rmse": 0.1})
    curve = history(run, "training/loss")
    assert curve[0] == 1.0
    assert math.isnan(curve[1])
    assert math.isnan(curve[2])
    assert math.isnan(facts(run).data.metrics["nll"])
    assert facts(run).data.metrics["rmse"] == 0.1
    assert facts(run).data.tags["non_finite"] == "nll, training/loss"


def test_a_failing_cell_fails_alone(store: Store):
    with grid_run(store, "grid", {}, {}) as grid:
        with pytest.raises(DivergenceError), cell_run(store, grid.run_id, "bad", {}) as bad:
            raise DivergenceError("the loss left the finite numbers at step 40")
        with pytest.raises(KeyboardInterrupt), cell_run(store, grid.run_id, "stopped", {}) as stopped:
            raise KeyboardInterrupt
        with cell_run(store, grid.run_id, "good", {}) as good:
            pass
    assert [facts(r).info.status for r in (bad, stopped, good, grid)] == ["FAILED", "KILLED", "FINISHED", "FINISHED"]
    assert facts(bad).data.tags["error"] == "DivergenceError: the loss left the finite numbers at step 40"
    assert "error" not in facts(good).data.tags


def test_the_latest_run_is_found_by_its_tags(store: Store):
    mark = {"fingerprint": "abc", "git": "f00"}
    with cell_run(store, "none", "older", mark):
        pass
    time.sleep(0.01)  # start times are in milliseconds
    with cell_run(store, "none", "latest", mark) as latest:
        pass
    with pytest.raises(ValueError, match="no"), cell_run(store, "none", "failed", mark):
        raise ValueError("no")
    with cell_run(store, "none", "other", {"fingerprint": "abc", "git": "f01"}):
        pass
    assert latest_run(store, mark) == latest
    assert latest_run(store, {"fingerprint": "unknown"}) is None


def test_threads_log_cells_at_once(store: Store, tmp_path: Path):
    save_model(tmp_path / "model.npz", fitted_spot())

    def log(k: int) -> Run:
        with cell_run(pickle.loads(pickle.dumps(store)), "none", f"thread-{k}", {}) as run:
            run.params({"k": k})
            run.curve(list(range(100)), {f"m{i}": [float(k)] * 100 for i in range(5)})
            run.dataset("shared", Path("shared.npz"), "1234", "training")
            log_model(run, tmp_path / "model.npz")
            run.scores({"k": k})
        return run

    with ThreadPoolExecutor(2) as pool:
        runs = list(pool.map(log, range(6)))
    for k, run in enumerate(runs):
        found = facts(run)
        assert (found.info.run_name, found.info.status) == (f"thread-{k}", "FINISHED")
        assert found.data.params == {"k": str(k)}
        assert found.data.metrics == {"k": k} | {f"training/m{i}": k for i in range(5)}
        assert [d.dataset.digest for d in found.inputs.dataset_inputs] == ["1234"]
        assert len(found.outputs.model_outputs) == 1


def test_a_data_set_may_be_entered_by_several_runs_at_once(store: Store):
    runs = [Run(store, store.client.create_run(store.experiment_id).info.run_id) for _ in range(4)]
    together = threading.Barrier(len(runs))

    def log(run: Run) -> None:
        for k in range(20):
            together.wait(timeout=30)
            run.dataset(f"raced-{k}", Path("raced.npz"), "1234", "test")

    with ThreadPoolExecutor(len(runs)) as pool:
        list(pool.map(log, runs))
    assert [len(facts(run).inputs.dataset_inputs) for run in runs] == [20] * 4


def test_stale_runs_are_closed_and_live_ones_are_not(tmp_path: Path):
    # Two processes also create the store at the same moment.
    script = [sys.executable, "-c", DYING, str(tmp_path)]
    dying = [subprocess.Popen([*script, name]) for name in ("one", "two")]
    assert [p.wait() for p in dying] == [9, 9]
    store = open_store(tmp_path, "grid")
    with cell_run(store, "none", "live", {}) as live:
        owner = {k: v for k, v in facts(live).data.tags.items() if k.startswith("simgap.")}
        hour_ago_ms = int(1000 * (time.time() - 3600))
        younger = subprocess.Popen(["sleep", "60"])  # a run of an hour ago whose number this process has now
        reused = owner | {"simgap.pid": str(younger.pid)}
        elsewhere = owner | {"simgap.pid": str(dying[0].pid), "simgap.host": "elsewhere"}
        store.client.create_run(store.experiment_id, hour_ago_ms, reused, "reused")
        store.client.create_run(store.experiment_id, hour_ago_ms, elsewhere, "elsewhere")
        store.client.create_run(store.experiment_id, run_name="foreign")
        try:
            assert sorted(close_stale_runs(store)) == ["one", "reused", "two"]
        finally:
            younger.kill()
            younger.wait()
        status = {r.info.run_name: r.info.status for r in store.client.search_runs([store.experiment_id])}
    gone = dict.fromkeys(("one", "two", "reused"), "KILLED")
    assert status == gone | dict.fromkeys(("live", "elsewhere", "foreign"), "RUNNING")
    assert close_stale_runs(store) == []
    assert facts(live).info.status == "FINISHED"


@pytest.mark.parametrize("make", [bnn, fitted_spot])
def test_a_logged_model_loads_and_predicts(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, make: Callable[[], models.Model]
):
    model = make()
    save_model(tmp_path / "model.npz", model)
    with cell_run(store, "none", "model", {}) as run:
        run.params({"seed": 1})
        uri = log_model(run, tmp_path / "model.npz")
    Run(store, run.run_id).scores({"nll": -3.0})  # a later stage's
    assert os.environ.get("MLFLOW_TRACKING_URI") is None
    logged = store.client.get_logged_model(uri.removeprefix("models:/"))
    assert (logged.params, [(m.key, m.value) for m in logged.metrics]) == ({"seed": "1"}, [("nll", -3.0)])
    Run(store, run.run_id).scores({"nll": -2.0, "rmse": 0.1})  # that stage's again, run with other parameters
    assert facts(run).data.metrics == {"nll": -2.0, "rmse": 0.1}

    monkeypatch.setenv("MLFLOW_TRACKING_URI", store.uri)
    session = recorded(10)
    x = to_transitions(SCHEMA, [session]).x
    table = pd.DataFrame(np.column_stack([session.time_s, session.state, session.command]), columns=SCHEMA.columns)
    table.index = pd.RangeIndex(20, 30)
    loaded = mlflow.pyfunc.load_model(f"runs:/{run.run_id}/model")
    predicted = loaded.predict(table[list(reversed(SCHEMA.columns))])
    assert list(predicted.index) == list(table.index)
    pd.testing.assert_frame_equal(mlflow.pyfunc.load_model(uri).predict(table), predicted)
    assert predicted.isna().all(axis=1).tolist() == [True] * 2 + [False] * 8
    predicted = predicted[2:-1]  # the last row has no successor in the transitions
    expected = jax.vmap(models.predict, in_axes=(None, 0))(model, x)
    mean = predicted[[f"mean_{o}" for o in OUTPUTS]].to_numpy()
    std = predicted[[f"std_{o}" for o in OUTPUTS]].to_numpy()
    np.testing.assert_allclose(mean, expected.mean.mean(1), rtol=1e-5, atol=1e-6)
    noise = std**2 - np.asarray(expected.mean).var(1)
    inside = stats.t.cdf(np.sqrt(noise) / expected.scale, expected.dof) - 0.5
    np.testing.assert_allclose(2 * inside, stats.norm.cdf(1) - stats.norm.cdf(-1), rtol=1e-3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda table: table.drop(columns="cmd_ee_vz"), "lacks cmd_ee_vz; it must have the columns of a recording"),
        (lambda table: pd.concat([table, table]), "time_s does not increase after row 10 of the table"),
    ],
)
def test_a_table_that_is_no_session_is_refused(change: Callable[[pd.DataFrame], pd.DataFrame], words: str):
    session = recorded(10)
    table = pd.DataFrame(np.column_stack([session.time_s, session.state, session.command]), columns=SCHEMA.columns)
    with pytest.raises(RecordingError, match=words):
        pyfunc.Dynamics(fitted_spot()).predict(change(table))


def test_noise_std_is_the_standard_deviation_where_noise_is_gaussian():
    scale = np.array([0.1, 2.0, 2.0])
    std = pyfunc.noise_std(scale, np.array([np.inf, np.inf, 1e6]))
    np.testing.assert_allclose(std, scale, rtol=1e-5)


def test_a_link_leads_to_the_run(store: Store):
    with cell_run(store, "none", "fsvgd-N100-s0", {}) as run:
        pass
    text = links.to_run(store, run.run_id)
    assert text.startswith(f"fsvgd-N100-s0: mlflow ui --backend-store-uri {store.uri}, then http://")
    assert f"#/experiments/{store.experiment_id}/runs/{run.run_id}?" in text
    server = Store("https://me:secret@host/", "grid", "7")
    assert links.to_run(server, "abc") == "https://host/#/experiments/7/runs/abc?workflowType=machine_learning"


def test_a_comparison_opens_on_results_and_the_parameters_that_differ(tmp_path: Path):
    store = open_store(tmp_path, "compared", pages="http://127.0.0.1:5000")
    with grid_run(store, "grid", {"seed": "[0, 1]", "rate": 1}, {"sweep": "s"}) as grid:
        for seed in (0, 1):
            with cell_run(store, grid.run_id, f"cell-{seed}", {"sweep": "s"}) as cell:
                cell.params({"model": "fsvgd", "seed": seed, "rate": 2})
    with cell_run(store, "none", "of another sweep", {"sweep": "t"}) as cell:
        cell.params({"model": "sim_model", "seed": 0})
    assert links.differing(store, "tags.sweep = 's'") == ["params.`seed`"]
    assert sorted(links.differing(store, "")) == ["params.`model`", "params.`seed`"]
    address = links.to_comparison(store, "s", "tags.sweep = 's'", links.MODEL_RESULTS)
    assert address.endswith("viewStateShareKey=s")
    packed = store.client.get_experiment(store.experiment_id).tags["mlflow.sharedViewState.s"]
    state = json.loads(zlib.decompress(base64.b64decode(packed.removeprefix("deflate;"))))
    assert state["selectedColumns"] == ["params.`seed`", *links.MODEL_RESULTS]


def test_a_deleted_experiment_says_what_to_do(tmp_path: Path, store: Store):
    gone = open_store(tmp_path, "gone", store.uri)
    assert open_store(tmp_path, "gone", store.uri) == gone
    store.client.delete_experiment(gone.experiment_id)
    with pytest.raises(SimgapError, match=re.escape(f"restore --experiment-id {gone.experiment_id}")):
        open_store(tmp_path, "gone", store.uri)
