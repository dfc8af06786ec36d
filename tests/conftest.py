"""Every test runs with the project's environment and compiled code, and with a Prefect home of its own."""

import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

os.environ["PREFECT_LOGGING_TO_API_WHEN_MISSING_FLOW"] = "ignore"  # tasks are called without a flow here
os.environ["PREFECT_HOME"] = tempfile.mkdtemp(prefix="simgap-prefect-")
os.environ.pop("MLFLOW_TRACKING_URI", None)
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parents[1] / ".jax"))
# There are more workers than cores: with XLA's threads for a second core, a search costs a tenth more processor time.
os.environ.setdefault("PJRT_NPROC", "1")

import flows.flow  # noqa: F401  # settles the environment before any library reads it
from tasks.server import NONE

settings.register_profile("simgap", deadline=None)  # how long an example takes depends on what else runs
settings.load_profile("simgap")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files of flows, which start processes and wait for them, are spread over the first three quarters of the others.

    At once they would leave cores idle, and compile the same programs several times.
    """
    files: dict[Path, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(item.path, []).append(item)
    waiting = [path for path in files if path.parent.name == "flows"]
    order = [path for path in files if path.parent.name != "flows"]
    apart = 3 * len(order) // (4 * len(waiting) or 1)
    for k, path in enumerate(waiting):
        order.insert(k * (apart + 1), path)
    items[:] = [item for path in order for item in files[path]]


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def until_it_answers(server: subprocess.Popen[bytes], address: str) -> None:
    """Wait until a server that was started answers there."""
    for _ in range(1200):
        try:
            with urllib.request.urlopen(address, timeout=1):
                break
        except OSError:
            assert server.poll() is None
            time.sleep(0.1)


@pytest.fixture(scope="module")
def prefect_server() -> Iterator[dict[str, str]]:
    """A Prefect server; gives the environment in which the commands of tests use it.

    A command without it tells nobody of its flows and tasks.
    """
    port = free_port()
    inherited = {name: value for name, value in os.environ.items() if name not in NONE}
    environment = {**inherited, "PREFECT_SERVER_API_PORT": str(port)}
    # Without its services (schedulers and the like), which no test needs and which take a minute of a core.
    start = [Path(sys.executable).parent / "prefect", "server", "start", "--no-services"]
    command = [*start, "--host", "127.0.0.1", "--port", str(port)]
    server = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    address = f"http://127.0.0.1:{port}/api"
    try:
        until_it_answers(server, f"{address}/health")
        # With logs, a process would wait at its end for a server that is gone.
        yield {**inherited, "PREFECT_API_URL": address, "PREFECT_LOGGING_TO_API_ENABLED": "false"}
    finally:
        server.terminate()
        server.wait(timeout=30)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium, where it is installed."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("no chromium is installed: apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(autouse=True, scope="module")
def _room_for_compiled_code() -> Iterator[None]:
    """No worker holds what all of its modules compiled."""
    yield
    if "jax" in sys.modules:  # most of what takes no time does not compute
        from simgap import compiled

        compiled.forget_if_many()


@pytest.fixture(autouse=True)
def _own_store() -> Iterator[None]:
    """No test looks for runs where another one did: `mlflow.set_tracking_uri` stays, here and in the environment."""
    yield
    if "mlflow" in sys.modules:  # importing it for all tests takes seconds
        sys.modules["mlflow"].set_tracking_uri(None)
    os.environ.pop("MLFLOW_TRACKING_URI", None)
