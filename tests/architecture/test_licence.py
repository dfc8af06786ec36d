"""The licence is whole, the package says so, and NOTICE is right about what the repository holds."""

import hashlib
import subprocess
import sys
from email.message import Message
from email.parser import Parser
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
APACHE_2 = "cfc7749b96f63bd31c3c42b5c471bf756814053e847c10f3eb003417bc523d30"
"""SHA-256 of the text that the Apache Software Foundation publishes, the place for the owner's name left open."""
OWNER, OPEN = "Copyright 2026 The Simgap authors", "Copyright [yyyy] [name of copyright owner]"
BUILD = "import sys; from setuptools import build_meta; build_meta.prepare_metadata_for_build_wheel(sys.argv[1])"


@pytest.fixture(scope="module")
def metadata(tmp_path_factory: pytest.TempPathFactory) -> tuple[Message, Path]:
    """What the package says of itself when it is built, and the folder of its metadata."""
    out = tmp_path_factory.mktemp("metadata")
    subprocess.run([sys.executable, "-c", BUILD, str(out)], cwd=ROOT, check=True, capture_output=True, timeout=100)
    (folder,) = out.glob("*.dist-info")
    return Parser().parsestr((folder / "METADATA").read_text()), folder


def test_the_licence_is_the_whole_apache_licence() -> None:
    text = (ROOT / "LICENSE").read_text()
    assert text.count(OWNER) == 1
    assert hashlib.sha256(text.replace(OWNER, OPEN).encode()).hexdigest() == APACHE_2


def test_the_package_carries_the_licence_and_the_notice(metadata: tuple[Message, Path]) -> None:
    known, folder = metadata
    assert known["License-Expression"] == "Apache-2.0"
    assert known["Author"] == "The Simgap authors"
    assert known.get_all("License-File") == ["LICENSE", "NOTICE"]
    for name in ("LICENSE", "NOTICE"):
        assert (folder / "licenses" / name).read_bytes() == (ROOT / name).read_bytes()


def test_the_notice_names_the_source_and_what_is_computed_from_it() -> None:
    notice = (ROOT / "NOTICE").read_text()
    assert OWNER in notice
    assert "github.com/benjirer/simulation_transfer, under the MIT licence" in notice
    for source in ("SO-ARM100, Apache-2.0", "Rhoban/bam, Apache-2.0", "discovery-of-physics-from-data, MIT"):
        assert source in notice
    simulated = {"reports/ground", "reports/sealed", "reports/tests", "reports/virtual"}
    listed = {"reports/external", "reports/spot"}
    assert {str(p.relative_to(ROOT)) for p in (ROOT / "reports").iterdir() if p.is_dir()} <= listed | simulated
    for folder in (*listed, "reports/sealed/real"):
        assert folder in notice
        assert (ROOT / folder).is_dir()


def test_no_recordings_and_no_trained_models_are_in_the_repository() -> None:
    """As NOTICE says."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    tracked = [Path(name) for name in listed.splitlines()]
    assert Path("NOTICE") in tracked
    assert not [p for p in tracked if p.suffix in (".parquet", ".pickle", ".pkl", ".mcap", ".bag")]
    assert not [p for p in tracked if p.parts[0] in ("data", "models")]
    for path in (p for p in tracked if p.suffix == ".csv"):
        assert not (ROOT / path).read_text().startswith("time_s,base_x"), f"{path} is a recording"
