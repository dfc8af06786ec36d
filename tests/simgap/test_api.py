"""Diagnosing from Python: recordings in every form, the result for programs and notebooks, and loading it again."""

import html
import json
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import simgap
from examples.drive import DRIVE, Drive
from examples.record import record
from simgap import api
from simgap.formats.recordings import read_recordings
from simgap.types import ConfigError, Recording, RecordingError, Sessions, SimgapError

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of a drive with dry friction, which its simulator lacks."""
    folder = tmp_path_factory.mktemp("rail")
    record("drive", folder, sessions=4, seconds=10.0, seed=0)
    return folder


@pytest.fixture(scope="module")
def heard() -> list[tuple[str, set[int]]]:
    """Lines of progress, and how many threads a matrix product had then."""
    return []


def threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


@pytest.fixture(scope="module")
def result(folder: Path, heard: list[tuple[str, set[int]]]) -> simgap.Result:
    with threadpool_limits(limits=2, user_api="blas"):  # as where numpy was imported first
        diagnosed = simgap.diagnose(DRIVE, folder, progress=lambda line: heard.append((line, threads())))
        assert threads() == {2}
    return diagnosed


def test_the_missing_friction_is_named_with_its_constant(
    result: simgap.Result, heard: list[tuple[str, set[int]]]
) -> None:
    assert result.verdict == "missing_physics"
    (effect,) = result.effects
    assert effect.id == "coulomb_friction"
    assert effect.probability > 0.9
    (constant,) = effect.constants.values()
    low, high = constant["ci95"]
    assert low < 2.5 < high  # N, examples/record.py
    assert constant["unit"] == "N"
    assert str(result) == result.statement["statement"]
    assert any("hypotheses tested" in line for line, _ in heard)


@pytest.mark.usefixtures("result")
def test_the_search_alone_computes_on_several_threads(heard: list[tuple[str, set[int]]]) -> None:
    during = [threads for line, threads in heard if "hypotheses tested" in line]
    assert during
    assert all(threads == {1} for threads in during)


def test_a_notebook_shows_page_and_pictures(result: simgap.Result, tmp_path: Path) -> None:
    page = result.to_html(tmp_path / "page.html")
    assert (tmp_path / "page.html").read_text() == page
    assert html.escape(str(result)) in page
    assert html.escape(page) in result._repr_html_()
    for what, least in (("forecasts", 1), ("laws", 1), ("sessions", 1)):
        pictures = result.plot(what)  # type: ignore[arg-type]
        assert len(pictures) >= least, what
        assert pictures[0]._repr_svg_().startswith("<?xml")
    pictures[0].save(tmp_path / "sessions.svg")
    assert (tmp_path / "sessions.svg").read_bytes() == pictures[0].svg
    with pytest.raises(ConfigError, match="must be one of forecasts, laws, sessions, experiment; it is 'all'"):
        result.plot("all")  # type: ignore[arg-type]


def test_the_corrected_simulator_forecasts_better(result: simgap.Result, folder: Path) -> None:
    (session, *_), _ = read_recordings(folder, DRIVE.schema, DRIVE.time_step)

    def error(simulator: Any) -> float:
        state, phi = jnp.asarray(session.state[0], jnp.float32), simgap.nominal(simulator)
        errors = []
        for k in range(50):
            state = simulator.step(phi, state, jnp.asarray(session.command[k], jnp.float32))
            errors.append(float(state[0]) - session.state[k + 1, 0])
        return float(np.sqrt(np.mean(np.square(errors))))

    assert error(result.simulator) < 0.3 * error(DRIVE)


def test_what_is_saved_is_loaded_again(result: simgap.Result, tmp_path: Path) -> None:
    result.save(tmp_path / "found")
    assert json.loads((tmp_path / "found" / "diagnosis.json").read_text())["simulator"] == "examples.drive:DRIVE"
    assert simgap.load(tmp_path / "found") == result.simulator
    assert simgap.load(tmp_path / "found", Drive()) == result.simulator
    with pytest.raises(SimgapError, match="no diagnosis of this simulator"):
        simgap.load(tmp_path / "found", Drive(parameters=DRIVE.parameters[:1]))
    with pytest.raises(SimgapError, match=r"holds no diagnosis\.json"):
        simgap.load(tmp_path)


@pytest.mark.parametrize("page", ["docs/reference/python.md", "README.md"])
def test_the_pages_about_it_work_as_printed(
    page: str, folder: Path, result: simgap.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sweeps").mkdir()
    (tmp_path / "sweeps" / "drive").symlink_to(folder)
    result.save("sweeps/drive-diagnosis")
    blocks = re.findall(r"^```python\n(.*?)^```$", (ROOT / page).read_text(), re.MULTILINE | re.DOTALL)
    names: dict[str, Any] = {"state": jnp.zeros(2), "command": jnp.ones(1)}
    for block in blocks:
        if "mlflow" not in block:
            exec(block, names)
    assert len(blocks) == 2
    assert (tmp_path / "drive.html").exists()
    assert names["d"].simulator.effects == names["robot"].effects == ("coulomb_friction",)


def test_the_page_about_the_file_names_every_key(result: simgap.Result) -> None:
    """But those that are names of parameters, bodies and sessions."""
    page = (ROOT / "docs" / "reference" / "diagnosis_json.md").read_text()
    named = {p.name for p in DRIVE.parameters} | {"error_50_cart [m]"}
    assert set(keys(result.statement)) - named - set(re.findall(r"\w+", page)) == set()


def keys(value: Any) -> Iterator[str]:
    """Of dictionaries, at any depth."""
    if isinstance(value, dict):
        yield from value
    for part in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from keys(part)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What is given to the diagnosis, which does not run."""
    asked: list[Any] = []
    monkeypatch.setattr(api, "find", lambda *given: asked.append(given) or SimpleNamespace())
    return asked


def tables(recordings: list[Recording]) -> dict[str, pd.DataFrame]:
    columns = DRIVE.schema.columns
    return {r.name: pd.DataFrame(np.column_stack([r.time_s, r.state, r.command]), columns=columns) for r in recordings}


def same(a: Sessions, b: Sessions) -> bool:
    parts = a.by_purpose.values(), b.by_purpose.values()
    pairs = [(x, y) for one, other in zip(*parts, strict=True) for x, y in zip(one, other, strict=True)]
    return all(np.array_equal(x, y) for r, q in pairs for x, y in zip(r[1:], q[1:], strict=True))


def test_recordings_are_the_same_in_every_form(folder: Path, asked: list[Any]) -> None:
    recordings, _ = read_recordings(folder, DRIVE.schema, DRIVE.time_step)
    named = tables(recordings)
    forms: list[Any] = [
        folder, str(folder), [folder], recordings, named, list(named.values()),
        [{c: table[c].to_list() for c in table} for table in named.values()],
        {name: {c: table[c].to_numpy() for c in table} for name, table in named.items()},
        [pa.Table.from_pandas(table).to_pandas() for table in named.values()],
    ]  # fmt: skip
    for form in forms:
        simgap.diagnose(DRIVE, form)
    (_, name, first, seed, _), *others = asked
    assert (name, seed) == ("examples.drive:DRIVE", 0)
    assert [r.name for r in first.training] == ["drive_01", "drive_02", "drive_03"]
    assert all(same(first, other[2]) for other in others)
    simgap.diagnose(DRIVE, named["drive_01"], heldout=recordings[1], baseline=[named["drive_03"]])
    sessions = asked[-1][2]
    names = [[r.name for r in part] for part in sessions.by_purpose.values()]
    assert names == [["session_1"], ["drive_02"], ["baseline/session_1"]]


def test_a_file_that_cannot_be_used_is_left_out(tmp_path: Path, asked: list[Any]) -> None:
    record("drive", tmp_path, sessions=2, seconds=2.0, seed=0)
    (tmp_path / "broken.csv").write_text("time_s,position\n0,0\n")
    result = simgap.diagnose("examples.drive:DRIVE", tmp_path)
    assert asked
    assert ["broken.csv: column velocity" in why for why in result.left_out] == [True]


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"simulator": object()}, ConfigError, "object: a simulator must have schema"),
        ({"simulator": "nosuch:X"}, ConfigError, "there is no module nosuch"),
        ({"seed": -1}, ConfigError, "seed is -1; it must be a whole number from 0 to 2,147,483,647"),
        ({"seed": 2**31}, ConfigError, "seed is 2147483648; it must be"),
        ({"seed": 0.5}, ConfigError, "seed is 0.5; it must be"),
        ({"recordings": 3}, ConfigError, "recordings must be a folder, tables .*; they are int"),
        ({"recordings": []}, RecordingError, "recordings: no session is given"),
        ({"recordings": [3]}, RecordingError, "session session_1: must be a table .*; it is int"),
        ({"recordings": {"time_s": [0, 1]}}, RecordingError, "session session_1: column position, velocity, cmd_force"),
        ({"recordings": "nowhere"}, RecordingError, "nowhere: there is no such folder"),
    ],
)
def test_wrong_input_says_what_would_be_right(folder: Path, given: dict[str, Any], error: Any, words: str) -> None:
    with pytest.raises(error, match=words):
        simgap.diagnose(**{"simulator": DRIVE, "recordings": folder, **given})


def test_damaged_tables_are_named_with_column_and_row(folder: Path) -> None:
    (first, *_), _ = read_recordings(folder, DRIVE.schema, DRIVE.time_step)
    table = tables([first])[first.name]
    table.loc[4, "velocity"] = np.nan
    with pytest.raises(RecordingError, match="session monday: column velocity, row 5 is nan"):
        simgap.diagnose(DRIVE, {"monday": table})
    ragged = {c: list(table[c]) for c in table} | {"velocity": [0.0]}
    with pytest.raises(RecordingError, match="every column must be one series of numbers, all of the same length"):
        simgap.diagnose(DRIVE, ragged)
    with pytest.raises(RecordingError, match=r"session drive_01: state and command must have 2 and 1 columns"):
        simgap.diagnose(DRIVE, first._replace(state=first.state[:, :1]))
    with pytest.raises(RecordingError, match="heldout: the session session_1 is the session drive_01"):
        simgap.diagnose(DRIVE, [first], heldout=[tables([first])[first.name]])


def test_public_names_are_there_and_others_are_not() -> None:
    assert all(getattr(simgap, name) for name in simgap.__all__)
    with pytest.raises(AttributeError, match="has no attribute 'diagnos'"):
        simgap.diagnos  # noqa: B018
