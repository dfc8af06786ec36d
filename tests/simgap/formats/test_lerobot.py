"""LeRobot data sets, in the layouts of versions 2.1 and 3: every episode becomes the recording it was made of."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from test_importing import motion

from simgap.cli.importing import import_recordings
from simgap.formats.recordings import read_recordings
from simgap.simulators.spot import SCHEMA
from simgap.types import ConfigError, RecordingError

RATE, ROWS = 20, (100, 60)
STATE, ACTION = [f.name for f in SCHEMA.state], [f.name for f in SCHEMA.command]
DEGREES = [f.name for f in SCHEMA.state if f.unit == "rad"]
COLUMNS: dict[str, Any] = {
    **{n: {"column": f"observation.state.{n}", "unit": f.unit} for n, f in zip(STATE, SCHEMA.state, strict=True)},
    **{n: {"column": f"action.{i}", "unit": SCHEMA.command[i].unit} for i, n in enumerate(ACTION)},
}
for _name in DEGREES:
    COLUMNS[_name]["unit"] = "deg"


def features() -> dict[str, Any]:
    """As info.json describes them: names in a list, in a dictionary, or none."""
    one = {"shape": [1], "names": None}
    return {
        "observation.state": {"dtype": "float32", "shape": [12], "names": {"axes": STATE}},
        "action": {"dtype": "float32", "shape": [6], "names": None},
        "observation.images.top": {"dtype": "video", "shape": [480, 640, 3], "names": ["height", "width", "channels"]},
        "timestamp": {"dtype": "float32", **one}, "frame_index": {"dtype": "int64", **one},
        "episode_index": {"dtype": "int64", **one}, "index": {"dtype": "int64", **one},
        "task_index": {"dtype": "int64", **one},
    }  # fmt: skip


def episode(number: int, rows: int, fixed: bool) -> pa.Table:
    time = np.arange(rows) / RATE
    moved = motion(time + 10 * number)
    state = np.column_stack([np.rad2deg(moved[n]) if n in DEGREES else moved[n] for n in STATE]).astype(np.float32)
    action = np.column_stack([moved[n] for n in ACTION]).astype(np.float32)

    def lists(values: np.ndarray) -> pa.Array:
        flat, width = pa.array(values.ravel()), values.shape[1]
        if fixed:
            return pa.FixedSizeListArray.from_arrays(flat, width)
        return pa.ListArray.from_arrays(pa.array(np.arange(len(values) + 1) * width, pa.int32()), flat)

    count = np.arange(rows)
    return pa.table({
        "observation.state": lists(state), "action": lists(action), "timestamp": time.astype(np.float32),
        "frame_index": count, "episode_index": np.full(rows, number), "index": count, "task_index": 0 * count,
    })  # fmt: skip


def version_2(root: Path) -> None:
    """A file an episode."""
    for number, rows in enumerate(ROWS):
        path = root / "data" / "chunk-000" / f"episode_{number:06d}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(episode(number, rows, fixed=False), path)
    describe(root, "v2.1", "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet")


def version_3(root: Path) -> None:
    """Many episodes a file; what is said of episodes is Parquet as well."""
    path = root / "data" / "chunk-000" / "file-000.parquet"
    path.parent.mkdir(parents=True)
    whole = pa.concat_tables([episode(number, rows, fixed=True) for number, rows in enumerate(ROWS)])
    pq.write_table(whole, path, row_group_size=70)
    meta = root / "meta" / "episodes" / "chunk-000" / "file-000.parquet"
    meta.parent.mkdir(parents=True)
    pq.write_table(pa.table({"episode_index": [0, 1], "length": list(ROWS)}), meta)
    describe(root, "v3.0", "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet")


def describe(root: Path, version: str, path: str) -> None:
    (root / "meta").mkdir(exist_ok=True)
    info = {"codebase_version": version, "fps": RATE, "data_path": path, "features": features()}
    (root / "meta" / "info.json").write_text(json.dumps(info))


def mapping(folder: Path, columns: dict[str, Any] = COLUMNS) -> Path:
    path = folder / "mapping.yaml"
    path.write_text(yaml.safe_dump({"rate_hz": RATE, "longest_gap_s": 0.2, "columns": columns}))
    return path


@pytest.mark.parametrize("write", [version_2, version_3])
@pytest.mark.parametrize("below", [False, True])
def test_every_episode_becomes_what_it_was_made_of(tmp_path: Path, write: Callable[[Path], None], below: bool) -> None:
    write(tmp_path / "sets" / "walks")
    source = tmp_path / "sets" / ("." if below else "walks")
    import_recordings(source, mapping(tmp_path), tmp_path / "out", "spot")
    recordings, errors = read_recordings(tmp_path / "out", SCHEMA, 1 / RATE)
    assert not errors
    assert [r.name for r in recordings] == ["walks/episode_000000", "walks/episode_000001"]
    assert [len(r.time_s) for r in recordings] == list(ROWS)
    for number, recording in enumerate(recordings):
        moved = motion(recording.time_s + 10 * number)
        expected = np.column_stack([moved[n] for n in STATE])
        np.testing.assert_allclose(recording.state, expected, atol=2e-5)
        np.testing.assert_allclose(recording.command, np.column_stack([moved[n] for n in ACTION]), atol=1e-6)


def test_percents_have_a_scale(tmp_path: Path) -> None:
    version_2(tmp_path / "set")
    columns = {**COLUMNS, "ee_z": {"column": "observation.state.ee_z", "scale": 0.02, "sign": -1}}
    import_recordings(tmp_path / "set", mapping(tmp_path, columns), tmp_path / "out", "spot")
    (first, _), _ = read_recordings(tmp_path / "out", SCHEMA, 1 / RATE)
    np.testing.assert_allclose(first.state[:, 8], -0.02 * motion(first.time_s)["ee_z"], atol=1e-6)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (
            {"column": "observation.state.ee_z"},
            r"does not say its units, and the mapping gives none for ee_z. Add `unit`",
        ),
        (
            {"column": "observation.state.ee_q", "unit": "m"},
            r"state\.ee_q; nearest to observation\.state\.ee_q is observation\.state\.ee_\w\. Not used: .*state\.ee_z",
        ),
        ({"column": "observation.images.top.0", "unit": "m"}, r"has no column observation\.images\.top\.0"),
        ({"topic": "/hand", "field": "z"}, r"the mapping has no `column` for ee_z"),
        ({"column": "observation.state.ee_z", "unit": "m", "scale": 2.0}, "give `unit` or `scale`, not both"),
        ({"column": "observation.state.ee_z", "scale": 0.0}, "`scale` must not be 0"),
    ],
)
def test_a_mapping_that_does_not_fit_says_why(
    tmp_path: Path, changed: dict[str, Any], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    version_3(tmp_path / "set")
    with pytest.raises((ConfigError, RecordingError)) as error:
        import_recordings(tmp_path / "set", mapping(tmp_path, {**COLUMNS, "ee_z": changed}), tmp_path / "out", "spot")
    assert re.search(words, f"{error.value} {capsys.readouterr().out}")


def test_a_damaged_file_loses_no_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    version_2(tmp_path / "set")
    damaged = tmp_path / "set" / "data" / "chunk-000" / "episode_000000.parquet"
    damaged.write_bytes(damaged.read_bytes()[:-500])
    import_recordings(tmp_path / "set", mapping(tmp_path), tmp_path / "out", "spot")
    assert f"left out: {damaged}: is no file of a LeRobot data set" in capsys.readouterr().out
    recordings, _ = read_recordings(tmp_path / "out", SCHEMA, 1 / RATE)
    assert [r.name for r in recordings] == ["set/episode_000001"]


def hostile(column: str, values: Any) -> Callable[[pa.Table], pa.Table]:
    """A file whose column holds other values."""
    return lambda table: table.set_column(table.column_names.index(column), column, pa.array(values))


ABSURD_FPS = [0, -30, float("nan"), float("inf"), 1e-310, 1e9, 10**400, "fast", None, [30]]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (hostile("episode_index", ["0"] * 100), "episode_index holds values of type string; all must be whole numbers"),
        (hostile("episode_index", [float("nan")] * 100), "episode_index holds values of type double;"),
        (hostile("episode_index", [1e30] * 100), "episode_index holds values of type double;"),
        (hostile("episode_index", [None] * 100), "episode_index holds values of type null and 100 blanks;"),
        (hostile("episode_index", [0] * 99 + [None]), "episode_index holds values of type int64 and 1 blanks;"),
        (hostile("episode_index", [{"a": 1}] * 100), "episode_index holds values of type struct<a: int64>;"),
        (hostile("episode_index", [[0]] * 100), "episode_index holds values of type list<"),
        (hostile("action", [{"a": 1}] * 100), "float() argument must be"),
        (hostile("action", ["left"] * 100), "could not convert string to float"),
    ],
)
def test_a_file_made_to_harm_loses_no_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: Callable[[pa.Table], pa.Table], words: str
) -> None:
    version_2(tmp_path / "set")
    harmful = tmp_path / "set" / "data" / "chunk-000" / "episode_000000.parquet"
    pq.write_table(change(pq.read_table(harmful)), harmful)
    import_recordings(tmp_path / "set", mapping(tmp_path), tmp_path / "out", "spot")
    (left_out,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("left out: ")]
    assert left_out.startswith(f"left out: {harmful}: is no file of a LeRobot data set ({words}")
    recordings, _ = read_recordings(tmp_path / "out", SCHEMA, 1 / RATE)
    assert [r.name for r in recordings] == ["set/episode_000001"]


@pytest.mark.parametrize(
    ("info", "words"),
    [
        ({"codebase_version": "v1.6", "fps": 30, "features": {}}, "of version v1.6; 2 and 3 are read"),
        ({"codebase_version": "v3.0"}, "describes no LeRobot data set"),
        ([], "describes no LeRobot data set"),
        *(
            ({"codebase_version": "v3.0", "fps": fps, "features": features()}, "must be a number from 0.001 to 10,000)")
            for fps in ABSURD_FPS
        ),
        *(
            (
                {"codebase_version": "v3.0", "fps": RATE,
                 "features": {**features(), "action": {"dtype": "float32", "shape": [size], "names": None}}},
                "the shape of 'action' is [",
            )
            for size in (10**12, 10_001, 0, -6, 6.0, "6", None, True, [6])
        ),
    ],
)  # fmt: skip
def test_what_is_no_such_data_set_is_explained(
    tmp_path: Path, info: Any, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    version_2(tmp_path / "set")
    (tmp_path / "set" / "meta" / "info.json").write_text(json.dumps(info))
    with pytest.raises(RecordingError):
        import_recordings(tmp_path / "set", mapping(tmp_path), tmp_path / "out", "spot")
    assert words in capsys.readouterr().out
