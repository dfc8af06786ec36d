"""A machine that nothing commands, a pendulum let go: from its tables to a statement, with the installed commands."""

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import simgap
from simgap.diagnosis.diagnose import diagnose
from simgap.formats.documents import read_json
from simgap.loading.load import find, make
from simgap.recordings import split
from simgap.types import Recording, Sessions
from tasks.augmented_pyfunc import _load_pyfunc

pytestmark = pytest.mark.long

SIMULATOR = """
import jax.numpy as jnp
from simgap.types import Field, Parameter, Schema


class Free:
    time_step = 0.02
    schema = Schema(
        state=(
            Field("angle", "rad", "angle", "world", "arm", "yaw"),
            Field("rate", "rad/s", "velocity", "world", "arm", "yaw"),
        ),
        command=(),
    )
    parameters = (
        Parameter("stiffness", "1/s^2", 5.0, 20.0, nominal=9.81),
        Parameter("damping", "1/s", 0.0, 1.0, nominal=0.1),
    )

    def step(self, params, state, command):
        stiffness, damping = params
        angle, rate = state
        for _ in range(10):
            after = rate - self.time_step / 10 * (stiffness * jnp.sin(angle) + damping * rate)
            angle, rate = angle + self.time_step / 20 * (rate + after), after
        return jnp.stack([angle, rate])


FREE = Free()
"""
ROWS, SESSIONS, STEP = 300, 6, 0.02
FRICTION = 0.6  # [rad/s^2]


def recorded(friction: float) -> list[Recording]:
    """The pendulum let go from rest, with noise; `friction` [rad/s^2] stops it and never reverses it."""
    sessions = []
    for i, rng in enumerate(np.random.default_rng(0).spawn(SESSIONS)):
        angle, rate, fine = rng.uniform(0.8, 2.0) * rng.choice([-1, 1]), 0.0, STEP / 10
        states = np.empty((ROWS, 2))
        for row in range(ROWS):
            states[row] = angle, rate
            for _ in range(10):
                free = rate - fine * (9.81 * math.sin(angle) + 0.1 * rate)
                after = math.copysign(max(abs(free) - fine * friction, 0.0), free)
                angle, rate = angle + fine * (rate + after) / 2, after
        states += rng.normal(0, (0.005, 0.03), states.shape)
        sessions.append(Recording(f"s{i}", np.arange(ROWS) * STEP, states, np.empty((ROWS, 0))))
    return sessions


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tables with clocks of their own, how they map, and the simulator, in a file with the name of a library."""
    folder = tmp_path_factory.mktemp("person")
    (folder / "pendulum.py").write_text(SIMULATOR)
    (folder / "logs_of_mine").mkdir()
    for r in recorded(FRICTION):
        table = pd.DataFrame({"stamp": r.time_s, "q": r.state[:, 0], "w": r.state[:, 1]})
        table.to_csv(folder / "logs_of_mine" / f"{r.name}.csv", index=False)
    (folder / "mapping.yaml").write_text(
        "rate_hz: 50\nlongest_gap_s: 0.1\ntime: {column: stamp}\ncolumns: {angle: {column: q}, rate: {column: w}}\n"
    )
    return folder


@pytest.fixture(scope="module")
def statement(folder: Path) -> dict[str, Any]:
    """What comes of importing, checking and diagnosing them."""
    named = ["--simulator", "pendulum:FREE"]
    for arguments in (
        ["import", "logs_of_mine", "--mapping", "mapping.yaml", "--out", "mine", *named],
        ["check", "mine", "--out", "found", *named],
        ["diagnose", "mine", "--out", "found", *named],
    ):
        done = subprocess.run(
            [Path(sys.executable).parent / "simgap", *arguments], cwd=folder, capture_output=True,
            text=True, timeout=1200,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
    return read_json(folder / "found" / "diagnosis.json")


def test_its_friction_is_named(statement: dict[str, Any]) -> None:
    assert statement["verdict"] == "missing_physics"
    (found,) = [e for e in statement["effects"] if e["id"] == "coulomb_friction"]
    (loss,) = found["constants"]
    # What the law takes of the rate in a row.
    assert loss["value"] == pytest.approx(FRICTION * STEP, rel=0.1)
    assert loss["ci95"][0] < FRICTION * STEP < loss["ci95"][1]


def test_nothing_is_said_of_commands(folder: Path, statement: dict[str, Any]) -> None:
    assert statement["experiment"] is None
    assert not (folder / "found" / "experiment.csv").exists()
    assert "The machine takes no commands, so no experiment can be proposed." in statement["notes"]
    page = (folder / "found" / "diagnosis.html").read_text()
    assert "no experiment can be proposed" in page.lower()
    assert "no further experiment is needed" not in page.lower()
    assert "The machine takes no commands." in (folder / "found" / "check.html").read_text()
    assert all(not e["channels"] for e in statement["effects"])


@pytest.mark.usefixtures("statement")
def test_its_corrected_simulator_is_loaded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By itself, and as MLflow loads it, over a table."""
    monkeypatch.setattr(sys, "path", [*sys.path, str(folder)])
    monkeypatch.delitem(sys.modules, "own_pendulum", raising=False)
    simulator = simgap.load(folder / "found")
    rows = [{"angle": 1.0, "rate": 2.0}, {"angle": 1.0, "rate": 0.0}]
    got = _load_pyfunc(str(folder / "found" / "augmented.npz"), {"simulator": "pendulum:FREE"}).predict(
        pd.DataFrame(rows).assign(time_s=[0.0, 0.1])
    )
    assert list(got.columns) == ["next_angle", "next_rate"]
    expected = [
        simulator.step(simgap.nominal(simulator), np.array(list(row.values()), np.float32), np.empty(0, np.float32))
        for row in rows
    ]
    np.testing.assert_allclose(got.to_numpy(), expected, rtol=1e-5)
    assert np.isfinite(got.to_numpy()).all()


def test_nothing_is_named_where_nothing_is_missing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [*sys.path, str(folder)])
    monkeypatch.delitem(sys.modules, "own_pendulum", raising=False)
    simulator = make(find("pendulum:FREE"), "pendulum:FREE")
    training, heldout = split(recorded(0.0))
    found = diagnose(simulator, "free", Sessions(training, heldout))
    assert found.experiment is None
    assert found.statement["effects"] == found.statement["closest_matches"] == []
    assert found.statement["verdict"] not in ("missing_physics", "unexplained")
