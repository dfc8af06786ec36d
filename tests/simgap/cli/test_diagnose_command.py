"""The command `simgap diagnose` as a person runs it: in a folder of their own, with a simulator of their own."""

import html
import json
import os
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

import simgap
from examples.record import record
from simgap.cli import main, progress

ROOT = Path(__file__).parents[3]
COMMAND = str(Path(sys.executable).parent / "simgap")
SIMULATORS = "from examples.drive import DRIVE\n\nBROKEN = object()\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A person's folder: recordings of a drive with friction, one session damaged, and `mine.py`, a simulator."""
    folder = tmp_path_factory.mktemp("person")
    record("drive", folder / "rail", sessions=3, seconds=20.0, seed=0)
    (folder / "rail" / "broken.csv").write_text("time_s,position\n0,0\n")
    (folder / "empty").mkdir()
    (folder / "mine.py").write_text(SIMULATORS)
    return folder


@pytest.fixture(scope="module")
def done(folder: Path) -> subprocess.CompletedProcess[str]:
    """A diagnosis whose statement is asked for as JSON: what else is said goes to standard error."""
    command = [COMMAND, "diagnose", "rail", "--simulator", "mine:DRIVE", "--out", "found", "--json"]
    done = subprocess.run(
        command, cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done


@pytest.mark.long
def test_the_statement_is_printed_and_where_the_page_is(folder: Path, done: subprocess.CompletedProcess[str]) -> None:
    found = json.loads((folder / "found" / "diagnosis.json").read_text())
    assert json.loads(done.stdout) == found
    assert found["verdict"] in ("missing_physics", "parameters_only", "nothing", "unexplained", "inconclusive")
    assert found["simulator"] == "mine:DRIVE"
    assert found["statement"] in done.stderr
    (page,) = [line.split()[1] for line in done.stderr.splitlines() if line.startswith("page ")]
    assert html.escape(found["statement"]) in (folder / page).read_text()
    assert "left out: rail/broken.csv: column velocity, cmd_force is missing" in done.stderr
    assert done.stderr.startswith("4 files in rail; trying the simulator mine:DRIVE\n")
    assert "Traceback" not in done.stderr
    assert "Warning" not in done.stderr


@pytest.mark.long
def test_the_experiment_is_there_if_it_is_called_for(folder: Path, done: subprocess.CompletedProcess[str]) -> None:
    found = json.loads(done.stdout)
    commands = folder / "found" / "experiment.csv"
    assert commands.exists() == bool(found["experiment"])
    assert ("commands  found/experiment.csv" in done.stderr) == commands.exists()
    if commands.exists():
        table = pd.read_csv(commands)
        assert list(table.columns) == ["time_s", "cmd_force"]
        assert table["time_s"].diff().dropna().to_numpy() == pytest.approx(0.02)


@pytest.mark.long
@pytest.mark.usefixtures("done")
def test_nothing_but_the_output_is_left(folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} - {"__pycache__"} == {"rail", "empty", "mine.py", "found"}


@pytest.mark.long
@pytest.mark.usefixtures("done")
def test_the_corrected_simulator_is_loaded_from_the_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(folder))
    found = json.loads((folder / "found" / "diagnosis.json").read_text())
    simulator = simgap.load("found")
    assert set(simulator.effects) <= {effect["id"] for effect in (*found["effects"], *found["closest_matches"])}
    values = dict(zip((p.name for p in simulator.parameters), simgap.nominal(simulator), strict=True))
    assert values == pytest.approx(found["parameters"]["fitted"], rel=1e-5)
    sys.modules.pop("mine", None)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["empty", "--simulator", "mine:DRIVE"], ["empty: no file matches", "put the sessions there"]),
        (["rail", "--simulator", "mine:BROKEN"], ["mine:BROKEN: a simulator must have schema"]),
        (["rail", "--simulator", "mine:BROKEN", "--quiet"], ["mine:BROKEN: a simulator must have schema"]),
    ],
)
def test_wrong_input_is_explained_without_a_traceback(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str],
    arguments: list[str], words: list[str],
) -> None:  # fmt: skip
    """The command, but in this process: of another one, all time would be its imports."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", ["simgap", "diagnose", *arguments])
    monkeypatch.setattr(sys, "path", [*sys.path])  # the command adds the folder, for `mine`
    with pytest.raises(SystemExit) as ended:
        main.main()
    progress.choose(quiet=False, verbose=False, json=False)
    sys.modules.pop("mine", None)
    output = "".join(capfd.readouterr())
    assert ended.value.code == 1, output
    assert all(word in output for word in words), output
    assert ("trying the simulator" in output) == ("--quiet" not in arguments and "rail" in arguments)
    assert "Traceback" not in output
    assert not (folder / "diagnosis").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--version"], f"simgap {simgap.__version__}\n"),
        (["--print-completion", "bash"], "-F _shtab_simgap simgap"),
        (["--print-completion", "zsh"], "#compdef simgap"),
    ],
)
def test_what_the_command_says_of_itself(
    arguments: list[str], words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["simgap", *arguments])
    with pytest.raises(SystemExit) as ended:
        main.main()
    assert ended.value.code == 0
    assert words in capsys.readouterr().out


def test_the_completion_is_one_that_bash_takes(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["simgap", "--print-completion", "bash"])
    with pytest.raises(SystemExit):
        main.main()
    ask = '\nCOMP_WORDS=(simgap dia); COMP_CWORD=1; _shtab_simgap; echo "${COMPREPLY[@]}"'
    done = subprocess.run(["bash", "-c", capsys.readouterr().out + ask], capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == ["diagnose"]
