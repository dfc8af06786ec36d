"""What people install: the wheel alone, in an environment of its own, away from the project."""

import json
import os
import shutil
import subprocess
import sys
import zipfile
from importlib.metadata import requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from examples.record import record

ROOT = Path(__file__).parents[2]
UV = str(Path(sys.executable).parent / "uv")
PIPELINE = {"prefect", "mlflow", "dvc", "dask", "distributed", "pandas", "sqlalchemy", "mcap", "rosbags"}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy: building leaves files beside the sources."""
    copy, out = tmp_path_factory.mktemp("project"), tmp_path_factory.mktemp("wheel")
    for name in ("simgap", "flows", "tasks", "concealed"):
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE", "NOTICE"):
        shutil.copy(ROOT / name, copy)
    subprocess.run([UV, "build", "--quiet", "--wheel", "--out-dir", out, copy], check=True, timeout=300)
    (built,) = out.glob("*.whl")
    return built


def test_the_wheel_contains_simgap_alone_and_all_of_it(wheel: Path) -> None:
    names = [name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name]
    files = [p for p in (ROOT / "simgap").rglob("*") if p.is_file() and "__pycache__" not in p.parts]
    assert sorted(names) == sorted(p.relative_to(ROOT).as_posix() for p in files)


def test_nothing_of_the_pipeline_is_needed() -> None:
    needed = [Requirement(text) for text in requires("simgap") or []]
    core = {r.name for r in needed if r.marker is None}
    assert {"jax", "numpy", "scipy"} <= core
    assert not PIPELINE & core
    assert all("<" not in str(r.specifier) for r in needed if r.marker is None)


def test_a_diagnosis_runs_from_the_wheel(wheel: Path, tmp_path: Path) -> None:
    """In an environment that has the wheel and what it needs, in the versions of the lock file."""
    subprocess.run([UV, "venv", "--quiet", "--python", sys.executable, tmp_path / "venv"], check=True, timeout=100)
    python = tmp_path / "venv" / "bin" / "python"
    locked = tmp_path / "locked.txt"
    lines = (ROOT / "requirements.lock").read_text().splitlines()
    locked.write_text("\n".join(line.removesuffix(" \\") for line in lines if line[:1].isalnum()))
    install = [UV, "pip", "install", "--quiet", "--python", python, "--constraint", locked, wheel]
    subprocess.run(install, check=True, timeout=600)
    there = subprocess.run([UV, "pip", "list", "--format", "json", "--python", python], capture_output=True, check=True)
    assert not PIPELINE & {package["name"] for package in json.loads(there.stdout)}
    person = tmp_path / "person"
    record("drive", person / "rail", sessions=3, seconds=8.0, seed=0)
    shutil.copy(ROOT / "examples" / "drive.py", person)
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "JAX_COMPILATION_CACHE_DIR")}
    done = subprocess.run(
        [python.parent / "simgap", "diagnose", "rail", "--simulator", "drive:DRIVE", "--out", "found"],
        cwd=person, env={**environment, "XDG_CACHE_HOME": str(tmp_path / "cache")},
        capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads((person / "found" / "diagnosis.json").read_text())["statement"] in done.stdout
    assert {path.name for path in person.iterdir()} - {"__pycache__"} == {"rail", "drive.py", "found"}
