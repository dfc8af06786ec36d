"""The door to data files: what is written reads back the same, and what cannot be used says why and harms nothing."""

import csv
import dataclasses
import math
import os
import pickle
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from given import fitted_spot, scratch, spot_recordings
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from simgap.diagnosis.likelihood.scales import measure
from simgap.effects import CATALOGUE
from simgap.effects.augmented import Augmented
from simgap.effects.effect import Scales
from simgap.effects.regime import Acting, Regime
from simgap.formats.arrays import load_arrays, save_arrays
from simgap.formats.documents import read_json, write_json, write_table, write_text
from simgap.formats.effects import SCALES
from simgap.formats.folders import remove_folder
from simgap.formats.pickles import PICKLE_LIMIT
from simgap.formats.recordings import LARGEST, read_recordings, write_recording
from simgap.models import BNN, FittedSimulator, FittedSpot
from simgap.prediction import Model, predict
from simgap.recordings import normalisation
from simgap.residual.model import ResidualModel
from simgap.simulators.augmented import AugmentedSimulator
from simgap.simulators.spot import SCHEMA, Spot
from simgap.types import MOST_ROWS, Recording, RecordingError, SimgapError
from tasks.files.digests import digest_of
from tasks.files.models import load_model, save_model

STEP = 1 / 15
Table = dict[str, list[Any]]
quick = settings(max_examples=30, deadline=None)


def session(rows: int = 6, name: str = "walk") -> Recording:
    rng = np.random.default_rng(rows)
    return Recording(name, np.arange(rows) * STEP, rng.uniform(-1, 1, (rows, 12)), rng.uniform(-1, 1, (rows, 6)))


def table(rows: int = 6) -> Table:
    s = session(rows)
    values = np.column_stack([s.time_s, s.state, s.command])
    return {name: column.tolist() for name, column in zip(SCHEMA.columns, values.T, strict=True)}


def changed(column: str, row: int, value: object) -> Table:
    """A table with one value changed, the rows counted from 1."""
    values = table()
    values[column][row - 1] = value
    return values


def csv_text(columns: Table) -> str:
    rows = zip(*columns.values(), strict=True)
    return "\n".join(",".join(str(value) for value in row) for row in [tuple(columns), *rows]) + "\n"


def read_one(path: Path, step: float = STEP) -> Recording:
    (recording,), errors = read_recordings(path.parent, SCHEMA, step, [path.name])
    assert not errors
    return recording


def assert_refused(path: Path, *words: str) -> None:
    """The file cannot be used, its message has these words, and a good session beside it is read all the same."""
    good = write_recording(path.parent, session(name="good"), SCHEMA)
    recordings, errors = read_recordings(path.parent, SCHEMA, STEP, [path.name, good.name])
    assert [r.name for r in recordings] == ["good"]
    assert len(errors) == 1
    for word in (str(path), *words):
        assert word in str(errors[0])


def assert_same(a: Recording, b: Recording) -> None:
    assert a.name == b.name
    for one, other in zip(a[1:], b[1:], strict=True):
        np.testing.assert_array_equal(one, other)


# Sessions written and read


def floats(*shape: int) -> st.SearchStrategy[np.ndarray]:
    return hnp.arrays(np.float64, shape, elements=st.floats(-LARGEST, LARGEST))


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    rows = draw(st.integers(4, 8))
    # What a file's name may hold, less the letters that no file system takes.
    letters = st.text(st.characters(exclude_characters="/\0", exclude_categories=["Cs"]), min_size=1, max_size=9)
    parts = draw(st.lists(letters.filter(lambda part: part not in (".", "..")), min_size=1, max_size=3))
    time_s = np.cumsum(draw(hnp.arrays(np.float64, rows, elements=st.floats(1e-3, 1e3))))
    state = draw(floats(rows, 12))
    state[:, 2] = draw(hnp.arrays(np.float64, rows, elements=st.floats(-math.pi, math.pi)))
    return Recording("/".join(parts), time_s, state, draw(floats(rows, 6)))


@given(recordings())
@quick
def test_a_written_session_reads_back_the_same(recording: Recording) -> None:
    with scratch() as folder:
        path = write_recording(folder, recording, SCHEMA)
        assert path == folder / f"{recording.name}.parquet"
        (read,), errors = read_recordings(folder, SCHEMA, STEP)
    assert not errors
    assert_same(read, recording)


@given(recordings())
@quick
def test_csv_loses_no_digit(recording: Recording) -> None:
    values = np.column_stack([recording.time_s, recording.state, recording.command])
    with scratch() as folder:
        path = folder / "walk.csv"
        path.write_text(csv_text({n: c.tolist() for n, c in zip(SCHEMA.columns, values.T, strict=True)}))
        assert_same(read_one(path), recording._replace(name="walk"))


@pytest.mark.parametrize("name", ["../walk", "day/../../walk", "/tmp/walk", "..", ".", "", "day//walk", "day/", "a\0b"])
def test_a_name_that_leaves_the_folder_is_refused(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "inside"
    with pytest.raises(RecordingError, match="Rename the session"):
        write_recording(folder, session(name=name), SCHEMA)
    assert not list(tmp_path.iterdir())


def test_sessions_come_sorted_and_once_whatever_the_patterns(tmp_path: Path) -> None:
    for name in ("b/one", "a/two", "a/one", "c"):
        write_recording(tmp_path, session(name=name), SCHEMA)
    (tmp_path / "a" / "three.CSV").write_text(csv_text(table()))
    (tmp_path / "a" / "notes.txt").write_text("no session")
    (tmp_path / "folder.csv").mkdir()

    def names(*patterns: str) -> list[str]:
        return [r.name for r in read_recordings(tmp_path, SCHEMA, STEP, patterns)[0]]

    assert names("**/*") == names("**/*", "a/*") == ["a/one", "a/three", "a/two", "b/one", "c"]
    assert names("b/*", "a/*one*") == ["a/one", "b/one"]
    assert [r.name for r in read_recordings(tmp_path, SCHEMA, STEP)[0]] == names("**/*")


def test_a_folder_without_sessions_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"nowhere: there is no such folder\. Give"):
        read_recordings(tmp_path / "nowhere", SCHEMA, STEP)
    with pytest.raises(RecordingError, match=r"no file matches day/\* .* Change the patterns"):
        read_recordings(tmp_path, SCHEMA, STEP, ["day/*"])


@pytest.mark.parametrize("pattern", ["../*", "/tmp/*", ""])
def test_a_pattern_stays_in_the_folder(tmp_path: Path, pattern: str) -> None:
    with pytest.raises(RecordingError, match=r"the pattern '.*' cannot be used"):
        read_recordings(tmp_path, SCHEMA, STEP, [pattern])


def test_where_all_are_unusable_every_reason_is_given(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("")
    (tmp_path / "b.parquet").write_text("")
    with pytest.raises(RecordingError, match="none of its 2 session files") as error:
        read_recordings(tmp_path, SCHEMA, STEP)
    assert "a.csv" in str(error.value)
    assert "b.parquet" in str(error.value)


def test_two_files_cannot_be_one_session(tmp_path: Path) -> None:
    (tmp_path / "walk.csv").write_text(csv_text(table(5)))
    write_recording(tmp_path, session(6), SCHEMA)
    (recording,), (error,) = read_recordings(tmp_path, SCHEMA, STEP)
    assert len(recording.time_s) == 5
    assert "walk.parquet: the session walk is in" in str(error)
    assert "walk.csv" in str(error)


def test_bad_sessions_leave_the_others_intact(tmp_path: Path) -> None:
    good = [session(rows, f"good_{rows}") for rows in (5, 6, 7)]
    for recording in good:
        write_recording(tmp_path, recording, SCHEMA)
    (tmp_path / "a.csv").write_text(csv_text(changed("ee_z", 2, "up")))
    (tmp_path / "go.parquet").write_bytes(b"PAR1")
    (tmp_path / "h.pickle").write_bytes(pickle.dumps(os.system))
    (tmp_path / "i.csv").symlink_to(tmp_path / "nowhere.csv")
    recordings, errors = read_recordings(tmp_path, SCHEMA, STEP)
    for read, written in zip(recordings, good, strict=True):
        assert_same(read, written)
    assert [Path(str(e).split(": ")[0]).name for e in errors] == ["a.csv", "go.parquet", "h.pickle", "i.csv"]


# CSV


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["empty"]),
        ("\n" + csv_text(table()), ["empty", "header"]),
        (csv_text(table(0)), ["0 rows", "at least 4"]),
        (csv_text(changed("ee_y", 3, "left")), ["column ee_y", "row 3", "'left'", "Replace"]),
        (csv_text(changed("ee_y", 2, True)), ["column ee_y", "row 2", "'True'"]),
        (csv_text(changed("time_s", 4, "1_000")), ["column time_s", "row 4", "'1_000'"]),
        (csv_text(changed("ee_y", 5, "")), ["column ee_y", "row 5", "finite"]),
        (csv_text(changed("base_yaw", 6, 90.0)), ["column base_yaw", "row 6", "rad"]),
        (csv_text(table()).replace("ee_y", "ee_x", 1), ["column ee_x", "2 times", "Remove"]),
        (csv_text(table()).replace("ee_y", "hand_y", 1), ["column ee_y", "missing"]),
        (csv_text(table()) + "1.0,2.0,3.0\n", ["row 7", "3 values for 19", "column base_yaw", "Mend"]),
        (csv_text(changed("cmd_ee_vz", 2, "0.1,0.2")), ["row 2", "20 values for 19", "column cmd_ee_vz", "Mend"]),
        (csv_text(table()).replace("\n", "\n\n", 3), ["row 1", "0 values for 19", "column time_s"]),
        (csv_text(table()).replace(",", ";"), ["the header has semicolons", "there must be commas"]),
        (csv_text(table()).replace(",", "\t"), ["the header has tabs", "there must be commas"]),
    ],
)
def test_a_bad_csv_is_named(tmp_path: Path, text: str, words: list[str]) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    assert_refused(path, *words)


@pytest.mark.parametrize("value", [1e30, -1e300, 1.4e16])
def test_a_value_beyond_single_precision_is_named(tmp_path: Path, value: float) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(csv_text(changed("ee_vx", 4, value)))
    assert_refused(path, "column ee_vx, row 4", f"{value:g}", "may exceed 1.3e+16", "Look for a wrong unit")
    path.write_text(csv_text(changed("ee_vx", 4, LARGEST)))
    squares = np.float32(read_one(path).state[3, 9]) ** 2 * np.float32(MOST_ROWS)
    assert np.isfinite(squares)


def test_a_csv_in_another_encoding_is_named(tmp_path: Path) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(csv_text(table()), encoding="utf-16")
    assert_refused(path, "UTF-8")


def test_a_csv_may_have_a_mark_spaces_more_columns_and_blank_lines_at_its_end(tmp_path: Path) -> None:
    columns: Table = {"note": ["a text"] * 6, **table(), "battery": [""] * 6, "": [1] * 6, " ": [2] * 6}
    path = tmp_path / "walk.csv"
    path.write_text("\ufeff" + csv_text(columns).replace(",", ", ").replace("\n", "\r\n") + "\r\n\r\n", "utf-8")
    assert_same(read_one(path), session())


# Parquet


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (changed("ee_y", 3, None), ["column ee_y", "row 3", "finite"]),
        ({**table(), "ee_y": ["left"] * 6}, ["column ee_y", "row 1", "'left'", "string", "Convert"]),
        ({**table(), "ee_y": [True] * 6}, ["column ee_y", "row 1", "'True'", "bool"]),
        ({**table(), "time_s": np.arange(6).astype("datetime64[s]")}, ["column time_s", "row 1", "timestamp"]),
        ({n: v for n, v in table().items() if n != "ee_y"}, ["column ee_y", "missing"]),
        (table(0), ["0 rows"]),
    ],
)
def test_a_bad_parquet_is_named(tmp_path: Path, columns: dict[str, Any], words: list[str]) -> None:
    path = tmp_path / "bad.parquet"
    schema = None if len(columns["time_s"]) else pa.schema([(name, pa.float64()) for name in columns])
    pq.write_table(pa.table(columns, schema=schema), path)
    assert_refused(path, *words)


def test_a_parquet_with_a_column_twice_is_named(tmp_path: Path) -> None:
    columns = table()
    path = tmp_path / "bad.parquet"
    pq.write_table(pa.Table.from_arrays([*columns.values(), columns["ee_y"]], [*columns, "ee_y"]), path)
    assert_refused(path, "column ee_y", "2 times")


def test_a_parquet_may_have_whole_numbers_and_more_columns(tmp_path: Path) -> None:
    columns = {**table(), "time_s": list(range(6)), "note": ["a text"] * 6}
    path = tmp_path / "walk.parquet"
    pq.write_table(pa.table(columns), path)
    assert_same(read_one(path), session()._replace(time_s=np.arange(6.0)))


@given(st.floats(0, 1, exclude_max=True))
@quick
def test_a_cut_parquet_is_named(share: float) -> None:
    with scratch() as folder:
        path = write_recording(folder, session(name="cut"), SCHEMA)
        content = path.read_bytes()
        path.write_bytes(content[: int(share * len(content))])
        assert_refused(path, "Parquet")


def test_a_damaged_value_in_a_parquet_is_no_measurement(tmp_path: Path) -> None:
    recording = session(name="flipped")
    path = write_recording(tmp_path, recording, SCHEMA)
    content = bytearray(path.read_bytes())
    content[content.index(recording.state[3, 4].tobytes()) + 6] ^= 1
    path.write_bytes(content)
    assert_refused(path, "Parquet", "CRC")


# Pickles


def published(*arrays: np.ndarray) -> bytes:
    """A tuple of arrays in the published files' opcodes, which no library of today writes."""

    def value(item: object) -> bytes:
        return pickle.dumps(item, protocol=3)[2:-1]  # less PROTO and STOP

    def call(module: str, name: str, *arguments: bytes) -> bytes:
        return reference(module, name) + b"(" + b"".join(arguments) + b"tR"

    def reference(module: str, name: str) -> bytes:
        return f"c{module}\n{name}\n".encode()

    def array(a: np.ndarray) -> bytes:
        order, code = a.dtype.str[0], a.dtype.str[1:]
        dtype = call("numpy", "dtype", value(code), value(False), value(True))
        dtype += value((3, order, None, None, None, -1, -1, 0)) + b"b"
        rebuild = reference("numpy.core.multiarray", "_reconstruct")
        arguments = b"(" + reference("numpy", "ndarray") + value((0,)) + value(b"b") + b"t"
        state = b"(" + value(1) + value(a.shape) + dtype + value(False) + value(a.tobytes()) + b"t"
        return call("jax._src.array", "_reconstruct_array", rebuild, arguments, state, value({"weak_type": False}))

    return b"\x80\x03(" + b"".join(array(a) for a in arrays) + b"t."


def transitions(rows: int = 6) -> list[np.ndarray]:
    """x, u, y without a gap."""
    s = session(rows + 1)
    return [a.astype(np.float32) for a in (s.state[:-1], s.command[:-1], s.state[1:])]


@pytest.mark.parametrize("order", ["<f4", ">f4"])
def test_a_pickle_keeps_all_its_transitions(tmp_path: Path, order: str) -> None:
    x, u, y = transitions(6)
    path = tmp_path / "walk.pickle"
    path.write_bytes(published(*(a.astype(order) for a in (x, u, y))))
    read = read_one(path, step=0.1)
    np.testing.assert_array_equal(read.state[:-1], x)
    np.testing.assert_array_equal(read.state[1:], y)
    np.testing.assert_array_equal(read.command, np.concatenate([u, u[-1:]]))
    np.testing.assert_array_equal(read.time_s, np.arange(7) * 0.1)
    assert read.state.dtype == np.float64


class Attack:
    """Unpickling it calls os.system."""

    def __init__(self, command: str) -> None:
        self._command = command

    def __reduce__(self) -> tuple[Callable[[str], int], tuple[str]]:
        return os.system, (self._command,)


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_a_pickle_that_wants_to_run_code_runs_none(tmp_path: Path, protocol: int) -> None:
    marker = tmp_path / "marker"
    content = pickle.dumps((Attack(f"touch {marker}"), *transitions()), protocol)
    path = tmp_path / "bad.pickle"
    path.write_bytes(content)
    assert_refused(path, "wants to run code", "posix.system", "not loaded")
    assert not marker.exists()
    pickle.loads(content)
    assert marker.exists()  # the attack is one


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (pickle.dumps(eval), ["run code", "builtins.eval"]),
        (pickle.dumps(np.lib.format.open_memmap), ["run code", "numpy.lib"]),
        (b"cjax._src.array\nArrayImpl\n.", ["run code", "jax._src.array.ArrayImpl"]),
        (b"cnumpy\nndarray.__init__\n.", ["run code", "numpy.ndarray.__init__"]),
        (b"", ["three float32 arrays", "EOFError"]),
        (pickle.dumps({"x": 1}), ["three float32 arrays", "other things"]),
        (pickle.dumps(({}, {}, {})), ["three float32 arrays", "other things"]),
        (published(*transitions()[:2]), ["three float32 arrays"]),
        (published(*(a.astype(np.float64) for a in transitions())), ["three float32 arrays", "f8"]),
        (published(*(a.astype(np.int32) for a in transitions())), ["three float32 arrays", "i4"]),
        (published(*transitions())[:-200], ["three float32 arrays"]),
        (published(*(a[:, :-1] for a in transitions())), ["(6, 11), (6, 5), (6, 11)", "(T, 12), (T, 6), (T, 12)"]),
        (published(*(a[0] for a in transitions())), ["(12,), (6,), (12,)"]),
        (published(*[np.ones((), np.float32)] * 3), ["(), (), ()"]),
        (published(*(a[:2] for a in transitions())), ["3 rows", "at least 4"]),
        (published(*(a[:0] for a in transitions())), ["0 rows"]),
        (b"cnumpy\nndarray\n(K\x01tb.", ["three float32 arrays"]),  # sets the state of a class
    ],
)
def test_a_bad_pickle_is_named(tmp_path: Path, content: bytes, words: list[str]) -> None:
    path = tmp_path / "bad.pickle"
    path.write_bytes(content)
    assert_refused(path, *words)


def test_a_gap_in_a_pickle_is_named(tmp_path: Path) -> None:
    x, u, y = transitions()
    y[3, 7] += 0.5
    path = tmp_path / "bad.pickle"
    path.write_bytes(published(x, u, y))
    assert_refused(path, "column ee_y", "row 4", "row 5", "no gap", "Split it after row 4")


def test_a_missing_value_in_a_pickle_is_no_gap(tmp_path: Path) -> None:
    x, u, y = transitions()
    x[4, 7] = y[3, 7] = np.nan
    path = tmp_path / "bad.pickle"
    path.write_bytes(published(x, u, y))
    assert_refused(path, "column ee_y", "row 5", "finite")


def test_a_pickle_too_large_is_not_opened(tmp_path: Path) -> None:
    path = tmp_path / "bad.pickle"
    with path.open("wb") as file:
        file.truncate(PICKLE_LIMIT + 1)  # takes no space on the disk
    assert_refused(path, "67,108,865 bytes", "at most 67,108,864", "Parquet")


@given(st.data())
@settings(max_examples=100, deadline=None)
def test_a_damaged_pickle_raises_nothing_else(data: st.DataObject) -> None:
    content = bytearray(published(*transitions()))
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, 300))] = data.draw(st.integers(0, 255))
    with scratch() as folder:
        (folder / "bad.pickle").write_bytes(content)
        write_recording(folder, session(name="good"), SCHEMA)
        read, errors = read_recordings(folder, SCHEMA, STEP)
    assert len(read) + len(errors) == 2
    assert read[-1].name == "good"


# Real recordings


def test_the_published_training_sessions() -> None:
    folder = spot_recordings()
    read, errors = read_recordings(folder, SCHEMA, STEP, ["recordings_spot_v*/*"])
    assert not errors
    assert len(read) == 12
    assert sum(len(r.time_s) - 1 for r in read) == 6796
    assert [r.name for r in read] == sorted(r.name for r in read)
    assert read[0].name == "recordings_spot_v0/dataset_learn_jax_20240815-151559_v0_1"
    with scratch() as copy:
        for recording in read:
            write_recording(copy, recording, SCHEMA)
        for converted, recording in zip(read_recordings(copy, SCHEMA, STEP)[0], read, strict=True):
            assert_same(converted, recording)


def test_the_published_test_sessions() -> None:
    read, errors = read_recordings(spot_recordings(), SCHEMA, STEP, ["test_data_spot/*"])
    assert not errors
    assert len(read) == 2


# Arrays

named_arrays = st.dictionaries(
    st.from_regex(r"[a-z_]\w{0,9}", fullmatch=True).filter(str.isascii),
    hnp.arrays(st.sampled_from(["f4", "f8", "i4", "i8", "?", "U3"]), hnp.array_shapes(min_dims=0, min_side=0)),
    max_size=4,
)


def assert_bits_equal(a: np.ndarray, b: np.ndarray) -> None:
    a, b = np.asarray(a), np.asarray(b)
    assert (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())


@given(named_arrays)
@quick
def test_arrays_read_back_the_same(arrays: dict[str, np.ndarray]) -> None:
    with scratch() as folder:
        path = folder / "deep" / "arrays.npz"
        save_arrays(path, arrays)
        read = load_arrays(path)
        assert [p.name for p in path.parent.iterdir()] == ["arrays.npz"]
    assert read.keys() == arrays.keys()
    for name in arrays:
        assert_bits_equal(read[name], arrays[name])


def test_equal_arrays_make_equal_bytes_at_any_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_arrays(tmp_path / "a.npz", {"x": np.ones(3)})
    monkeypatch.setattr("time.time", lambda: 2e9)
    save_arrays(tmp_path / "b.npz", {"x": np.ones(3)})
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_a_write_that_fails_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "arrays.npz"
    save_arrays(path, {"x": np.ones(3)})
    with pytest.raises(ValueError, match="Object arrays"):
        save_arrays(path, {"x": np.zeros(3), "y": np.array([{}])})
    np.testing.assert_array_equal(load_arrays(path)["x"], 1.0)
    assert [p.name for p in tmp_path.iterdir()] == ["arrays.npz"]


@pytest.mark.parametrize("read", [load_arrays, load_model, read_json])
def test_a_file_that_is_not_there_is_named(tmp_path: Path, read: Callable[[Path], object]) -> None:
    with pytest.raises(SimgapError, match=r"nothing\.npz: there is no such file\. Run the stage"):
        read(tmp_path / "nothing.npz")


def _flipped(content: bytes) -> bytes:
    return content[:200] + bytes([content[200] ^ 1]) + content[201:]


@pytest.mark.parametrize(
    "damage",
    [
        lambda _: b"",
        lambda content: content[:-30],
        lambda content: content[30:],
        _flipped,
        lambda _: b"some text",
        lambda _: pickle.dumps(Attack("false")),
    ],
)
@pytest.mark.parametrize("load", [load_arrays, load_model])
def test_damaged_arrays_are_named(
    tmp_path: Path, damage: Callable[[bytes], bytes], load: Callable[[Path], object]
) -> None:
    path = tmp_path / "bad.npz"
    save_arrays(path, {"x": np.arange(100.0)})
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(SimgapError, match=r"bad\.npz: is no whole file of arrays"):
        load(path)


def test_a_pickle_inside_an_archive_is_not_opened(tmp_path: Path) -> None:
    marker, path = tmp_path / "marker", tmp_path / "bad.npz"
    np.savez(path, kind=np.array([Attack(f"touch {marker}")]))
    with pytest.raises(SimgapError, match=r"bad\.npz: is no whole file of arrays"):
        load_model(path)
    assert not marker.exists()


# Models


@st.composite
def fitted_models(draw: st.DrawFn) -> Model:
    """Models of any size and any bits, NaN and infinity included."""

    def array(*shape: int) -> Any:
        return draw(hnp.arrays(np.float32, shape, elements=st.floats(width=32)))

    if draw(st.booleans()):
        return FittedSpot(array(24), array(13), array(13), array())
    sizes = draw(st.lists(st.integers(1, 4), min_size=2, max_size=14))
    particles = [(array(2, i, o), array(2, 1, o)) for i, o in pairwise(sizes)]
    rows = np.random.default_rng(0).normal(size=(9, 5)).astype(np.float32)
    return BNN(particles, array(sizes[-1]), array(sizes[-1]), normalisation(rows, rows))  # type: ignore[arg-type]


def leaves(model: Model) -> list[Any]:
    if isinstance(model, FittedSpot):
        return list(model)
    return [*(part for layer in model.particles for part in layer), model.scale, model.dof, *model.normalisation]


@given(fitted_models())
@quick
def test_a_model_reads_back_bit_for_bit(model: Model) -> None:
    with scratch() as folder:
        save_model(folder / "model.npz", model)
        read = load_model(folder / "model.npz")
    assert type(read) is type(model)
    for one, other in zip(leaves(read), leaves(model), strict=True):
        assert_bits_equal(one, other)


def bnn() -> BNN:
    rng = np.random.default_rng(1)

    def normal(*shape: int) -> Any:
        return rng.normal(size=shape).astype(np.float32)

    particles: Any = [(normal(5, i, o), normal(5, 1, o)) for i, o in ((31, 8), (8, 8), (8, 13))]
    stats = normalisation(normal(50, 31), normal(50, 13))
    return BNN(particles, np.exp(normal(13)), np.full(13, np.inf, np.float32), stats)  # type: ignore[arg-type]


def fitted_simulator() -> FittedSimulator:
    """With a dead time and a friction, both greater within a reach, and smaller where it moves fast."""
    augmented, spot = Augmented(Spot(STEP)), fitted_spot()
    rng = np.random.default_rng(3)
    recording = Recording("made up", np.arange(60) / 15, rng.normal(size=(60, 12)), rng.normal(size=(60, 6)))
    theta = np.zeros(len(augmented.slots), np.float32)
    for i, slot in enumerate(augmented.slots):
        theta[i] = {"delay": 1.3, "coulomb_friction": 0.1}.get(CATALOGUE[slot.effect].id, 0.0)
    acting = Acting(theta, np.stack([theta, -0.5 * theta]), (Regime(2, -1.0, 0.7), Regime(0, 1.0, 0.2)))
    simulator = AugmentedSimulator.of(Spot(STEP), acting, measure(augmented, [recording]))
    return FittedSimulator(simulator, spot.params, spot.scale, spot.dof)


def with_residual() -> ResidualModel:
    fitted, rng = fitted_simulator(), np.random.default_rng(4)
    particles: Any = [(rng.normal(size=(2, i, o)), rng.normal(size=(2, 1, o))) for i, o in ((27, 4), (4, 12))]
    particles = [(w.astype(np.float32), b.astype(np.float32)) for w, b in particles]
    of = [np.float32(a) for a in (np.zeros(27), np.ones(27), np.full(12, 0.1))]
    one: Any = np.float32(1.0)
    durations: Any = np.array([0.9, 1.1, 2.5], np.float32)
    return ResidualModel(fitted.simulator, fitted.params, durations, one, one, particles, *of, fitted.scale, fitted.dof)  # type: ignore[arg-type]


@pytest.mark.parametrize("make", [bnn, fitted_spot, fitted_simulator, with_residual])
def test_a_model_read_back_predicts_the_same(tmp_path: Path, make: Callable[[], Model]) -> None:
    model = make()
    save_model(tmp_path / "model.npz", model)
    read = load_model(tmp_path / "model.npz")
    if isinstance(model, FittedSimulator | ResidualModel):
        assert read.simulator == model.simulator  # type: ignore[union-attr]
    x: Any = np.random.default_rng(2).normal(size=31).astype(np.float32)
    for one, other in zip(predict(read, x), predict(model, x), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_model_of_another_simulator_is_not_written(tmp_path: Path) -> None:
    model = dataclasses.replace(fitted_simulator(), simulator=Spot(STEP))
    with pytest.raises(SimgapError, match="cannot be written"):
        save_model(tmp_path / "model.npz", model)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("make", [bnn, fitted_spot, fitted_simulator, with_residual])
def test_a_model_with_other_arrays_is_named(tmp_path: Path, make: Callable[[], Model]) -> None:
    path = tmp_path / "model.npz"
    save_model(path, make())
    arrays = load_arrays(path)
    # Models of earlier versions lack some scales, which no effect on those robots needs.
    optional = {f"{SCALES}{name}" for name in Scales._field_defaults}
    for name in arrays.keys() - {"kind"} - optional:
        save_arrays(path, {n: a for n, a in arrays.items() if n != name})
        with pytest.raises(SimgapError, match=r"model\.npz: .* Train the model again"):
            load_model(path)
    save_arrays(path, {**arrays, "surplus": np.ones(1)})
    with pytest.raises(SimgapError, match="surplus"):
        load_model(path)


@pytest.mark.parametrize("arrays", [{"x": np.ones(3)}, {"kind": np.array("GaussianProcess")}, {"kind": np.ones(9)}])
def test_arrays_that_are_no_model_are_named(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    save_arrays(tmp_path / "other.npz", arrays)
    with pytest.raises(SimgapError, match=r"other\.npz: holds no model; .* must be BNN, .* or ResidualModel"):
        load_model(tmp_path / "other.npz")


# JSON, text, tables, digests, folders

json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
)


@given(json_values)
@quick
def test_json_reads_back_the_same(value: object) -> None:
    with scratch() as folder:
        write_json(folder / "value.json", value)
        assert read_json(folder / "value.json") == value


def test_json_is_sorted_and_has_null_where_there_is_no_number(tmp_path: Path) -> None:
    path = tmp_path / "value.json"
    write_json(path, {"b": [math.nan, np.float32(0.5)], "a": {"y": np.array([1.0, np.inf]), "x": np.int64(3)}})
    assert path.read_text() == (
        '{\n "a": {\n  "x": 3,\n  "y": [\n   1.0,\n   null\n  ]\n },\n "b": [\n  null,\n  0.5\n ]\n}\n'
    )


@pytest.mark.parametrize("content", [b"", b'{"a": 1', b"\xff\xfe"])
def test_damaged_json_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.json"
    path.write_bytes(content)
    with pytest.raises(SimgapError, match=r"bad\.json: is no whole JSON file"):
        read_json(path)


def test_text_is_written_as_it_is(tmp_path: Path) -> None:
    write_text(tmp_path / "report" / "report.md", "mean ± std\n")
    assert (tmp_path / "report" / "report.md").read_bytes() == "mean ± std\n".encode()


def test_a_table_has_six_digits_and_blanks(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    rows = [{"model": "a, b", "nll": -1234.56789, "steps": 1234567}, {"model": "c", "rmse": np.float32(1e-7)}]
    write_table(path, rows)
    assert path.read_text() == 'model,nll,steps,rmse\n"a, b",-1234.57,1234567,\nc,,,1e-07\n'


@given(st.lists(st.fixed_dictionaries({"name": st.text("ab,\"'\n"), "x": st.floats(allow_nan=False)}), min_size=1))
@quick
def test_a_table_reads_back_to_six_digits(rows: list[dict[str, Any]]) -> None:
    with scratch() as folder:
        write_table(folder / "table.csv", rows)
        with (folder / "table.csv").open(newline="") as file:
            read = list(csv.DictReader(file))
    assert [row["name"] for row in read] == [row["name"] for row in rows]
    np.testing.assert_allclose([float(row["x"]) for row in read], [row["x"] for row in rows], rtol=1e-5)


def written(folder: Path, contents: dict[str, str]) -> list[Path]:
    for name, content in contents.items():
        write_text(folder / name, content)
    return [folder / name for name in contents]


def test_a_digest_is_of_names_and_contents(tmp_path: Path) -> None:
    contents = {"training.npz": "one", "deep/test.npz": "two"}
    digest = digest_of(written(tmp_path / "a", contents))
    assert len(digest) == 16
    assert int(digest, 16)
    assert digest_of(written(tmp_path / "b", contents)[::-1]) == digest
    for other in (
        {"training.npz": "one"},
        {"training.npz": "one", "deep/test.npz": "tw0"},
        {"training.npz": "one", "deep/tests.npz": "two"},
        {"training.npz": "two", "deep/test.npz": "one"},
    ):
        assert digest_of(written(tmp_path / "c", other)) != digest


def test_a_digest_of_what_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SimgapError, match=r"nothing\.npz: there is no such file"):
        digest_of([tmp_path / "nothing.npz"])


def test_a_folder_is_removed_if_it_is_there(tmp_path: Path) -> None:
    written(tmp_path / "a", {"deep/file": "one"})
    remove_folder(tmp_path / "a", tmp_path)
    remove_folder(tmp_path / "a", tmp_path)
    assert not list(tmp_path.iterdir())
