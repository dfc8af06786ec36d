"""Prefect's server, MLflow's pages and the served deployments, brought up and taken down: `make up`, `make down`.

What is brought up leaves a file `logs/<name>.pid` each, by which alone it is found again; what each says is in
`logs/<name>.log`.
"""

import argparse
import fcntl
import ipaddress
import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import psutil

from flows import guard, running
from flows.errors import guarded
from flows.running import LOGS, pid_file
from simgap.cli import progress
from simgap.formats.documents import write_bytes
from simgap.formats.folders import keep_private, make_folder
from simgap.types import SimgapError
from tasks.server import NONE

DATABASE = Path("mlflow.db")
_HEALTHY_S, _STOP_S, _POLL_S = 240.0, 20.0, 0.2
_TAIL_LINES = 15
_HERE = "127.0.0.1"
_NAMES = ("prefect", "mlflow", "deployments")
_NOT_INHERITED = (*NONE, "PREFECT_API_AUTH_STRING", "PREFECT_SERVER_API_AUTH_STRING")
"""Variables of this command's environment that name another server, or none."""


class Server(NamedTuple):
    """One process to keep running: what starts it, what it answers on, and whether it is well."""

    name: str
    command: list[str]
    environment: dict[str, str]
    address: str
    healthy: Callable[[], bool]
    port: int | None = None


def main() -> None:
    """`up` or `down`; idempotent, status 1 with an explained error."""
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    start = commands.add_parser("up")
    start.add_argument("--host", default=_HERE, help="address to listen on; any but this machine's own needs a login")
    start.add_argument("--prefect-port", type=int, default=4200)
    start.add_argument("--mlflow-port", type=int, default=5000)
    start.add_argument("--runs", type=int, default=2, help="runs of deployments at a time; others wait")
    commands.add_parser("down")
    given = parser.parse_args()
    if given.command == "down":
        guarded(down)
    else:
        guarded(lambda: up(given.host, given.prefect_port, given.mlflow_port, given.runs))


def up(host: str, prefect_port: int, mlflow_port: int, runs: int) -> None:
    """Start what is not running, wait until all of it is well, and say where it is."""
    make_folder(LOGS)
    known = next((there for name in _NAMES if (there := running.find(name))), None)
    if known and not known.login and not _loopback(host):
        raise SimgapError(f"The servers run without a login, on this machine alone. `make down` before HOST={host}.")
    login = known.login if known else None if _loopback(host) else running.new_login()
    servers = _servers(host, prefect_port, mlflow_port, runs, login)
    keep_private(Path(servers[0].environment["PREFECT_HOME"]) / running.DATABASE)
    with Path("mlflow.db.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # MLflow's migrations die when two run them at once
        if not DATABASE.exists():
            from tasks.tracking.store import make_database  # seconds of imports, for the first time alone

            make_database(DATABASE.absolute(), Path("mlruns").absolute())
        keep_private(DATABASE)
        for server in servers:
            _start(server, login)
    width = max(len(server.name) for server in servers)
    for server in servers:
        progress.say(f"{server.name:{width}}  {server.address}   ({LOGS / server.name}.log)")
    if login and not known:
        progress.say(
            f"Both ask for the login {login} (shown only now; {pid_file('prefect')} keeps it, for you alone). "
            "Nothing is encrypted: use a network that you trust."
        )
    progress.say("`make down` stops them.")


def down() -> None:
    """Stop what `up` started, deployments first so that their runs can tell the server how they ended."""
    for names in (("deployments",), ("mlflow", "prefect")):
        there = {name: server.process for name in names if (server := running.find(name))}
        _stop(list(there.values()))
        for name in names:
            pid_file(name).unlink(missing_ok=True)
        for name in there:
            progress.say(f"{name}: stopped")


def _servers(host: str, prefect_port: int, mlflow_port: int, runs: int, login: str | None) -> list[Server]:
    """In the order in which they need each other."""
    here, names = _HERE if host == "0.0.0.0" else host, _names(host)
    pages, tracking = f"http://{here}:{prefect_port}", f"http://{here}:{mlflow_port}"
    prefect = {
        "PREFECT_HOME": os.environ.get("PREFECT_HOME", os.path.abspath(".prefect")),
        **running.client(pages, login),
        "PREFECT_SERVER_API_HOST": host,
        "PREFECT_SERVER_API_PORT": str(prefect_port),
        "PREFECT_SERVER_UI_API_URL": "/api",  # under whichever of its names the page was opened
        "PREFECT_SERVER_CSRF_PROTECTION_ENABLED": "true",
        "PREFECT_LOGGING_LEVEL": "INFO",
        guard.HOSTS: ",".join(names),
        **({"PREFECT_SERVER_API_AUTH_STRING": login} if login else {}),
    }
    mlflow = {
        "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false",  # seven processes, for evaluations of language models
        "MLFLOW_SERVER_ALLOWED_HOSTS": ",".join(f"{name}:*" for name in names),
        "MLFLOW_SERVER_CORS_ALLOWED_ORIGINS": ",".join(f"http://{name}:*" for name in names),
        guard.HOSTS: ",".join(names),
        guard.STORE: f"sqlite:///{DATABASE.absolute()}",
        guard.ARTIFACTS: str(Path("mlruns").absolute()),
        **({guard.LOGIN: login} if login else {}),
    }
    serve = [sys.executable, "-m", "flows.serve", "--runs", str(runs)]
    uvicorn = [sys.executable, "-m", "uvicorn", "--factory", "--host", host, "--log-level", "warning"]
    api = [*uvicorn, "--port", str(prefect_port), "flows.guard:prefect"]
    ui = [*uvicorn, "--port", str(mlflow_port), "flows.guard:mlflow"]
    return [
        Server("prefect", api, prefect, pages, lambda: _answers(f"{pages}/api/health"), prefect_port),
        Server("mlflow", ui, mlflow, tracking, lambda: _answers(f"{tracking}/health"), mlflow_port),
        Server("deployments", serve, prefect, f"{pages}/deployments",
               lambda: (LOGS / "deployments.ready").exists()),
    ]  # fmt: skip


def _loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _names(host: str) -> list[str]:
    """By what a server that listens on `host` is reached: this machine's names and addresses, and those in HOSTS."""
    names = ["localhost", _HERE, host, *filter(None, os.environ.get(guard.HOSTS, "").split(","))]
    if not _loopback(host):
        addresses = [a.address for found in psutil.net_if_addrs().values() for a in found if a.family == socket.AF_INET]
        names += [socket.gethostname(), socket.getfqdn(), *addresses]
    return list(dict.fromkeys(names))


def _start(server: Server, login: str | None) -> None:
    if running.find(server.name):
        if not server.healthy():
            raise SimgapError(
                f"{server.name} runs and does not answer on {server.address}: it is on another port than is asked for "
                f"now, or it hangs. See {LOGS / server.name}.log; `make down` stops it."
            )
        return
    if server.port and not _free(server.address, server.port):
        raise SimgapError(
            f"{server.name}: port {server.port} is taken by another program. Give another one, like "
            f"`make up {server.name.upper()}_PORT={server.port + 1}`, or end that program."
        )
    (LOGS / f"{server.name}.ready").unlink(missing_ok=True)
    inherited = {name: value for name, value in os.environ.items() if name not in _NOT_INHERITED}
    with (LOGS / f"{server.name}.log").open("ab") as log:
        process = psutil.Popen(
            server.command, env={**inherited, **server.environment}, stdin=subprocess.DEVNULL, stdout=log,
            stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
    known = {"pid": process.pid, "created": process.create_time(), "address": server.address, "login": login}
    write_bytes(pid_file(server.name), json.dumps(known).encode(), private=True)
    deadline = time.monotonic() + _HEALTHY_S
    while not server.healthy():
        if process.poll() is not None or time.monotonic() > deadline:
            raise SimgapError(_why(server, process.poll()))
        time.sleep(_POLL_S)


def _why(server: Server, status: int | None) -> str:
    log = LOGS / f"{server.name}.log"
    tail = "\n".join(log.read_text(errors="replace").splitlines()[-_TAIL_LINES:])
    said = f"did not answer within {_HEALTHY_S:.0f} s" if status is None else f"ended with status {status}"
    return f"{server.name} {said}; the end of {log}:\n{tail}"


def _answers(url: str) -> bool:
    try:
        with urllib.request.urlopen(url, timeout=2) as reply:
            return reply.status == 200
    except (OSError, urllib.error.URLError):
        return False


def _free(address: str, port: int) -> bool:
    with socket.socket() as probe:
        probe.settimeout(1)
        return probe.connect_ex((address.removeprefix("http://").rsplit(":", 1)[0], port)) != 0


def _stop(processes: Sequence[psutil.Process]) -> None:
    """Ask them and their children to end, and make those that do not."""
    family = [member for process in processes for member in (process, *process.children(recursive=True))]
    for process in processes:
        process.send_signal(signal.SIGTERM)
    _, left = psutil.wait_procs(family, timeout=_STOP_S)
    for member in left:
        member.terminate()
    _, left = psutil.wait_procs(left, timeout=3)
    for member in left:
        member.kill()
    psutil.wait_procs(left, timeout=3)


if __name__ == "__main__":
    main()
