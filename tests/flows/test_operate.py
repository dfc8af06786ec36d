"""`make up` in a folder of its own: what is started from Prefect's form, watched, cancelled and compared in MLflow."""

import base64
import http.client
import http.server
import json
import os
import re
import shutil
import socket
import stat
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import psutil
import pytest
import yaml
from conftest import free_port
from mlflow import MlflowClient
from test_pipeline import TINY

from examples.record import record
from flows import running
from tasks import recordings
from tasks.params import VirtualParams, load_params
from tasks.tracking.runs import diagnosis_run
from tasks.tracking.store import open_store
from tasks.workspace import Workspace

ROOT = Path(__file__).parents[2]
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
ONE: dict[str, Any] = {"models": ["sim_model"], "sample_sizes": [40]}


class Place(NamedTuple):
    """A project's folder and what runs there."""

    folder: Path
    ports: tuple[int, int]
    host: str = "127.0.0.1"

    @property
    def prefect(self) -> str:
        return f"http://127.0.0.1:{self.ports[0]}"

    @property
    def mlflow(self) -> str:
        return f"http://127.0.0.1:{self.ports[1]}"

    @property
    def environment(self) -> dict[str, str]:
        mine = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")}
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        return {**mine, "PATH": path, "PYTHONPATH": str(ROOT), **running.client(self.prefect, self.login)}

    @property
    def login(self) -> str | None:
        file = self.folder / "logs" / "prefect.pid"
        return json.loads(file.read_text())["login"] if file.exists() else None

    def run(self, *command: str) -> tuple[int, str]:
        done = subprocess.run(command, cwd=self.folder, env=self.environment, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, text=True, timeout=400)  # fmt: skip
        return done.returncode, done.stdout

    def up(self) -> tuple[int, str]:
        ports = ("--prefect-port", str(self.ports[0]), "--mlflow-port", str(self.ports[1]))
        return self.run("python", "-m", "flows.servers", "up", "--host", self.host, *ports)

    def api(self, path: str, body: Any = None) -> Any:
        data, headers = None, {"Content-Type": "application/json"}
        if self.login:
            headers["Authorization"] = f"Basic {base64.b64encode(self.login.encode()).decode()}"
        if body is not None:
            data, token = json.dumps(body).encode(), self.api("csrf-token?client=test")["token"]
            headers |= {"Prefect-Csrf-Client": "test", "Prefect-Csrf-Token": token}
        request = urllib.request.Request(f"{self.prefect}/api/{path}", data, headers)
        with urllib.request.urlopen(request, timeout=30) as reply:
            return json.load(reply)

    def deployment(self, name: str) -> str:
        return self.api(f"deployments/name/{name}")["id"]

    def start(self, name: str, parameters: dict[str, Any]) -> str:
        body = {"parameters": parameters, "state": {"type": "SCHEDULED"}}
        return self.api(f"deployments/{self.deployment(name)}/create_flow_run", body)["id"]

    def state(self, flow_run: str) -> dict[str, Any]:
        return self.api(f"flow_runs/{flow_run}")["state"]

    def until(self, flow_run: str, names: set[str], seconds: float) -> dict[str, Any]:
        deadline = time.monotonic() + seconds
        while (state := self.state(flow_run))["name"] not in names:
            assert time.monotonic() < deadline, (state, self.log())
            time.sleep(0.3)
        return state

    def log(self) -> str:
        return (self.folder / "logs" / "deployments.log").read_text()[-4000:]

    def client(self) -> MlflowClient:
        return MlflowClient(f"sqlite:///{self.folder / 'mlflow.db'}")

    def runs(self, sweep: str) -> list[Any]:
        client = self.client()
        experiment = client.get_experiment_by_name("model-validation")
        assert experiment is not None
        return client.search_runs([experiment.experiment_id], f"tags.sweep = '{sweep}'")


@contextmanager
def brought_up(folder: Path, host: str = "127.0.0.1") -> Iterator[Place]:
    """The servers and deployments, up in a folder whose params.yaml is tiny."""
    tiny = {**TINY, "train": {**TINY["train"], **ONE}, "policy": {**TINY["policy"], **ONE}}
    params = load_params(ROOT / "params.yaml", tiny).model_dump(mode="json")
    (folder / "params.yaml").write_text(yaml.safe_dump(params, sort_keys=False))
    (folder / "pipelines").mkdir()
    (folder / "pipelines" / "small.yaml").write_text("train: {sim_model: {training_steps: 50, evaluate_every: 50}}\n")
    place = Place(folder, (free_port(), free_port()), host)
    status, output = place.up()
    try:
        assert status == 0, output
        yield place
    finally:
        for file in (folder / "logs").glob("*.pid"):
            process = psutil.Process(json.loads(file.read_text())["pid"])
            for member in [*process.children(recursive=True), process]:
                member.kill()


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    with brought_up(tmp_path_factory.mktemp("operate")) as place:
        yield place


def processes(place: Place) -> list[psutil.Process]:
    found = []
    for name in ("prefect", "mlflow", "deployments"):
        process = psutil.Process(json.loads((place.folder / "logs" / f"{name}.pid").read_text())["pid"])
        found += [process, *process.children(recursive=True)]
    return found


def test_it_listens_on_this_machine_alone_and_up_twice_is_up_once(place: Place) -> None:
    before = {p.pid for p in processes(place)}
    listening = [c for p in processes(place) for c in p.net_connections() if c.status == psutil.CONN_LISTEN]
    assert {c.laddr.port for c in listening} >= set(place.ports)
    assert {c.laddr.ip for c in listening} == {"127.0.0.1"}
    status, output = place.up()
    assert status == 0
    assert place.prefect in output
    status, output = place._replace(host="0.0.0.0").up()
    assert (status, "`make down` before HOST=0.0.0.0" in output) == (1, True), "without a login"
    assert {p.pid for p in processes(place)} == before


def test_databases_are_for_their_owner_alone(place: Place) -> None:
    found = [*place.folder.glob("mlflow.db*"), *place.folder.glob(".prefect/prefect.db*")]
    assert {"mlflow.db", "prefect.db", "prefect.db-wal", "prefect.db-shm"} <= {path.name for path in found}
    written = [path for path in (*found, *place.folder.glob("logs/*.pid")) if path.suffix != ".lock"]
    assert {path.name: stat.filemode(path.stat().st_mode) for path in written} == {
        path.name: "-rw-------" for path in written
    }


FOREIGN = "evil.example"
"""A name that, for the browser of these tests, leads to this machine."""
PLAIN = {"Content-Type": "text/plain"}
PREFLIGHT = {"Access-Control-Request-Method": "POST", "Access-Control-Request-Headers": "content-type"}
SOCKET = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
          "Sec-WebSocket-Key": "c2ltZ2Fwc2ltZ2Fwc2ltZw=="}  # fmt: skip


def asked(address: str, method: str, path: str, headers: dict[str, str]) -> int:
    """The status of what a server answers."""
    connection = http.client.HTTPConnection(address.removeprefix("http://"), timeout=30)
    try:
        connection.request(method, path, b"{}" if method == "POST" else None, headers)
        return connection.getresponse().status
    finally:
        connection.close()


@pytest.mark.parametrize(
    ("server", "path"),
    [
        ("prefect", "/api/flows/filter"),
        ("mlflow", "/ajax-api/2.0/mlflow/experiments/search"),
        ("mlflow", "/graphql"),
    ],
)
def test_no_other_page_and_no_other_name_is_answered(place: Place, server: str, path: str) -> None:
    address: str = getattr(place, server)
    _, port = host = address.removeprefix("http://").split(":")
    for own in (address, f"http://localhost:{port}"):
        here = {"Host": own.removeprefix("http://"), "Origin": own}
        assert asked(address, "GET", "/", here) == 200
    for origin in (f"http://{FOREIGN}", f"http://{FOREIGN}:{port}", "null", f"http://{host[0]}:1", f"http://{host[0]}"):
        foreign = {"Origin": origin}
        found = [asked(address, "POST", path, foreign | PLAIN), asked(address, "OPTIONS", path, foreign | PREFLIGHT),
                 asked(address, "GET", "/api/events/out", foreign | SOCKET)]  # fmt: skip
        assert found == [403, 403, 403], origin
    for name in (FOREIGN, f"{FOREIGN}:{port}", f"10.{FOREIGN}:{port}", ""):  # MLflow's own patterns admit 10.*
        foreign = {"Host": name, "Origin": f"http://{name}"}
        found = [asked(address, "POST", path, foreign | PLAIN), asked(address, "OPTIONS", path, foreign | PREFLIGHT),
                 asked(address, "GET", "/", {"Host": name})]  # fmt: skip
        assert found == [400, 400, 400], name


ATTACK = """async ([api, command]) => {
  const statuses = [], headers = {"Content-Type": "application/json"};
  const call = async (path, body) => {
    try {
      const options = body ? {method: "POST", headers, body: JSON.stringify(body)} : {};
      const reply = await fetch(api + path, options);
      statuses.push(reply.status);
      return await reply.json();
    } catch { return {}; }
  };
  const token = await call("/csrf-token?client=attack");
  Object.assign(headers, {"Prefect-Csrf-Client": "attack", "Prefect-Csrf-Token": token.token || ""});
  const flow = await call("/flows/", {name: "sweep"});
  const step = {"prefect.deployments.steps.run_shell_script": {script: command}};
  const deployment = await call("/deployments/", 
    {name: "sweep-small", flow_id: flow.id, pull_steps: [step], enforce_parameter_schema: false});
  await call(`/deployments/${deployment.id}/create_flow_run`, {name: "attack", state: {type: "SCHEDULED"}});
  return statuses;
}"""
"""What a page would have the browser do, so that a command of its own is run here."""


@pytest.fixture
def elsewhere() -> Iterator[str]:
    """The address of an empty page of another server."""

    class Page(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Page) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://{FOREIGN}:{server.server_port}"
        server.shutdown()


def test_no_page_of_another_server_runs_a_command(place: Place, browser: Any, elsewhere: str) -> None:
    """From another address it asks the server's; by DNS rebinding it has the server's port under its own name."""
    port, page = place.ports[0], browser.context.browser.new_page()
    for origin, api in ((elsewhere, f"{place.prefect}/api"), (f"http://{FOREIGN}:{port}", "/api")):
        page.goto(origin)
        statuses = page.evaluate(ATTACK, [api, f"touch {place.folder / 'attacked'}"])
        assert all(400 <= status < 500 for status in statuses), (origin, statuses)
    page.close()
    assert place.api("deployments/name/sweep/sweep-small")["pull_steps"] == []
    assert place.api("flow_runs/filter", {"flow_runs": {"name": {"any_": ["attack"]}}}) == []
    assert not (place.folder / "attacked").exists()


def test_a_taken_port_is_named(place: Place, tmp_path: Path) -> None:
    status, output = Place(tmp_path, place.ports).up()
    assert status == 1
    assert f"prefect: port {place.ports[0]} is taken" in output
    assert "PREFECT_PORT=" in output
    assert "Traceback" not in output


def test_the_forms_are_typed_and_filled_in_from_params(place: Place) -> None:
    params = yaml.safe_load((place.folder / "params.yaml").read_text())
    found = place.api("deployments/filter", {})
    names = [f"{flow}-{size}" for flow in ("reproduce", "sweep", "track") for size in ("full", "small")]
    assert sorted(d["name"] for d in found) == ["diagnose-folder", *names]
    full = place.api("deployments/name/sweep/sweep-full")
    assert full["parameters"]["sample_sizes"] == params["train"]["sample_sizes"]
    assert full["parameters"]["hyperparameters"]["bnn"]["particles"] == [params["train"]["bnn"]["particles"]]
    small = place.api("deployments/name/sweep/sweep-small")
    assert small["parameters"]["hyperparameters"]["sim_model"]["training_steps"] == [50]
    properties = full["parameter_openapi_schema"]["properties"]
    assert "sim_fsvgd" in json.dumps(properties["models"])
    definitions = full["parameter_openapi_schema"]["definitions"]
    assert definitions["Recordings"]["properties"]["source"]["enum"] == list(params["recordings"])
    assert properties["sample_sizes"]["items"]["minimum"] == 20
    assert properties["sample_sizes"]["description"] == "N, transitions to learn from."
    rate = definitions["bnn"]["properties"]["learning_rate"]
    assert (rate["items"]["exclusiveMinimum"], rate["items"]["maximum"]) == (0, 1)


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"name": "a/b"}, "'a/b' does not match"),
        ({"name": "latest"}, "'latest' should not be valid under"),
        ({"recordings": {"source": "moon"}}, "'moon' is not one of ['virtual', 'spot']"),
        ({"sample_sizes": [3]}, "3 is less than the minimum of 20"),
        ({"models": ["gp"]}, "'gp' is not one of"),
        ({"hyperparameters": {"bnn": {"learning_rate": [7]}}}, "7 is greater than the maximum of 1"),
        ({"hyperparameters": {"bnn": {"learning_rat": [0.1]}}}, "'learning_rat' was unexpected"),
    ],
)
def test_a_wrong_value_in_the_form_is_refused_and_named(place: Place, parameters: dict[str, Any], words: str) -> None:
    with pytest.raises(urllib.error.HTTPError) as error:
        place.start("sweep/sweep-full", {"name": "wrong", **parameters})
    assert words in error.value.read().decode()


def start_long(place: Place, name: str) -> str:
    """A sweep that trains for hours, when it trains."""
    long = {"sim_model": {"training_steps": [10_000_000], "evaluate_every": [1000]}}
    status, output = place.run("prefect", "deployment", "run", "sweep/sweep-full", "--param", f"name={name}",
                               "--param", f"hyperparameters={json.dumps(long)}")  # fmt: skip
    assert status == 0, output
    flow_run = re.findall(r"[0-9a-f]{8}-[0-9a-f-]{27}", output)[0]
    training = {"name": {"like_": "sim_model-"}, "state": {"name": {"any_": ["Running"]}}}
    of_it = {"flow_runs": {"id": {"any_": [flow_run]}}, "task_runs": training}
    wait_for(lambda: place.api("task_runs/filter", of_it), 300)
    return flow_run


def test_cancelling_ends_the_work_and_leaves_nothing_running(place: Place) -> None:
    flow_run = start_long(place, "long")
    place.api(f"flow_runs/{flow_run}/set_state", {"state": {"type": "CANCELLING", "name": "Cancelling"}})
    place.until(flow_run, {"Cancelled"}, 60)
    workers = [p for p in processes(place) if any("prefect.engine" in part for part in p.cmdline())]
    assert not workers
    assert {run.info.status for run in place.runs("long")} == {"KILLED"}
    assert not list((place.folder / "sweeps" / "long").rglob("*.tmp"))


ASKED: list[str] = []
"""Every address that the pages asked for."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("no chromium is installed: apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=[
            "--no-sandbox", f"--host-resolver-rules=MAP {FOREIGN} 127.0.0.1",
        ])  # fmt: skip
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.set_default_timeout(60_000)
        page.on("request", lambda request: ASKED.append(request.url))
        yield page
        browser.close()


PICTURES = os.environ.get("SIMGAP_PICTURES")
"""Environment variable: the folder in which the docs keep pictures of the pages; a test draws them anew there."""


def picture(page: Any, name: str, folder: Path) -> None:
    page.screenshot(path=Path(PICTURES or folder) / f"{name}.png")


def field(browser: Any, words: str, kind: str = "textarea") -> Any:
    """The first field of a form after its description."""
    return browser.locator(f'xpath=//*[contains(text(), "{words}")]/following::{kind}[1]')


def test_the_form_offers_sources_and_refuses_a_bad_name(place: Place, browser: Any) -> None:
    browser.goto(f"{place.prefect}/deployments/deployment/{place.deployment('sweep/sweep-full')}/run")
    field(browser, "A block of params.yaml", "button").focus()
    browser.keyboard.press("ArrowDown")
    browser.get_by_role("option").first.wait_for()
    assert browser.get_by_role("option").all_inner_texts() == ["virtual", "spot"]
    browser.keyboard.press("Escape")
    before = place.api("flow_runs/count", {})
    browser.get_by_role("button", name="Submit").click()
    browser.get_by_text("'name' is a required property").wait_for()
    field(browser, NAMED).fill("a/b")
    browser.get_by_role("button", name="Submit").click()
    browser.get_by_text("'a/b' does not match").first.wait_for()
    assert place.api("flow_runs/count", {}) == before


NAMED = "The run's name, here and in MLflow"
"""How the form describes the name of a run."""


@pytest.fixture(scope="module")
def swept(place: Place, browser: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """A sweep over two seeds, started from Prefect's form, when it has ended: its flow run, and the pictures."""
    pictures = tmp_path_factory.mktemp("pictures")
    browser.goto(f"{place.prefect}/deployments/deployment/{place.deployment('sweep/sweep-full')}/run")
    within = "ancestor::div[contains(concat(' ', @class, ' '), ' schema-form-property ')][1]"
    seeds = f"xpath=//*[contains(text(),'Each draws other transitions')]/{within}"
    field(browser, NAMED).fill("from-the-form")
    browser.locator(f"{seeds}//button[contains(.,'Add item')]").click()
    second = browser.locator(f"{seeds}//input[@type='number']").nth(1)
    second.fill("1")
    second.scroll_into_view_if_needed()
    picture(browser, "prefect_form", pictures)
    browser.get_by_role("button", name="Submit").click()
    of_it = {"flow_runs": {"name": {"any_": ["from-the-form"]}}}  # named so when it starts
    (run,) = wait_for(lambda: place.api("flow_runs/filter", of_it), 120)
    assert run["parameters"]["seeds"] == [0, 1]
    state = place.until(run["id"], {"Completed", "Failed", "Crashed"}, 400)
    assert state["name"] == "Completed", (state, place.log())
    return run["id"], pictures


def wait_for(what: Any, seconds: float = 60) -> Any:
    deadline = time.monotonic() + seconds
    while not (found := what()):
        assert time.monotonic() < deadline
        time.sleep(0.2)
    return found


def test_prefect_shows_the_run_its_tasks_and_a_table_with_links(
    place: Place, browser: Any, swept: tuple[str, Path]
) -> None:
    flow_run, pictures = swept
    browser.goto(f"{place.prefect}/runs/flow-run/{flow_run}")
    browser.get_by_text("Completed").first.wait_for()
    browser.get_by_text("train on virtual: 2 of 2 done").first.wait_for()
    picture(browser, "prefect_run", pictures)
    names = {t["name"] for t in place.api("task_runs/filter", {"flow_runs": {"id": {"any_": [flow_run]}}})}
    assert {"sim_model-student_t-N40-s0", "score-sim_model-student_t-N40-s1", "register-from-the-form"} <= names
    browser.get_by_text("Artifacts", exact=True).click()
    browser.get_by_text("sweep-results").first.click()
    link = browser.get_by_role("link", name="MLflow").first
    link.wait_for()
    picture(browser, "prefect_results", pictures)
    assert link.get_attribute("href").startswith(place.mlflow)
    artifacts = place.api("artifacts/filter", {"artifacts": {"flow_run_id": {"any_": [flow_run]}}})
    progress = [a["data"] for a in artifacts if a["type"] == "progress"]
    assert progress == [100.0]


def test_mlflow_shows_the_runs_side_by_side(place: Place, browser: Any, swept: tuple[str, Path]) -> None:
    _, pictures = swept
    client, runs = place.client(), place.runs("from-the-form")
    cells = [run for run in runs if "mlflow.parentRunId" in run.data.tags]
    assert len({run.data.tags["config"] for run in cells}) == 2
    artifacts = place.api("artifacts/filter", {"artifacts": {"key": {"any_": ["sweep-links"]}}})
    (address,) = re.findall(r"\((http[^)]*viewStateShareKey=[^)]*)\)", artifacts[0]["data"])
    browser.goto(address)
    for name in ("sim_model-student_t-N40-s1", "nll", "training_seconds", "seed"):
        browser.get_by_text(name, exact=True).first.wait_for()
    browser.get_by_label("Close").last.click()  # an assistant that nobody called
    picture(browser, "mlflow_runs", pictures)
    for run in cells:
        row = browser.locator("[role=row]").filter(has_text=str(run.info.run_name))
        row.locator("input[type=checkbox]").first.check(force=True)
    browser.get_by_role("button", name="Compare", exact=True).wait_for()
    picture(browser, "mlflow_select", pictures)
    browser.get_by_role("button", name="Compare", exact=True).click()
    browser.get_by_text("Comparing 2 Runs").first.wait_for()
    browser.get_by_text("Parallel Coordinates Plot").first.wait_for()
    picture(browser, "mlflow_compare", pictures)

    every = client.search_runs([e.experiment_id for e in client.search_experiments()])
    named = r"(sweep|grid|policies|tracking)-.+|(sim_model|fsvgd|sim_fsvgd)(_diagnosed)?-.+-s\d+"
    assert [run.info.run_name for run in every if not re.fullmatch(named, str(run.info.run_name))] == []
    (parent,) = [run for run in runs if run not in cells]
    logged = {file.path for file in client.list_artifacts(parent.info.run_id)}
    assert {"results.csv", "results.json", "report"} <= logged
    assert "report/nll_against_n.png" in {file.path for file in client.list_artifacts(parent.info.run_id, "report")}


@pytest.mark.usefixtures("swept")
def test_the_best_model_loads_in_three_lines(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    client = place.client()
    version = client.get_model_version_by_alias("dynamics", "from-the-form")
    scores = {
        run.info.run_id: run.data.metrics["nll"] for run in place.runs("from-the-form") if "nll" in run.data.metrics
    }
    assert len(scores) == 2
    assert scores[str(version.run_id)] == min(scores.values())
    readme = (ROOT / "README.md").read_text()
    (lines,) = re.findall(r"```python\n(import mlflow\n.*?)```", readme, re.DOTALL)
    monkeypatch.chdir(place.folder)
    named: dict[str, Any] = {}
    exec(lines.replace("<sweep>", "from-the-form"), named)
    recordings = Workspace(place.folder / "sweeps" / "from-the-form", "virtual").recordings
    session = pd.read_parquet(min((recordings / "test").glob("*.parquet")))
    predicted = named["model"].predict(session)
    assert len(predicted) == len(session)
    assert np.isfinite(predicted[2:].to_numpy()).all()


def test_a_reproduction_is_started_and_shows_what_there_is(place: Place) -> None:
    """Of sessions that are there to learn from and to judge by: the diagnosis, which takes longest, refuses them, and
    so does the twin."""
    params, made = load_params(place.folder / "params.yaml"), Workspace(place.folder / "made", "virtual")
    source = params.source("virtual")
    assert isinstance(source, VirtualParams)
    recordings.record_virtual.fn(made, source)
    for folder in ("recordings_spot_v1", "test_data_spot"):
        shutil.copytree(made.recordings / "training", place.folder / "data" / "robot" / folder)
    form = {"name": "again", "recordings": {"source": "spot", "folder": "data/robot"}}
    flow_run = place.start("reproduce/reproduce-full", form)
    state = place.until(flow_run, {"Completed", "Failed", "Crashed"}, 400)
    assert state["name"] == "Failed", (state, place.log())
    assert "a session must serve one purpose" in state["message"]
    reports = Workspace(Path("sweeps", "again"), "spot").reports
    links, table = (place.api("artifacts/filter", {"artifacts": {"key": {"any_": [f"reproduce-{what}"]}}})[0]["data"]
                    for what in ("links", "results"))  # fmt: skip
    assert (place.folder / reports / "report.md").exists()
    assert str(reports / "report.md") in links
    assert "tracking" not in links  # the sessions are too short for a twin to run the policies on
    assert links.count("viewStateShareKey=again)") == 2
    (row,) = json.loads(table)
    assert row["model"] == "sim_model-student_t-N40-s0"
    assert row["run"].startswith(f"[MLflow]({place.mlflow}/#/experiments/")


def test_a_diagnosis_is_read_in_mlflow(place: Place, browser: Any, swept: tuple[str, Path]) -> None:
    """The page of the project's own report, logged as a diagnosis logs it."""
    page = ROOT / "reports" / "virtual" / "diagnosis" / "diagnosis.html"
    store = open_store(place.folder, "diagnosis", pages=place.mlflow)
    with diagnosis_run(store, "virtual-spot", {}) as run:
        run.artifact(page)
    path = f"experiments/{store.experiment_id}/runs/{run.run_id}/artifacts/{page.name}?workflowType=machine_learning"
    browser.goto(f"{place.mlflow}/#/{path}")
    shown = browser.frame_locator("iframe").get_by_text("Where is the mismatch?")
    shown.first.wait_for()
    browser.get_by_text("Path: file:").evaluate("line => line.style.visibility = 'hidden'")  # of this machine
    picture(browser, "mlflow_diagnosis", swept[1])


def test_a_diagnosis_is_started_and_compared_with_others_of_its_recordings(place: Place) -> None:
    record("drive", place.folder / "data" / "rail", sessions=3, seconds=20.0, seed=0)
    form = {"name": "rail", "recordings": "data/rail", "simulator": "examples.drive:DRIVE"}
    given = [part for name, value in form.items() for part in ("--param", f"{name}={value}")]
    status, output = place.run("prefect", "deployment", "run", "diagnose/diagnose-folder", *given)
    assert status == 0, output
    flow_run = re.findall(r"[0-9a-f]{8}-[0-9a-f-]{27}", output)[0]
    state = place.until(flow_run, {"Completed", "Failed", "Crashed"}, 400)
    assert state["name"] == "Completed", (state, place.log())
    found = json.loads((place.folder / "sweeps" / "rail" / "diagnosis.json").read_text())
    (links,) = place.api("artifacts/filter", {"artifacts": {"key": {"any_": ["diagnosis-links"]}}})
    assert found["statement"] in links["data"]
    assert "sweeps/rail/diagnosis.html" in links["data"]
    assert f"{place.mlflow}/#/experiments/" in links["data"]
    assert "viewStateShareKey=rail" in links["data"]
    client = place.client()
    experiment = client.get_experiment_by_name("diagnosis")
    assert experiment is not None
    (run,) = client.search_runs([experiment.experiment_id], "params.recordings = 'data/rail'")
    assert run.data.tags["verdict"] == found["verdict"]
    assert re.fullmatch("[0-9a-f]{16}", run.data.tags["config"])


@pytest.mark.usefixtures("swept")
def test_no_page_asks_anything_of_another_machine() -> None:
    assert len(ASKED) > 50
    elsewhere = {url for url in ASKED if not re.match(r"(http|ws)://127\.0\.0\.1:|data:|blob:", url)}
    assert not elsewhere


def test_down_stops_all_of_it_and_nothing_else(place: Place) -> None:
    """The last test of this place: nothing is up after it; a run under way is cancelled and told of, not left to be
    killed."""
    start_long(place, "under-way")
    before, mine = processes(place), psutil.Process(os.getpid())
    status, output = place.run("python", "-m", "flows.servers", "down")
    assert (status, output.count("stopped")) == (0, 3), output
    assert not [p for p in before if p.is_running() and p.status() != psutil.STATUS_ZOMBIE]
    assert mine.is_running()
    assert "Flow run 'under-way' - Flow run was cancelled." in place.log()
    assert {run.info.status for run in place.runs("under-way")} == {"KILLED"}
    assert not list((place.folder / "logs").glob("*.pid"))
    assert place.run("python", "-m", "flows.servers", "down") == (0, "")


@pytest.mark.long
def test_on_other_addresses_a_login_is_asked_for(browser: Any, tmp_path: Path) -> None:
    with brought_up(tmp_path, "0.0.0.0") as place:
        assert place.login is not None
        addresses = {a.address for found in psutil.net_if_addrs().values() for a in found if a.family == socket.AF_INET}
        others = addresses - {"127.0.0.1"}
        for address in (place.prefect, *(f"http://{other}:{place.ports[0]}" for other in others)):
            assert asked(address, "POST", "/api/flows/filter", PLAIN) in (401, 403)
            assert asked(address, "GET", "/api/csrf-token?client=test", {}) == 401
            assert asked(address, "GET", "/api/flows/count", {"Host": FOREIGN}) == 400
        assert asked(place.mlflow, "GET", "/", {}) == 401
        assert asked(place.mlflow, "GET", "/", {"Authorization": "Basic c2ltZ2FwOmd1ZXNz"}) == 401
        assert MlflowClient(place.mlflow.replace("//", f"//{place.login}@")).search_experiments()
        status, output = place.up()
        assert (status, place.login in output) == (0, False), "it is shown once"
        shown = [path for path in (tmp_path / "logs").iterdir() if place.login in path.read_text()]
        assert {path.suffix for path in shown} == {".pid"}
        assert {path.stat().st_mode & 0o777 for path in shown} == {0o600}

        given = ("--param", "name=none", "--param", "recordings=data/none")
        status, output = place.run("prefect", "deployment", "run", "diagnose/diagnose-folder", *given)
        assert status == 0, output
        flow_run = re.findall(r"[0-9a-f]{8}-[0-9a-f-]{27}", output)[0]
        state = place.until(flow_run, {"Completed", "Failed", "Crashed"}, 200)
        assert "data/none" in state["message"], "the worker has the login too"

        user, password = place.login.split(":")
        page = browser.context.browser.new_page(http_credentials={"username": user, "password": password})
        page.goto(place.mlflow)
        page.get_by_text("Experiments").first.wait_for()
        page.goto(f"{place.prefect}/deployments")
        page.locator("input[type=password]").fill(place.login)
        page.get_by_role("button", name="Login").click()
        page.get_by_text("diagnose").first.wait_for()
        page.close()
        assert place.run("python", "-m", "flows.servers", "down")[0] == 0
        assert place.login is None, "it is of no use any more"
