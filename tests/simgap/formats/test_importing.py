"""The same drive as an MCAP file, a ROS 2 bag, a CSV and a Parquet file: each becomes the recording it was made of."""

import json
import math
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from simgap import resample
from simgap.cli.importing import import_recordings
from simgap.formats.recordings import read_recordings
from simgap.resample import Stream
from simgap.simulators.spot import SCHEMA
from simgap.types import ConfigError, Recording, RecordingError, SimgapError

RATE, SECONDS = 20.0, 8.0
EPOCH_NS = 1_780_000_000_000_000_000


def motion(time: np.ndarray) -> dict[str, np.ndarray]:
    """A base on a circle of 1 m at 0.5 rad/s that turns with it, its hand 0.6 m ahead and 0.1 m to the left."""
    yaw = 0.5 * time + np.pi / 2
    base_x, base_y = np.cos(0.5 * time), np.sin(0.5 * time)
    hand = (0.6 * np.cos(yaw) - 0.1 * np.sin(yaw), 0.6 * np.sin(yaw) + 0.1 * np.cos(yaw))
    state = {
        "base_x": base_x, "base_y": base_y, "base_yaw": (yaw + np.pi) % (2 * np.pi) - np.pi,
        "base_vx": -0.5 * base_y, "base_vy": 0.5 * base_x, "base_wz": np.full_like(time, 0.5),
        "ee_x": base_x + hand[0], "ee_y": base_y + hand[1], "ee_z": 0.5 + 0.1 * np.sin(time),
        "ee_vx": -0.5 * base_y - 0.5 * hand[1], "ee_vy": 0.5 * base_x + 0.5 * hand[0], "ee_vz": 0.1 * np.cos(time),
    }  # fmt: skip
    commands = {f.name: np.round(np.sin(time * (k + 1)), 1) for k, f in enumerate(SCHEMA.command)}
    return {**state, **commands}


STAMPS = np.arange(0, SECONDS, 1 / 50)


def mapping(columns: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"rate_hz": RATE, "longest_gap_s": 0.2, "columns": columns, **more}


BAG: dict[str, Any] = {
    "base_x": {"topic": "/odom", "field": "pose.pose.position.x"},
    "base_y": {"topic": "/odom", "field": "pose.pose.position.y"},
    "base_yaw": {"topic": "/odom", "field": "pose.pose.orientation"},
    "base_vx": {"topic": "/odom", "field": "twist.twist.linear.x", "frame": "body"},
    "base_vy": {"topic": "/odom", "field": "twist.twist.linear.y", "frame": "body"},
    "base_wz": {"topic": "/odom", "field": "twist.twist.angular.z", "unit": "deg/s"},
    "ee_x": {"topic": "/hand", "field": "data.0", "unit": "mm", "frame": "body"},
    "ee_y": {"topic": "/hand", "field": "data.1", "unit": "mm", "frame": "body"},
    "ee_z": {"topic": "/hand", "field": "data.2", "unit": "mm"},
    "ee_vx": {"topic": "/hand", "field": "data.3"},
    "ee_vy": {"topic": "/hand", "field": "data.4"},
    "ee_vz": {"topic": "/hand", "field": "data.5", "sign": -1},
    **{f.name: {"topic": "/cmd", "field": f"data.{k}"} for k, f in enumerate(SCHEMA.command)},
}  # fmt: skip


def messages() -> list[tuple[int, str, dict[str, Any]]]:
    """(stamp [ns], topic, content), as a robot of other conventions would publish them."""
    columns, found = motion(STAMPS), []
    for i, t in enumerate(STAMPS):
        row = {name: float(values[i]) for name, values in columns.items()}
        c, s = math.cos(row["base_yaw"]), math.sin(row["base_yaw"])
        turned = lambda x, y, c=c, s=s: (c * x + s * y, -s * x + c * y)  # noqa: E731
        vx, vy = turned(row["base_vx"], row["base_vy"])
        hx, hy = turned(row["ee_x"] - row["base_x"], row["ee_y"] - row["base_y"])
        ns = EPOCH_NS + round(t * 1e9)
        found.append((ns, "/odom", {
            "pose": {"pose": {"position": {"x": row["base_x"], "y": row["base_y"], "z": 0.0}, "orientation": {
                "x": 0.0, "y": 0.0, "z": math.sin(row["base_yaw"] / 2), "w": math.cos(row["base_yaw"] / 2)}}},
            "twist": {"twist": {"linear": {"x": vx, "y": vy, "z": 0.0},
                                "angular": {"x": 0.0, "y": 0.0, "z": math.degrees(row["base_wz"])}}},
        }))  # fmt: skip
        hand = [1000 * hx, 1000 * hy, 1000 * row["ee_z"], row["ee_vx"], row["ee_vy"], -row["ee_vz"]]
        found.append((ns, "/hand", {"data": hand}))
        found.append((ns, "/cmd", {"data": [row[f.name] for f in SCHEMA.command]}))
    return found


def write_mcap(path: Path, encoding: str = "json") -> None:
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channels = {t: writer.register_channel(t, encoding, schema) for t in ("/odom", "/hand", "/cmd")}
        for ns, topic, content in messages():
            writer.add_message(channels[topic], ns, json.dumps(content).encode(), ns)
        writer.finish()


def write_ros2(path: Path, storage: StoragePlugin) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = {"/odom": "nav_msgs/msg/Odometry", "/hand": "std_msgs/msg/Float64MultiArray",
             "/cmd": "std_msgs/msg/Float64MultiArray"}  # fmt: skip
    types = store.types
    with BagWriter(path, version=9, storage_plugin=storage) as writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()}
        for ns, topic, content in messages():
            if topic == "/odom":
                made = _odometry(types, ns, content)
            else:
                layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
                made = types[kinds[topic]](layout=layout, data=np.array(content["data"]))
            writer.write(connections[topic], ns, store.serialize_cdr(made, kinds[topic]))


def write_bare_mcap(path: Path) -> None:
    """What a ROS 2 recorder wrote, without its folder and metadata.yaml."""
    write_ros2(path.parent / "bag", StoragePlugin.MCAP)
    (recorded,) = (path.parent / "bag").glob("*.mcap")
    recorded.rename(path)
    shutil.rmtree(path.parent / "bag")


def _odometry(types: Any, ns: int, content: dict[str, Any]) -> Any:
    stamp = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
    pose, twist = content["pose"]["pose"], content["twist"]["twist"]
    vector, zeros = types["geometry_msgs/msg/Vector3"], np.zeros(36)
    return types["nav_msgs/msg/Odometry"](
        header=types["std_msgs/msg/Header"](stamp=stamp, frame_id="odom"), child_frame_id="base",
        pose=types["geometry_msgs/msg/PoseWithCovariance"](covariance=zeros, pose=types["geometry_msgs/msg/Pose"](
            position=types["geometry_msgs/msg/Point"](**pose["position"]),
            orientation=types["geometry_msgs/msg/Quaternion"](**pose["orientation"]))),
        twist=types["geometry_msgs/msg/TwistWithCovariance"](covariance=zeros, twist=types["geometry_msgs/msg/Twist"](
            linear=vector(**twist["linear"]), angular=vector(**twist["angular"]))),
    )  # fmt: skip


def table() -> pd.DataFrame:
    """The same with a clock in milliseconds and blanks where the commands' slower sensor has no value."""
    rows = pd.DataFrame({"stamp_ms": 1000 * STAMPS, **motion(STAMPS)})
    rows.loc[rows.index % 2 == 1, "cmd_ee_vz"] = np.nan
    return rows


TABLE = mapping({n: {"column": n} for n in SCHEMA.columns[1:]}, time={"column": "stamp_ms", "unit": "ms"})


def imported(folder: Path, source: Path, given: dict[str, Any]) -> list[Recording]:
    (folder / "mapping.yaml").write_text(yaml.safe_dump(given))
    import_recordings(source, folder / "mapping.yaml", folder / "out", "spot")
    return read_recordings(folder / "out", SCHEMA, 1 / RATE)[0]


SOURCES: dict[str, tuple[str, Callable[[Path], Any], dict[str, Any]]] = {
    "mcap": ("walk.mcap", write_mcap, mapping(BAG)),
    "ros2": ("walk", lambda path: write_ros2(path, StoragePlugin.SQLITE3), mapping(BAG)),
    "ros2-mcap": ("walk", lambda path: write_ros2(path, StoragePlugin.MCAP), mapping(BAG)),
    "ros2-mcap-bare": ("walk.mcap", write_bare_mcap, mapping(BAG, time={"bag": "received"})),
    "csv": ("walk.csv", lambda path: table().to_csv(path, index=False), TABLE),
    "parquet": ("walk.parquet", lambda path: table().to_parquet(path), TABLE),
}


@pytest.mark.parametrize("kind", SOURCES)
def test_a_session_becomes_the_recording_it_was_made_of(tmp_path: Path, kind: str) -> None:
    name, write, given = SOURCES[kind]
    write(tmp_path / name)
    (recording,) = imported(tmp_path, tmp_path / name, given)
    assert recording.name == "walk"
    np.testing.assert_allclose(np.diff(recording.time_s), 1 / RATE)
    assert recording.time_s[-1] == pytest.approx(STAMPS[-1], abs=1 / RATE)
    expected = motion(recording.time_s)
    for i, field in enumerate(SCHEMA.state):
        # Between stamps 0.02 s apart a line leaves these curves by less than a ten-thousandth.
        gap = recording.state[:, i] - expected[field.name]
        gap = (gap + np.pi) % (2 * np.pi) - np.pi if field.kind == "angle" else gap
        np.testing.assert_allclose(gap, 0, atol=1e-4, err_msg=field.name)
    sent = motion(STAMPS)["cmd_base_vx"]
    last = np.searchsorted(STAMPS, recording.time_s + 1e-9, side="right") - 1
    np.testing.assert_allclose(recording.command[:, 0], sent[last])


def test_a_session_is_cut_where_the_state_pauses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = table()
    rows = rows[(rows.stamp_ms < 3000) | (rows.stamp_ms > 4000)]
    (tmp_path / "in" / "deep").mkdir(parents=True)
    rows.to_csv(tmp_path / "in" / "deep" / "walk.csv", index=False)
    found = imported(tmp_path, tmp_path / "in", TABLE)
    assert [r.name for r in found] == ["deep/walk_1", "deep/walk_2"]
    assert found[0].time_s[-1] + found[1].time_s[-1] < SECONDS - 1
    assert "besides" not in capsys.readouterr().out
    imported(tmp_path, tmp_path / "in", {**TABLE, "longest_gap_s": 2.0})
    assert "holds deep/walk_1, deep/walk_2 as well, which this import did not write" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: m["columns"].pop("ee_x"), "lacks ee_x"),
        (lambda m: m["columns"].update(arm={"column": "arm"}), "has the unknown arm"),
        (lambda m: m["columns"]["ee_x"].update(unit="inch"), "columns.ee_x.unit: 'inch' cannot be converted to m"),
        (lambda m: m["columns"]["ee_x"].update(column="", topic="/hand"), "give topic and field"),
        (lambda m: m["columns"]["ee_x"].update(frame="body"), "x and y must be in the same frame"),
        (lambda m: m["columns"]["cmd_ee_vx"].update(frame="world"), "commands are in the frame of the schema"),
        (
            lambda m: m["columns"]["ee_x"].update(column="ee_q"),
            r"column ee_q is missing; nearest to ee_q is ee_\w\. Not used: ee_x\.",
        ),
        (lambda m: m.update(rate_hz=0), "rate_hz: .*greater than 0"),
        (lambda m: m.pop("time"), "names no|has no `column` for time_s"),
        (lambda m: m.update(longest_gap_s=0.001), "no part of it without a gap"),
    ],
)
def test_a_wrong_mapping_is_explained(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: Callable[[dict[str, Any]], Any], words: str
) -> None:
    table().to_csv(tmp_path / "walk.csv", index=False)
    given = json.loads(json.dumps(TABLE))
    change(given)
    with pytest.raises(SimgapError) as error:
        imported(tmp_path, tmp_path / "walk.csv", given)
    assert re.search(words, str(error.value) + capsys.readouterr().out)


def test_a_bag_that_lacks_a_topic_or_a_field_or_is_damaged_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_mcap(tmp_path / "walk.mcap")
    for columns, words in (
        ({**BAG, "ee_x": {"topic": "/arm", "field": "x"}}, "the topic /arm is missing; there are /cmd, /hand, /odom"),
        ({**BAG, "ee_x": {"topic": "/odom", "field": "pose.pose.x"}}, "'x' is not in position, orientation"),
        ({**BAG, "ee_x": {"topic": "/hand", "field": "data"}}, "must be a number, or a quaternion"),
    ):
        with pytest.raises(RecordingError):
            imported(tmp_path, tmp_path / "walk.mcap", mapping(columns))
        assert words in capsys.readouterr().out
    write_mcap(tmp_path / "walk.mcap", "cdr")
    with pytest.raises(RecordingError):
        imported(tmp_path, tmp_path / "walk.mcap", mapping(BAG))
    assert "has messages in cdr, defined in jsonschema; JSON, and ROS 2 messages" in capsys.readouterr().out
    write_mcap(tmp_path / "walk.mcap")
    whole = (tmp_path / "walk.mcap").read_bytes()
    (tmp_path / "walk.mcap").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RecordingError):
        imported(tmp_path, tmp_path / "walk.mcap", mapping(BAG))
    assert "cannot be read as a bag" in capsys.readouterr().out


def test_streams_without_time_in_common_are_told_of() -> None:
    streams = {name: Stream(np.arange(5.0), np.zeros(5)) for name in SCHEMA.columns[1:]}
    late = {**streams, "ee_x": Stream(np.arange(5.0) + 10, np.zeros(5))}
    with pytest.raises(RecordingError, match="no time in common: ee_x begins at 10"):
        resample.align(SCHEMA, late, 10.0, 2.0)


@given(*(st.floats(-most, most) for most in (3.1, 1.5, 3.1)))
def test_angles_of_a_quaternion_turn_as_it_does(yaw: float, pitch: float, roll: float) -> None:
    quaternion = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat()
    np.testing.assert_allclose(resample.angles(*quaternion), [yaw, pitch, roll], atol=1e-6)


@pytest.mark.parametrize(
    ("unit", "wanted", "value"), [("rpm", "rad/s", 2 * np.pi / 60), ("m", "m", 1), ("ns", "s", 1e-9)]
)
def test_units_are_converted(unit: str, wanted: str, value: float) -> None:
    assert resample.factor(unit, wanted) == pytest.approx(value)


def test_a_unit_of_another_quantity_is_refused() -> None:
    with pytest.raises(ConfigError, match="'deg' cannot be converted to m; known are m, cm, mm"):
        resample.factor("deg", "m")


PRINTED = {
    "/odom": "nav_msgs/msg/Odometry", "/hand/pose": "geometry_msgs/msg/PoseStamped",
    "/hand/twist": "geometry_msgs/msg/TwistStamped", "/cmd_vel": "geometry_msgs/msg/Twist",
    "/hand/cmd": "std_msgs/msg/Float64MultiArray",
}  # fmt: skip
"""What is on the topics of the mapping in the docs. Commands have no header."""


def write_printed(path: Path, late_ns: int) -> None:
    """The drive as the mapping of the docs has it; messages come in `late_ns` after they are stamped or sent."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types, zeros = store.types, (0.0, 0.0, 0.0)

    def of(name: str, *values: Any) -> Any:
        return types[name](*values)

    def twist(linear: tuple[float, ...], angular: tuple[float, ...] = zeros) -> Any:
        vector = "geometry_msgs/msg/Vector3"
        return of("geometry_msgs/msg/Twist", of(vector, *linear), of(vector, *angular))

    with BagWriter(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in PRINTED.items()}
        for ns, topic, content in messages():
            header = of("std_msgs/msg/Header", of("builtin_interfaces/msg/Time", ns // 10**9, ns % 10**9), "")
            if topic == "/odom":
                odom = {**content["twist"]["twist"], "angular": {"x": 0.0, "y": 0.0, "z": 0.5}}  # the docs' are rad/s
                made = {topic: _odometry(types, ns, {**content, "twist": {"twist": odom}})}
            elif topic == "/hand":
                x, y, z, vx, vy, vz = content["data"]
                yaw = float(motion(np.array([(ns - EPOCH_NS) * 1e-9]))["base_yaw"][0])
                own = (math.cos(yaw) * vx + math.sin(yaw) * vy, -math.sin(yaw) * vx + math.cos(yaw) * vy, -vz)
                at = of("geometry_msgs/msg/Point", x / 1000, y / 1000, z)
                pose = of("geometry_msgs/msg/Pose", at, of("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0))
                made = {"/hand/pose": of(PRINTED["/hand/pose"], header, pose),
                        "/hand/twist": of(PRINTED["/hand/twist"], header, twist(own))}  # fmt: skip
            else:
                vx, vy, wz, *hand = content["data"]
                layout = of("std_msgs/msg/MultiArrayLayout", [], 0)
                hand = np.array([hand[0], hand[1], -hand[2]])
                made = {"/cmd_vel": twist((vx, vy, 0.0), (0.0, 0.0, wz)),
                        "/hand/cmd": of(PRINTED["/hand/cmd"], layout, hand)}  # fmt: skip
            for name, message in made.items():
                received = ns + (late_ns if "cmd" not in name else 0)
                writer.write(connections[name], received, store.serialize_cdr(message, PRINTED[name]))


def test_the_mapping_of_the_docs_works_as_printed(tmp_path: Path) -> None:
    """Under its name, on a bag with the messages it is for. States are stamped, and come in late; commands are not."""
    page = (Path(__file__).parents[3] / "docs" / "tutorials" / "own_robot.md").read_text()
    (printed,) = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    (tmp_path / "mapping.yaml").write_text(printed)
    write_printed(tmp_path / "walk", late_ns=200_000_000)
    import_recordings(tmp_path / "walk", tmp_path / "mapping.yaml", tmp_path / "out", "spot")
    ((recording,), errors) = read_recordings(tmp_path / "out", SCHEMA, 1 / 15)
    assert not errors
    time = np.arange(len(recording.time_s)) / 15
    np.testing.assert_allclose(recording.time_s, time, atol=1e-9)
    expected = motion(time)
    for i, field in enumerate(SCHEMA.state):
        gap = recording.state[:, i] - expected[field.name]
        gap = (gap + np.pi) % (2 * np.pi) - np.pi if field.kind == "angle" else gap
        np.testing.assert_allclose(gap, 0, atol=2e-4, err_msg=field.name)
    last = np.searchsorted(STAMPS, time + 1e-9, side="right") - 1
    for i, field in enumerate(SCHEMA.command):
        np.testing.assert_allclose(recording.command[:, i], motion(STAMPS)[field.name][last], err_msg=field.name)


def test_stamps_of_a_column_are_those_of_a_bags_messages(tmp_path: Path) -> None:
    columns = {**TABLE["columns"], "ee_x": {"column": "ee_x", "time": "header"}}
    with pytest.raises(ConfigError, match="`time` is of a bag's messages"):
        imported(tmp_path, tmp_path / "walk.csv", {**TABLE, "columns": columns})
    write_ros2(tmp_path / "walk", StoragePlugin.MCAP)
    columns = {**BAG, "cmd_ee_vx": {**BAG["cmd_ee_vx"], "time": "header"}}
    with pytest.raises(RecordingError):
        imported(tmp_path, tmp_path / "walk", mapping(columns))


def test_the_commands_are_there_to_be_typed(tmp_path: Path) -> None:
    """From a bag to a checked recording, with the installed command."""
    write_mcap(tmp_path / "walk.mcap")
    (tmp_path / "mapping.yaml").write_text(yaml.safe_dump(mapping(BAG)))
    simgap = Path(sys.executable).parent / "simgap"
    for arguments in (["import", "walk.mcap", "--mapping", "mapping.yaml", "--out", "mine"], ["check", "mine"]):
        done = subprocess.run([simgap, *arguments], cwd=tmp_path, capture_output=True, text=True, timeout=200)
        assert done.returncode == 0, done.stdout + done.stderr
    assert "1 sessions" in done.stdout
