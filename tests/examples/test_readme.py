"""The README's first commands, as printed, with the numbers that it states; and its picture."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
PICTURES = os.environ.get("SIMGAP_PICTURES")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the examples, after the commands."""
    place = tmp_path_factory.mktemp("clone")
    (place / "examples").symlink_to(ROOT / "examples")
    section = (ROOT / "README.md").read_text().split("## A diagnosis in 30 seconds")[1]
    commands = re.findall(r"^(?:python|simgap) .*", section.split("```")[1], re.MULTILINE)
    assert len(commands) == 2
    for command in commands:
        program, *arguments = shlex.split(command)
        done = subprocess.run(
            [Path(sys.executable).parent / program, *arguments], cwd=place, capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, done.stdout + done.stderr
    return place / "sweeps" / "drive-diagnosis"


def test_the_readmes_diagnosis_is_what_comes_out(place: Path) -> None:
    readme = " ".join((ROOT / "README.md").read_text().split())
    found = json.loads((place / "diagnosis.json").read_text())
    (effect,) = found["effects"]
    (constant,) = effect["constants"]
    low, high = constant["ci95"]
    stated = f"`{effect['id']}`, alone, with {constant['value']:.3f} N (95 % interval {low:.3f} to {high:.3f})"
    assert stated in readme
    before, after = (100 * found["fit"]["models"][m]["error_50"]["value"] for m in ("refitted", "augmented"))
    assert f"falls from {before:.0f} % to {after:.1f} % of the motion" in readme


def test_the_readmes_picture_is_of_that_page(place: Path, tmp_path: Path, browser: Any) -> None:
    """Drawn anew by SIMGAP_PICTURES=docs/pictures python -m pytest -n0 tests/examples/test_readme.py"""
    picture = Path(PICTURES or tmp_path) / "diagnosis.png"
    page = browser.new_page(viewport={"width": 1000, "height": 600})
    page.goto((place / "diagnosis.html").as_uri())
    assert "friction" in page.locator("h1").inner_text()
    page.screenshot(path=picture)
    assert picture.stat().st_size < 200_000
    assert (ROOT / "docs" / "pictures" / "diagnosis.png").stat().st_size < 200_000
