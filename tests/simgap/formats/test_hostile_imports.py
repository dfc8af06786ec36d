"""Files that are damaged, or made to harm: they end in one line that explains, in bounded memory, never in a traceback.

What a recorder wrote with checksums is imported as it was recorded, or not at all.
"""

import json
import random
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import test_importing as given
import yaml
from given import scratch
from hypothesis import example, settings
from hypothesis import given as drawn
from hypothesis import strategies as st
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from simgap.formats.documents import read_json
from simgap.formats.importing import import_sessions
from simgap.formats.mapping import MappingFile, check_columns, read_mapping
from simgap.formats.recordings import read_recordings
from simgap.formats.tables import read_table
from simgap.simulators.spot import SCHEMA
from simgap.types import MOST_ROWS, ConfigError, RecordingError, SimgapError


def mapping_file(folder: Path, content: Any) -> MappingFile:
    path = folder / "mapping.yaml"
    path.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
    mapping = read_mapping(path)
    check_columns(path, mapping, SCHEMA, SCHEMA.columns)
    return mapping


def bring(path: Path, content: Any) -> list[Any]:
    """The recordings that a session becomes."""
    out = path.parent / "out"
    _, errors = import_sessions(path, "walk", mapping_file(path.parent, content), SCHEMA, out)
    if errors:
        raise errors[0]
    return read_recordings(out, SCHEMA, 1 / given.RATE)[0]


def refused(path: Path, content: Any) -> str:
    with pytest.raises(SimgapError) as error:
        bring(path, content)
    message = str(error.value)
    assert "\n" not in message
    assert str(path) in message
    assert len(message) < 1000
    return message


# Bags


@cache
def original(kind: str) -> dict[str, bytes]:
    """The files of a short session, by path below its folder."""
    name, write, _ = given.SOURCES[kind]
    with scratch() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(given, "STAMPS", given.STAMPS[:60])
        write(folder / name)
        return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def damage(content: bytes, rng: random.Random, cut: bool) -> bytes:
    if cut:
        return content[: rng.randrange(len(content))]
    changed = bytearray(content)
    for _ in range(rng.choice([1, 1, 1, 20])):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


@pytest.mark.parametrize("kind", ["mcap", "ros2", "ros2-mcap", "ros2-mcap-bare"])
@drawn(seed=st.integers(0, 2**32), cut=st.booleans())
@example(seed=304054, cut=False)  # a time of a ROS 2 bag becomes bytes
@settings(max_examples=40, deadline=None)
def test_a_damaged_bag_is_imported_or_explained(kind: str, seed: int, cut: bool) -> None:
    name, _, mapping = given.SOURCES[kind]
    rng, whole = random.Random(seed), original(kind)
    with scratch() as folder:
        victim = rng.choice(sorted(whole))
        for path, content in whole.items():
            (folder / path).parent.mkdir(exist_ok=True)
            (folder / path).write_bytes(damage(content, rng, cut) if path == victim else content)
        found, message = [], ""
        try:
            found = bring(folder / name, mapping)
        except SimgapError as error:
            message = str(error)
        assert found or str(folder / name) in message
        assert "\n" not in message
        if found and kind == "mcap":  # its writer writes checksums
            for path, content in whole.items():
                (folder / path).write_bytes(content)
            shutil.rmtree(folder / "out")
            for one, other in zip(found[0][1:], bring(folder / name, mapping)[0][1:], strict=True):
                np.testing.assert_array_equal(one, other)


def write_json(path: Path, messages: dict[str, bytes | str], **more: Any) -> None:
    """An MCAP file of four messages a topic, a second apart."""
    with path.open("wb") as file:
        writer = McapWriter(file, **more)
        writer.start()
        for topic, content in messages.items():
            channel = writer.register_channel(topic, "json", 0)
            for second in range(4):
                data = content if isinstance(content, bytes) else content.encode()
                writer.add_message(channel, second * 10**9, data, second * 10**9)
        writer.finish()


EVERY = {"rate_hz": 2, "longest_gap_s": 5,
         "columns": {n: {"topic": "/all", "field": "value"} for n in SCHEMA.columns[1:]}}  # fmt: skip


@pytest.mark.parametrize("chunked", [True, False])
def test_a_flipped_bit_in_a_number_is_no_measurement(tmp_path: Path, chunked: bool) -> None:
    path = tmp_path / "walk.mcap"
    write_json(path, {"/all": '{"value": 0.25}'}, use_chunking=chunked, compression=CompressionType.NONE,
               enable_data_crcs=True)  # fmt: skip
    (recording,) = bring(path, EVERY)
    assert (recording.state == 0.25).all()
    path.write_bytes(path.read_bytes().replace(b"0.25", b"0.35", 1))
    assert "CRC" in refused(path, EVERY)


DEEP = "[" * 100_000


@pytest.mark.parametrize(
    ("message", "words"),
    [
        ("{", "JSONDecodeError"),
        (DEEP, "RecursionError"),
        (b"\xff\xff\xff", "UnicodeDecodeError"),
        ('{"value": [[1, 2]]}', "must be a number"),
        ('{"value": null}', "has no 'value'"),
        ('{"value": 1%s}' % ("0" * 400), "must be a number"),
        ('{"value": NaN}', "is nan"),
        ('{"value": 1e300}', "is 1e+300"),
        ('{"value": {"x": 0, "y": 0, "z": "left", "w": 1}}', "must be a number"),
        ("[]", "has no 'value'"),
        ("3", "has no 'value'"),
        ('{"\\ud800": 1}', "has no 'value'"),
    ],
)  # fmt: skip
def test_a_json_message_of_another_kind_is_explained(tmp_path: Path, message: str | bytes, words: str) -> None:
    write_json(tmp_path / "walk.mcap", {"/all": message})
    assert words in refused(tmp_path / "walk.mcap", EVERY)


@pytest.mark.parametrize("stamp", ['{"sec": "now", "nanosec": 0}', '{"sec": 1e999, "nanosec": 0}', "[]", "7",
                                   '{"sec": 1%s, "nanosec": 0}' % ("0" * 30)])  # fmt: skip
def test_a_header_of_another_kind_is_explained(tmp_path: Path, stamp: str) -> None:
    write_json(tmp_path / "walk.mcap", {"/all": f'{{"header": {{"stamp": {stamp}}}, "value": 1}}'})
    assert "/all has " in refused(tmp_path / "walk.mcap", {**EVERY, "time": {"bag": "header"}})


def test_a_field_that_goes_on_beyond_a_number_is_explained(tmp_path: Path) -> None:
    write_json(tmp_path / "walk.mcap", {"/all": '{"value": 1.5, "list": [1]}'})
    for field, words in (("value.x", "'x' is not in a float"), ("list.²", "'²' is not in a list of 1"),
                         ("list.7", "'7' is not in a list of 1")):  # fmt: skip
        columns = {n: {"topic": "/all", "field": field} for n in SCHEMA.columns[1:]}
        assert words in refused(tmp_path / "walk.mcap", {**EVERY, "columns": columns})


RULE = "\n" + "=" * 80 + "\n"


@pytest.mark.parametrize(
    "definition",
    [
        "T again",
        f"Other a{RULE}MSG: t/Other\nT back",
        "Missing a",
        "float64[99999999999] value",
        "string[] value",
        f"Empty[1000000000] a{RULE}MSG: t/Empty\n",
        f"Empty[1000000000] a{RULE}MSG: t/Empty\nuint8[0] x",
        "float64[-1] value",
        "int8[] value [" + "," * 20_000,
        "\0\x7f === :",
        "float64 val",
        "",
    ],
)
def test_a_ros_definition_made_to_harm_is_explained(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], definition: str
) -> None:
    with (tmp_path / "walk.mcap").open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        schema = writer.register_schema("t/T", "ros2msg", definition.encode())
        channel = writer.register_channel("/all", "cdr", schema)
        for second in range(4):
            writer.add_message(channel, second * 10**9, b"\0\1\0\0" + b"\xff\xff\xff\x7f" * 10, second * 10**9)
        writer.finish()
    refused(tmp_path / "walk.mcap", EVERY)
    assert not capfd.readouterr().err, "a library that prints what it raises"


def test_a_chunk_that_expands_beyond_memory_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("simgap.formats.bag_messages.RECORD_LIMIT", 2**20)
    for compression in (CompressionType.ZSTD, CompressionType.LZ4):
        write_json(tmp_path / "walk.mcap", {"/all": '{"value": 1}' + " " * 2**21}, compression=compression)
        assert (tmp_path / "walk.mcap").stat().st_size < 2**17
        assert "a chunk has" in refused(tmp_path / "walk.mcap", EVERY)


# Tables


def measured(work: str) -> int:
    """Bytes by which `work`, run in a process of its own, raises the most memory that it held."""
    script = f"""
import resource
from pathlib import Path
from simgap.types import RecordingError
from simgap.formats.tables import read_table
held = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
before = held()
{work}
print(1024 * (held() - before))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return int(done.stdout)


def test_a_long_csv_takes_no_more_memory_than_its_numbers(tmp_path: Path) -> None:
    path, rows = tmp_path / "walk.csv", 100_000
    path.write_text(
        "a,b," + ",".join(f"note{i}" for i in range(50)) + "\n" + ("0.125,7.5" + ",text" * 50 + "\n") * rows
    )
    taken = measured(f"found = read_table(Path({str(path)!r}), ['a', 'b'])\nassert len(found['a']) == {rows}")
    assert taken < path.stat().st_size, "the text itself is kept"


@pytest.mark.parametrize("begin", ["", "a,b\n1,2\n", 'a,b\n1,"'])
def test_a_csv_without_an_end_of_line_takes_no_memory(tmp_path: Path, begin: str) -> None:
    path = tmp_path / "walk.csv"
    with path.open("wb") as file:
        file.write(begin.encode())
        file.truncate(2**30)
    work = f"""
try:
    read_table(Path({str(path)!r}), ["a", "b"])
except RecordingError as error:
    assert "walk.csv" in str(error) and "characters" in str(error) or "no CSV" in str(error), error
else:
    raise AssertionError
"""
    assert measured(work) < 64 * 2**20


def test_quotes_that_go_on_over_lines_are_one_row_that_ends(tmp_path: Path) -> None:
    path = tmp_path / "walk.csv"
    path.write_text("a,b\n" + '"1\n",' * 400_000)
    with pytest.raises(RecordingError, match="a row has more than 1,048,576 characters"):
        read_table(path, ["a", "b"])


def test_a_damaged_parquet_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "walk.parquet"
    pq.write_table(pa.table({"a": [1.0, 2.0]}), path)
    content = bytearray(path.read_bytes())
    content[4] ^= 1  # the first page's header, of which Arrow says that in two lines
    path.write_bytes(content)
    with pytest.raises(RecordingError) as error:
        read_table(path, ["a"])
    assert "\n" not in str(error.value)
    assert "is no whole Parquet file (Couldn't deserialize thrift" in str(error.value)


def test_a_table_of_too_many_rows_is_refused(tmp_path: Path) -> None:
    (tmp_path / "walk.csv").write_text("a\n" + "1\n" * (MOST_ROWS + 1))
    pq.write_table(pa.table({"a": np.zeros(MOST_ROWS + 1)}), tmp_path / "walk.parquet")
    for name in ("walk.csv", "walk.parquet"):
        with pytest.raises(RecordingError, match=f"{name}: has more than 2,000,000 rows.*Split it"):
            read_table(tmp_path / name, ["a"])
    (tmp_path / "walk.csv").write_text("a\n" + "1\n" * MOST_ROWS)
    assert len(read_table(tmp_path / "walk.csv", ["a"])["a"]) == MOST_ROWS


@pytest.mark.parametrize("stamp", [4e9, 1e15])
def test_a_stamp_far_in_the_future_is_named(tmp_path: Path, stamp: float) -> None:
    table = given.table()
    table.loc[len(table) - 1, "stamp_ms"] = stamp
    table.to_csv(tmp_path / "walk.csv", index=False)
    message = refused(tmp_path / "walk.csv", {**given.TABLE, "rate_hz": 1000.0, "longest_gap_s": 1e15})
    assert f"has the time stamp {stamp / 1000:g} s, after 7.96 s" in message
    assert "a session has at most 2,000,000" in message
    # Where the pause is one, the session is cut there and the stamp is alone.
    assert len(bring(tmp_path / "walk.csv", given.TABLE)) == 1


def test_a_rate_that_makes_too_many_rows_is_named(tmp_path: Path) -> None:
    table = given.table()
    table["stamp_ms"] *= 1000
    table.to_csv(tmp_path / "walk.csv", index=False)
    message = refused(tmp_path / "walk.csv", {**given.TABLE, "rate_hz": 1000.0, "longest_gap_s": 100.0})
    assert "1000 Hz would make 7,980,001 rows; a session has at most 2,000,000. Lower rate_hz" in message


def test_a_stamp_that_is_no_number_is_named(tmp_path: Path) -> None:
    for value, shown in ((np.nan, "nan"), (np.inf, "inf")):
        table = given.table()
        table.loc[17, "stamp_ms"] = value
        table.to_csv(tmp_path / "walk.csv", index=False)
        assert f"value 18 of 400 has the time stamp {shown}" in refused(tmp_path / "walk.csv", given.TABLE)


# Mapping files

BOMB = "a0: &a0 {x: 1, y: 2}\n" + "".join(
    f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 9)}]}}\n" for i in range(1, 10)
)


def changed(change: Callable[[dict[str, Any]], Any]) -> str:
    content = json.loads(json.dumps(given.TABLE))
    change(content)
    return yaml.safe_dump(content)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (BOMB, "line 2: *a0 repeats another part"),
        ("x: " + DEEP, "nested deeper than 20 levels"),
        ("x: " + "{a: " * 5000, "nested deeper than 20 levels"),
        ("x: " + "1" * 2_000_000, "more than 1,048,576 bytes"),
        ("rate_hz: " + "1" * 10_000, "line 1: rate_hz holds a whole number of 10,000 characters; it may have 100"),
        ("rate_hz: 0x" + "f" * 5000, "line 1: rate_hz holds a whole number of 5,002 characters"),
        ("columns:\n  0x" + "f" * 5000 + ": 1", "line 2: columns holds a whole number of 5,002 characters"),
        ("rate_hz: [", "line 1: expected the node content"),
        ("\0", "is no YAML"),
        ("!!python/object/apply:os.system [ls]", "line 1: could not determine a constructor"),
        ("", "Input should be a valid dictionary"),
        ("[]", "Input should be a valid dictionary"),
        ("? [1]\n: 2", "line 1: found unhashable key"),
        ('"\\ud800": 1', "values are wrong"),
        (changed(lambda m: m.update(rate_hz="fast")), "rate_hz: Input should be a valid number"),
        (changed(lambda m: m.update(rate_hz=float("nan"))), "rate_hz"),
        (changed(lambda m: m.update(rate_hz=True)), "rate_hz: Input should be a number; it is True"),
        (changed(lambda m: m.update(time={"column": "stamp_ms", "unit": "h"})), ": time.unit: 'h' cannot be converted"),
        *(
            (
                changed(lambda m, ends=ends: m["columns"]["ee_x"].update(unit="percent", range=ends)),
                f"columns.ee_x{words}",
            )
            for ends, words in (
                ([0.0, float("inf")], ".range.1: Input should be a finite number"),
                ([float("nan"), 1.0], ".range.0: Input should be a finite number"),
                ([1.0, 1.0], ": `range` must be two different numbers"),
                ([-1e308, 1e308], ": `range` must be two different numbers"),
            )
        ),
        (changed(lambda m: m.update(rate_hz=1e9)), "rate_hz: Input should be less than or equal to 10000"),
        (changed(lambda m: m.update(longest_gap_s=float("inf"))), "longest_gap_s: Input should be a finite number"),
        (changed(lambda m: m.update(columns=[1])), "columns: Input should be a valid dictionary"),
        (changed(lambda m: m["columns"].update(ee_x=7)), "columns.ee_x"),
        (changed(lambda m: m["columns"]["ee_x"].update(sign=2)), "columns.ee_x.sign"),
        (changed(lambda m: m["columns"]["ee_x"].update(column=["(a+)+$"])), "columns.ee_x.column"),
        (changed(lambda m: m.update({f"key{i}": 1 for i in range(5000)})), "and 4981 more"),
    ],
)
def test_a_hostile_mapping_is_explained(tmp_path: Path, content: str, words: str) -> None:
    with pytest.raises(ConfigError) as error:
        mapping_file(tmp_path, content)
    assert words in str(error.value)
    assert str(error.value).startswith(str(tmp_path / "mapping.yaml"))
    assert len(str(error.value)) < 3000


def test_json_that_nests_deeply_is_explained(tmp_path: Path) -> None:
    (tmp_path / "some.json").write_text(DEEP)
    with pytest.raises(SimgapError, match="is no whole JSON file"):
        read_json(tmp_path / "some.json")
