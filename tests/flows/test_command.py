"""The commands as a person's mistakes meet them, each in a process of its own: quick, clear, never silent."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

ROOT = Path(__file__).parents[2]
SIMGAP = str(Path(sys.executable).parent / "simgap")
HEAVY = {"jax", "numpy", "pyarrow", "prefect", "mlflow", "pydantic", "matplotlib"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A person's folder, with a session, a mapping and simulators that misbehave."""
    folder = tmp_path_factory.mktemp("person")
    (folder / "rail").mkdir()
    (folder / "rail" / "day.csv").write_text("time_s\n0\n")
    (folder / "empty").mkdir()
    (folder / "mapping.yaml").write_text("")
    (folder / "exits.py").write_text("import os\nos._exit(0)\n")
    (folder / "raises.py").write_text(
        "class Mine:\n    parameters, time_step, step = (), 0.1, None\n"
        "    @property\n    def schema(self):\n        raise RuntimeError('not today')\n"
    )
    (folder / "endless.py").write_text(
        "import jax, jax.numpy as jnp\nfrom simgap.simulators.spot import Spot\n\n"
        "class Mine(Spot):\n    def step(self, params, state, command):\n"
        "        return state + jax.lax.while_loop(lambda x: x < 2.0, jnp.sin, state[0])\n"
    )
    return folder


MISTAKES: list[tuple[list[str], int, str]] = [
    ([SIMGAP, "--hlep"], 2, "usage: simgap"),
    ([SIMGAP, "check", "nowhere"], 1, "nowhere: there is no such folder"),
    ([SIMGAP, "check", "empty"], 1, "empty: no file matches"),
    (
        [SIMGAP, "check", "rail", "--simulator", "sport"],
        1,
        "The simulator must be spot, a model file (.xml, .mjcf, .urdf), or given as package.module:name",
    ),
    ([SIMGAP, "check", "rail", "--simulator", "no.such:X"], 1, "no.such:X: there is no module no."),
    ([SIMGAP, "check", "rail", "--simulatr", "spot"], 2, "unrecognized arguments: --simulatr"),
    ([SIMGAP, "diagnose", "nowhere"], 1, "nowhere: there is no such folder"),
    ([SIMGAP, "diagnose", "rail", "--heldout", "nowhere"], 1, "nowhere: there is no such folder"),
    ([SIMGAP, "diagnose", "rail", "--baseline", "empty"], 1, "empty: no file matches"),
    ([SIMGAP, "diagnose", "rail", "--simulator", "nosuch:X"], 1, "nosuch:X: there is no module nosuch."),
    ([SIMGAP, "diagnose", "rail", "--ot", "x"], 2, "unrecognized arguments: --ot"),
    ([SIMGAP, "import", "nowhere", "--mapping", "mapping.yaml", "--out", "o"], 1, "nowhere: there is no such bag"),
    ([SIMGAP, "import", "empty", "--mapping", "mapping.yaml", "--out", "o"], 1, "empty: holds no MCAP file"),
    ([SIMGAP, "import", "rail", "--mapping", "mapping.yml", "--out", "o"], 1, "mapping.yml: there is no such file"),
    ([sys.executable, "-m", "flows.sweep"], 1, "params.yaml: there is no such file here"),
    ([sys.executable, "-m", "flows.sweep", "--sample-sizes", "many"], 2, "invalid int value: 'many'"),
    ([sys.executable, "-m", "flows.sweep", "--name", "a/b"], 1, "the run's name is 'a/b'"),
    ([sys.executable, "-m", "flows.sweep", "--name", "latest"], 1, "'latest', an alias that MLflow uses itself"),
    *(
        ([sys.executable, "-m", f"flows.{stage}", *arguments], status, words)
        for stage in ("recordings", "transitions", "train", "score", "report", "policy", "track", "diagnose")
        for arguments, status, words in (
            (["virtual"], 1, "params.yaml: there is no such file here"),
            (["virtual", "--overide", "x"], 2, "unrecognized arguments: --overide"),
        )
    ),
    ([sys.executable, "-m", "flows.reproduce", "--workspace", "w"], 1, "params.yaml: there is no such file here"),
    ([sys.executable, "-m", "flows.sealed.conceal", "developmnet"], 2, "invalid choice: 'developmnet'"),
    (
        [sys.executable, "-m", "flows.sealed.score", "development"],
        1,
        "pipelines/sealed/params.yaml: there is no such file here",
    ),
]


@pytest.mark.parametrize(("command", "status", "words"), MISTAKES)
def test_a_mistake_is_reported_before_anything_heavy_is_imported(
    folder: Path, command: list[str], status: int, words: str
) -> None:
    assert not HEAVY & imported_by(folder, command, status, words)
    assert not (folder / "o").exists()


def imported_by(folder: Path, command: list[str], status: int, words: str) -> set[str]:
    """What a command imports that ends with this status and these words, and without a traceback."""
    python = [sys.executable, "-X", "importtime", *(command if command[0] == SIMGAP else command[1:])]
    done = subprocess.run(
        python, cwd=folder, capture_output=True, text=True, timeout=200, env={"PYTHONPATH": str(ROOT)}
    )
    assert done.returncode == status
    assert words in done.stdout + done.stderr
    assert "Traceback" not in done.stdout + done.stderr
    imported = set(re.findall(r"^import time:.*\| +([\w.]+)$", done.stderr, re.MULTILINE))
    assert "simgap.types" in imported
    return imported


NO_SOURCE = "params.yaml has no block recordings.nosource; there are virtual, spot. Add one"
FLOW = {"prefect", "mlflow"}
"""What a flow imports."""


@pytest.mark.parametrize(
    ("arguments", "words", "unneeded"),
    [
        (["train", "nosource"], NO_SOURCE, HEAVY),
        (["reproduce", "nosource", "--workspace", "w"], NO_SOURCE, HEAVY),
        (["sweep", "nosource"], NO_SOURCE, HEAVY),
        (["sweep", "--models", "gp"], "models.0: Input should be 'sim_model'", FLOW),
        (
            ["sweep", "--sample-sizes", "3"],
            "sample_sizes.0: Input should be greater than or equal to 20",
            FLOW,
        ),
        (["sweep", "--seeds", "-1"], "seeds.0: Input should be greater than or equal to 0", FLOW),
    ],
)
def test_a_wrong_choice_in_a_project_is_reported_before_its_flow_is_imported(
    tmp_path: Path, arguments: list[str], words: str, unneeded: set[str]
) -> None:
    (tmp_path / "params.yaml").write_text((ROOT / "params.yaml").read_text())
    command = [sys.executable, "-m", f"flows.{arguments[0]}", *arguments[1:]]
    assert not unneeded & imported_by(tmp_path, command, 1, words)
    assert [path.name for path in tmp_path.iterdir()] == ["params.yaml"]


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("os:abort", "os:abort: a simulator must have schema, parameters, time_step, step"),
        ("os:_exit", "os:_exit: a simulator must have schema, parameters, time_step, step"),
        ("exits:X", "exits:X: importing its module must not end the process; it did (status 0)"),
        ("raises:Mine", "raises:Mine: schema must be there to be read; reading it gave RuntimeError: not today"),
    ],
)
def test_code_that_is_no_simulator_ends_in_a_message(folder: Path, spec: str, words: str) -> None:
    command = [SIMGAP, "check", "rail", "--simulator", spec]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=200)
    assert done.returncode == 1
    assert f"error: {words}" in done.stdout
    assert "Traceback" not in done.stdout + done.stderr


GUARDED = "import flows\nfrom flows.errors import guarded\n"
ENDLESS = (
    GUARDED
    + """
def work():
    import jax, jax.numpy as jnp
    endless = jax.jit(lambda: jax.lax.while_loop(lambda x: x < 2.0, jnp.sin, 1.0)).lower().compile()
    print("ready", flush=True)
    endless().block_until_ready()

guarded(work)
"""
)


def started(command: list[str], folder: Path) -> subprocess.Popen[str]:
    """As from a terminal: what a shell starts in the background, such as this test, ignores Ctrl-C."""
    return subprocess.Popen(
        command, cwd=folder, stdout=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip


def test_ctrl_c_ends_the_trial_of_an_endless_step(folder: Path) -> None:
    with started([SIMGAP, "check", "rail", "--simulator", "endless:Mine"], folder) as process:
        _until(process, lambda: b"simgap.loading.trial" in _children(process))
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=60)
    assert (process.returncode, said) == (130, "stopped\n")
    assert not _children(process)


def _until(process: subprocess.Popen[str], happened: Callable[[], bool]) -> None:
    while not happened():
        assert process.poll() is None
        time.sleep(0.1)


def _children(process: subprocess.Popen[str]) -> bytes:
    """Their command lines."""
    try:
        numbers = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        return b"".join(Path(f"/proc/{number}/cmdline").read_bytes() for number in numbers)
    except FileNotFoundError:
        return b""


def test_ctrl_c_twice_ends_endless_compiled_code() -> None:
    """Python does not hear of the first one."""
    with started([sys.executable, "-c", ENDLESS], ROOT) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        used = lambda: psutil.Process(process.pid).cpu_times().user  # noqa: E731
        before = used()
        _until(process, lambda: used() > before + 1)  # it is in the loop
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == "Still stopping. Ctrl-C again ends it at once.\n"
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=60)
    assert (process.returncode, said) == (130, "stopped\n")


UNEXPECTED = (
    GUARDED
    + """
import sys

def work():
    if sys.argv[1] == "exit":
        sys.exit(0)
    import numpy as np
    if sys.argv[1] == "plain":
        np.linalg.cholesky(-np.eye(2))
    from flows.flow import flow
    flow("any")(lambda: np.linalg.cholesky(-np.eye(2)))()

guarded(work)
"""
)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("plain", "LinAlgError: Matrix is not positive definite"),
        ("flow", "LinAlgError: Matrix is not positive definite"),
        ("exit", "SystemExit: 0"),
    ],
)
def test_an_unexpected_error_ends_in_a_message_and_its_traceback_in_a_file(
    tmp_path: Path, how: str, words: str
) -> None:
    (tmp_path / "work.py").write_text(UNEXPECTED)
    done = subprocess.run(
        [sys.executable, "work.py", how], cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, timeout=200,
    )  # fmt: skip
    assert done.returncode == 1
    assert f"error: `work.py {how}` ended with an unexpected error, {words}" in done.stdout
    assert "Traceback" not in done.stdout + done.stderr
    (kept,) = (tmp_path / "logs").iterdir()
    assert f"The whole traceback is in logs/{kept.name}: please report" in done.stdout
    assert f"work.py {how}\n\nTraceback (most recent call last)" in kept.read_text()
    assert words in kept.read_text()


def test_a_traceback_is_never_lost(tmp_path: Path) -> None:
    """Where the folder cannot be written to, it is kept in the temporary one."""
    (tmp_path / "work.py").write_text(UNEXPECTED)
    (tmp_path / "logs").write_text("a file")
    (tmp_path / "temporary").mkdir()
    done = subprocess.run(
        [sys.executable, "work.py", "plain"], cwd=tmp_path, capture_output=True, text=True, timeout=200,
        env={"PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path / "temporary")},
    )  # fmt: skip
    (kept,) = (tmp_path / "temporary").glob("error-*.txt")
    assert str(kept) in done.stdout
    assert "LinAlgError" in kept.read_text()
