"""LeRobot data sets of a robot with a model: columns by the names of joints, in units that are asked for."""

import json
import math
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from examples.arm import JOINTS, MODEL, ArmConfig, arm_session, schema
from simgap.cli import main
from simgap.formats.recordings import read_recordings

RATE, EPISODES = 50, 3
RANGE = (-2.0, 2.0)  # rad, of every joint of the model
SESSIONS = [arm_session(np.random.default_rng(k), 60, ArmConfig(speeds=False)) for k in range(EPISODES)]
NAMES = [f"{joint}.pos" for joint in JOINTS]


def to_degrees(radians: np.ndarray) -> np.ndarray:
    """As LeRobot records arms: degrees, and of the last joint, the gripper, percents of its range."""
    found = np.rad2deg(radians)
    found[:, 2] = 100 * (radians[:, 2] - RANGE[0]) / (RANGE[1] - RANGE[0])
    return found


def to_percent(radians: np.ndarray) -> np.ndarray:
    """From -100 to 100 over the range."""
    return 100 * radians / RANGE[1]


def episode(number: int, convert: Callable[[np.ndarray], np.ndarray]) -> pa.Table:
    """Rows of an episode, as the library's own writer has them: lists of a fixed size in single precision."""
    state, action = (convert(values).astype(np.float32) for values in SESSIONS[number])
    count = np.arange(len(state))

    def lists(values: np.ndarray) -> pa.Array:
        return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])

    return pa.table({
        "action": lists(action), "observation.state": lists(state),
        "timestamp": (count / RATE).astype(np.float32), "frame_index": count, "episode_index": 0 * count + number,
        "index": count + len(count) * number, "task_index": 0 * count,
    })  # fmt: skip


def info(version: str, path: str, names: Any) -> dict[str, Any]:
    one = {"shape": [1], "names": None}
    numbers = {name: {"dtype": "int64", **one} for name in ("frame_index", "episode_index", "index", "task_index")}
    video = {"dtype": "video", "shape": [480, 640, 3], "names": ["height", "width", "channels"],
             "info": {"video.fps": RATE, "video.codec": "av1"}}  # fmt: skip
    vector = {"dtype": "float32", "shape": [len(JOINTS)], "names": names}
    return {
        "codebase_version": version, "robot_type": "so101_follower", "total_episodes": EPISODES, "fps": RATE,
        "total_frames": 60 * EPISODES, "total_tasks": 1, "chunks_size": 1000, "splits": {"train": f"0:{EPISODES}"},
        "data_path": path, "video_path": None,
        "features": {"action": vector, "observation.state": vector, "observation.images.front": video,
                     "timestamp": {"dtype": "float32", **one}, **numbers},
    }  # fmt: skip


def version_2(root: Path, convert: Callable[[np.ndarray], np.ndarray], names: Any = NAMES) -> None:
    """A file an episode; what is said of episodes and tasks is lines of JSON."""
    (root / "meta").mkdir(parents=True)
    (root / "data" / "chunk-000").mkdir(parents=True)
    for k in range(EPISODES):
        pq.write_table(episode(k, convert), root / "data" / "chunk-000" / f"episode_{k:06d}.parquet")
    lines = [json.dumps({"episode_index": k, "tasks": ["wave"], "length": 60}) for k in range(EPISODES)]
    (root / "meta" / "episodes.jsonl").write_text("\n".join(lines))
    (root / "meta" / "tasks.jsonl").write_text(json.dumps({"task_index": 0, "task": "wave"}))
    path = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
    (root / "meta" / "info.json").write_text(json.dumps(info("v2.1", path, names)))


def version_3(root: Path, convert: Callable[[np.ndarray], np.ndarray], names: Any = NAMES) -> None:
    """Several episodes a file; what is said of episodes and tasks is Parquet, too."""
    episodes, data = root / "meta" / "episodes" / "chunk-000", root / "data" / "chunk-000"
    episodes.mkdir(parents=True)
    data.mkdir(parents=True)
    pq.write_table(pa.concat_tables([episode(0, convert), episode(1, convert)]), data / "file-000.parquet")
    pq.write_table(episode(2, convert), data / "file-001.parquet")
    of = np.arange(EPISODES)
    pq.write_table(pa.table({
        "episode_index": of, "data/chunk_index": 0 * of, "data/file_index": of // 2, "dataset_from_index": 60 * of,
        "dataset_to_index": 60 * of + 60, "tasks": [["wave"]] * EPISODES, "length": 0 * of + 60,
    }), episodes / "file-000.parquet")  # fmt: skip
    pq.write_table(pa.table({"task_index": [0], "task": ["wave"]}), root / "meta" / "tasks.parquet")
    path = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    (root / "meta" / "info.json").write_text(json.dumps(info("v3.0", path, names)))


def command(folder: Path, monkeypatch: pytest.MonkeyPatch, arguments: str) -> int:
    """The exit status of `simgap import set ...`."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", shlex.split(f"simgap import set --simulator {MODEL} --out out {arguments}"))
    monkeypatch.setattr(sys, "path", [*sys.path])
    try:
        main.main()
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


@pytest.mark.parametrize("write", [version_2, version_3])
@pytest.mark.parametrize(
    ("convert", "units"), [(to_degrees, "deg,elbow=percent"), (to_percent, "signed_percent"), (lambda x: x, "rad")]
)
def test_joints_are_found_by_their_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write: Any, convert: Any, units: str
) -> None:
    write(tmp_path / "set", convert)
    assert command(tmp_path, monkeypatch, f"--units {units}") == 0
    recordings, errors = read_recordings(tmp_path / "out", schema(speeds=False), 1 / RATE)
    assert errors == []
    assert [r.name for r in recordings] == [f"set/episode_{k:06d}" for k in range(EPISODES)]
    for recording, (state, action) in zip(recordings, SESSIONS, strict=True):
        np.testing.assert_allclose(recording.state, state, atol=1e-5)
        np.testing.assert_allclose(recording.command, action, atol=1e-5)


def test_names_may_stand_in_a_group_and_without_an_ending(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    version_2(tmp_path / "set", np.rad2deg, {"motors": list(JOINTS)})
    assert command(tmp_path, monkeypatch, "--units deg") == 0
    (first, *_), _ = read_recordings(tmp_path / "out", schema(speeds=False), 1 / RATE)
    np.testing.assert_allclose(first.state, SESSIONS[0][0], atol=1e-5)


@pytest.mark.parametrize(
    ("arguments", "names", "words"),
    [
        ("", NAMES, "a LeRobot data set does not say its units. Say --units deg, rad, m, mm, percent, signed_percent"),
        ("--units pan=deg", NAMES, "does not say its units"),
        ("--units deg,elbw=rad", NAMES, "--units names elbw, which is no joint of the model; nearest to elbw is elbow"),
        ("--units furlong", NAMES, "'furlong' cannot be converted to rad; known are rad, deg"),
        (
            "--units deg",
            ["a", "b", "c"],
            "observation.state.pan.pos; there are action.a, action.b, action.c, observation",
        ),
        ("--units deg", ["pan.pos"] * 3, "there are action.0, action.1, action.2"),
        ("--units deg --mapping m.yaml", NAMES, "--units and --mapping exclude each other"),
    ],
)
def test_what_is_missing_is_asked_for_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str],
    arguments: str, names: Any, words: str,
) -> None:  # fmt: skip
    version_3(tmp_path / "set", np.rad2deg, names)
    assert command(tmp_path, monkeypatch, arguments) == 1
    said = "".join(capfd.readouterr()).strip()
    assert words in " ".join(said.split())
    assert "Traceback" not in said
    assert not (tmp_path / "out").exists()


def test_a_mapping_has_percents_of_a_range(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    version_2(tmp_path / "set", to_degrees)
    columns: dict[str, Any] = {
        "pan_pos": {"column": "observation.state.pan.pos", "unit": "deg"},
        "elbow_pos": {"column": "observation.state.elbow.pos", "unit": "percent", "range": RANGE, "sign": -1},
    }
    mapping = {"rate_hz": RATE, "longest_gap_s": 0.2, "columns": columns}
    (tmp_path / "mapping.yaml").write_text(json.dumps(mapping))
    assert command(tmp_path, monkeypatch, "--mapping mapping.yaml") == 0
    table = pq.read_table(tmp_path / "out" / "set" / "episode_000000.parquet")
    np.testing.assert_allclose(table["elbow_pos"].to_numpy(), -SESSIONS[0][0][:, 2], atol=1e-5)
    assert math.isclose(table["pan_pos"][0].as_py(), SESSIONS[0][0][0, 0], abs_tol=1e-5)


def test_percents_need_a_range(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any) -> None:
    version_2(tmp_path / "set", to_degrees)
    columns = {"pan_pos": {"column": "observation.state.pan.pos", "unit": "percent"}}
    (tmp_path / "mapping.yaml").write_text(json.dumps({"rate_hz": 50, "longest_gap_s": 0.2, "columns": columns}))
    assert command(tmp_path, monkeypatch, "--mapping mapping.yaml") == 1
    assert "give `unit: percent` and `range: [what 0 is, what 100 is]` together" in "".join(capfd.readouterr())
