"""The commands of docs/how_to/mujoco.md, for a model whose servos are also far too stiff, and all that they leave."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import simgap
from examples.arm import JOINTS, MODEL
from simgap.simulators.mujoco import MujocoEngine, load

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "how_to" / "mujoco.md").read_text()
FACTOR = 20
"""By how much the servos of the model are stiffer than those of the arm."""
KP = {"pan": 60, "shoulder": 80, "elbow": 40}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A person's folder after the first two commands of the page; fewer and shorter sessions."""
    folder = tmp_path_factory.mktemp("person")
    (folder / "examples").mkdir()
    stiff = re.sub(r'kp="(\d+)"', lambda kp: f'kp="{FACTOR * int(kp[1])}"', MODEL.read_text())
    (folder / "examples" / "arm.xml").write_text(stiff)
    first, second = re.findall(
        r"^(?:python -m examples\.record arm|simgap diagnose) sweeps/arm.*$", PAGE, re.MULTILINE
    )[:2]
    run(folder, f"{sys.executable} {first.removeprefix('python ')} --sessions 3 --seconds 3")
    said = run(folder, str(Path(sys.executable).with_name(second.partition(" ")[0])) + second.removeprefix("simgap"))
    (folder / "said.txt").write_text(said)
    return folder


def run(folder: Path, command: str) -> str:
    done = subprocess.run(shlex.split(command), cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)},
                          capture_output=True, text=True, timeout=1200, check=False)  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def found(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "sweeps" / "arm-diagnosis" / "diagnosis.json").read_text())


@pytest.fixture(scope="module")
def page(folder: Path) -> str:
    """The text of the page's cells and paragraphs, tags apart."""
    text = (folder / "sweeps" / "arm-diagnosis" / "diagnosis.html").read_text()
    return re.sub(r"\s+", " ", re.sub(r"<style>.*?</style>|<[^>]+>", " ", text, flags=re.DOTALL))


@pytest.fixture(scope="module")
def patched(folder: Path) -> MujocoEngine:
    return load(folder / "sweeps" / "arm-diagnosis" / "arm.patched.xml", 0.02)


def test_the_commands_write_what_the_page_lists(folder: Path) -> None:
    listed = set(
        re.findall(r"`([\w.]+)`", "".join(re.findall(r"^\| `.*? \|", PAGE.partition("From Python")[0], re.MULTILINE)))
    )
    there = {path.name for path in (folder / "sweeps" / "arm-diagnosis").iterdir() if not path.name.startswith(".")}
    assert there == listed
    assert len(there) == 4
    said = (folder / "said.txt").read_text()
    assert f"note: The model's position servos are about {FACTOR} times too stiff (kp)." in said
    assert "model     sweeps/arm-diagnosis/arm.patched.xml" in said


def test_what_is_missing_is_named_from_the_nearer_start(found: dict[str, Any]) -> None:
    assert set(found["model_file"]["start"]) == {"kp pan", "kp shoulder", "kp elbow"}
    assert list(found["model_file"]["start"].values()) == pytest.approx([1 / FACTOR] * 3, rel=0.15)
    assert found["statement"].startswith(found["warnings"][0])
    assert found["warnings"][0] in found["notes"]
    (effect,) = found["effects"]
    assert (effect["id"], effect["where"]) == ("coulomb_friction", "shoulder")
    low, high = effect["constants"][0]["ci95"]
    assert low < 0.3 < high  # N m, examples/arm.py
    for name, kp in KP.items():
        assert found["parameters"]["nominal"][f"kp {name}"] == pytest.approx(FACTOR * kp)
        assert found["parameters"]["fitted"][f"kp {name}"] == pytest.approx(kp, rel=0.03)


def test_the_patched_model_has_what_was_found(found: dict[str, Any], patched: MujocoEngine) -> None:
    for name, kp in KP.items():
        assert patched.model.actuator(name).gainprm[0] == pytest.approx(kp, rel=0.03)
        assert patched.model.actuator(name).biasprm[1] == pytest.approx(-kp, rel=0.03)
    friction = [patched.model.joint(joint).frictionloss[0] for joint in JOINTS]
    assert friction == pytest.approx([0, found["effects"][0]["constants"][0]["value"], 0], rel=1e-5)


def test_the_loaded_simulator_moves_like_the_patched_model(folder: Path, patched: MujocoEngine) -> None:
    """From the model where it is remembered to be, and from a copy elsewhere."""
    there = folder / "sweeps" / "arm-diagnosis"
    (folder / "moved.xml").write_text((folder / "examples" / "arm.xml").read_text())
    rng = np.random.default_rng(0)
    state = rng.normal(0.0, 0.3, 6)
    command = state[:3] + rng.normal(0.0, 0.1, 3)
    expected = patched.path(patched.nominal, np.zeros(len(patched.terms)), state, np.stack([command, command]))[1]
    for robot in (simgap.load(there), simgap.load(there, folder / "moved.xml")):
        assert robot.effects == ("coulomb_friction",)
        after = robot.step(jnp.asarray(simgap.nominal(robot)), jnp.asarray(state), jnp.asarray(command))
        np.testing.assert_allclose(np.asarray(after)[:6], expected, rtol=1e-3, atol=1e-4)
        assert np.abs(np.asarray(after)[3:6] - state[3:6]).max() > 0.1


def test_the_page_says_first_where_the_diagnosis_started(found: dict[str, Any], page: str) -> None:
    words = found["warnings"][0].replace("'", "&#39;")
    assert 0 < page.index(words) < page.index("What is missing, most important first")


def test_the_page_has_open_loop_errors_of_every_joint(found: dict[str, Any], page: str) -> None:
    block = page.partition("Open loop:")[2]
    assert "model file start refitted with effects" in block.partition("pan_pos")[0]
    for position in found["replay"]["positions"]:
        errors = [position["errors"][model] for model in ("given", "nominal", "refitted", "augmented")]
        cells = re.search(rf"{position['name']} mrad ([\d.]+) ([\d.]+) ([\d.]+) ([\d.]+)", block)
        assert cells, position
        assert [float(c) for c in cells.groups()] == pytest.approx([1000 * e for e in errors], rel=0.02)
    by_joint = {p["name"]: p["errors"] for p in found["replay"]["positions"]}
    assert by_joint["shoulder_pos"]["augmented"] < 0.5 * by_joint["shoulder_pos"]["nominal"]
    said = re.search(r"and of the simulator with the effects: pan_pos from ([\d.]+) to ([\d.]+) mrad", page)
    assert said
    pan = by_joint["pan_pos"]
    assert pan["given"] > 3 * pan["nominal"]  # it is 20 times too stiff, the start a few percent
    assert [float(n) for n in said.groups()] == pytest.approx([1000 * pan[m] for m in ("given", "augmented")], rel=0.01)


def test_the_page_lists_every_change_of_the_model(found: dict[str, Any], page: str) -> None:
    block = page.partition("The model with these changes:")[2]
    assert block.split()[0] == found["patched"]["file"] == "arm.patched.xml"
    assert len(found["patched"]["changes"]) >= 4
    for change in found["patched"]["changes"]:
        assert " ".join(change[key] for key in ("element", "attribute", "before", "after")) in block


def test_nothing_is_said_of_bodies(found: dict[str, Any], page: str) -> None:
    """The machine is made of joints; the map on the page has their speeds."""
    for text in (json.dumps(found), page):
        assert re.findall(r"(?:yaw|(?<![a-z])body|frame|robot's own)", text.replace("_", " ")) == []
    assert "shoulder speed: high" in page
