"""What `simgap check` finds in recordings of a moving base: each fault by itself, and nothing where there is none."""

import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
import pytest
from given import spot_recordings
from test_importing import motion

from examples.car import CAR
from examples.record import record as record_example
from simgap import repeats, survey
from simgap.cli.check import check_folder
from simgap.derived import derived
from simgap.formats.recordings import read_recordings, write_recording
from simgap.page import check
from simgap.robots.operator import OperatorConfig, record
from simgap.robots.virtual_spot import VirtualSpotConfig
from simgap.simulators.spot import SCHEMA, Spot
from simgap.types import Recording, RecordingError

RATE = 15.0
ALWAYS = ["base_wz is always 0.5. Effects that depend on it cannot be found."]
"""What is so of `motion`, a circle."""
Change = Callable[[pd.DataFrame], Any]


def rows(seconds: float = 20, rate: float = RATE, start: float = 0) -> pd.DataFrame:
    stamps = start + np.arange(0, seconds, 1 / rate)
    return pd.DataFrame({"time_s": stamps - start, **motion(stamps)})


def folder(at: Path, *sessions: pd.DataFrame) -> Path:
    (at / "in").mkdir(exist_ok=True)
    for i, session in enumerate(sessions):
        session.to_csv(at / "in" / f"walk_{i}.csv", index=False)
    return at / "in"


def changed(change: Change) -> pd.DataFrame:
    session = rows()
    change(session)
    return session


def found(at: Path, *sessions: pd.DataFrame) -> list[str]:
    said = check.check(folder(at, *sessions), Spot()).findings
    return [line for line in said if line not in ALWAYS]


def column(name: str, values: Callable[[pd.DataFrame], Any]) -> Change:
    return lambda session: session.__setitem__(name, values(session))


def in_body_frame(session: pd.DataFrame) -> None:
    c, s = np.cos(session.base_yaw), np.sin(session.base_yaw)
    for body in ("base", "ee"):
        x, y = session[f"{body}_vx"], session[f"{body}_vy"]
        session[f"{body}_vx"], session[f"{body}_vy"] = c * x + s * y, c * y - s * x


def stuck(session: pd.DataFrame) -> None:
    session["ee_z"], session["ee_vz"] = 0.5, 0.0


def paused(session: pd.DataFrame) -> None:
    session["time_s"] += 60.0 * (session.index > 99)


def paused_twice(session: pd.DataFrame) -> None:
    session["time_s"] += 4.0 * (session.index > 99) + 4.0 * (session.index > 199)


def driven(session: pd.DataFrame) -> None:
    """The base follows what it is commanded, half a second late, and turns as it likes."""
    stamps = session.time_s.to_numpy()
    wish = lambda t: 0.4 * np.sin(0.9 * t) + 0.3 * np.sin(2.3 * t)  # noqa: E731
    session["cmd_base_wz"], session["base_wz"] = wish(stamps), 0.8 * wish(stamps - 0.5)
    yaw = -0.8 * (0.4 / 0.9 * np.cos(0.9 * (stamps - 0.5)) + 0.3 / 2.3 * np.cos(2.3 * (stamps - 0.5)))
    session["base_yaw"] = (yaw + np.pi) % (2 * np.pi) - np.pi


def driven_in(scale: float) -> Change:
    def change(session: pd.DataFrame) -> None:
        driven(session)
        session["cmd_base_wz"] *= scale

    return change


def test_good_recordings_have_no_findings_but_what_is_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check_folder(folder(tmp_path, rows()), "spot", tmp_path / "out")
    assert re.findall("^- (.*)", capsys.readouterr().out, re.MULTILINE) == ALWAYS
    page = (tmp_path / "out" / "check.html").read_text()
    assert "walk" in page
    assert "<script" not in page
    assert not re.search(r"(src|href)=.(?!data:)", page), "everything is in the page itself"
    assert "more sessions are not" not in page


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (column("base_vx", lambda r: 1000 * r.base_vx), "base_x changes 0.001 times as fast as base_vx says"),
        (column("base_vx", lambda r: r.base_vy), "base_vx does not match the change of base_x"),
        (column("cmd_ee_vx", lambda r: 0 * r.cmd_ee_vx), "The command cmd_ee_vx is never used"),
        (column("cmd_ee_vx", lambda r: 0.3 + 0 * r.cmd_ee_vx), "cmd_ee_vx is always 0.3"),
        (column("cmd_ee_vx", lambda r: r.cmd_ee_vy), "cmd_ee_vx and cmd_ee_vy move together"),
        (column("time_s", lambda r: r.time_s * 2), "rows are 0.1333 s apart"),
        (column("ee_z", lambda r: r.ee_z + (r.index == 77) * 9.0), r"ee_z jumps 2 times \(walk_0 row 78"),
        (column("ee_z", lambda r: r.ee_z.iloc[r.index // 4 * 4].to_numpy()), "ee_z repeats its last value in 75%"),
        (stuck, "ee_z is always 0.5"),
        (paused, "one gap dwarfs .*, in walk_0 60.07 s after row 100; the longest of the others is 0.0667 s"),
        (paused_twice, "2 gaps dwarf all other intervals, in walk_0 4.067 s after row .00"),
        (in_body_frame, r"base_vx, base_vy do not match the change of base_x, base_y \(agreement -?0...\); "
                        r"they do if rotated by base_yaw \(1.00\)"),
        (in_body_frame, "ee_vx, ee_vy do not match the change of ee_x, ee_y .* they do if rotated by base_yaw"),
        (driven_in(180 / np.pi), "cmd_base_wz is 7.* times base_wz .*, as between degrees and radians"),
        (driven_in(-1), "base_wz moves opposite to cmd_base_wz"),
        (column("base_vx", lambda r: np.append(np.diff(r.base_x) * RATE, 0)),
         "base_vx is the forward difference of base_x"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_found(tmp_path: Path, change: Change, words: str) -> None:
    said = found(tmp_path, changed(change))
    assert [line for line in said if re.search(words, line)], said


def test_velocities_in_the_other_frame_are_one_finding_a_body(tmp_path: Path) -> None:
    said = [line for line in found(tmp_path, changed(in_body_frame)) if "repeats" not in line]
    assert len(said) == 2, said


@pytest.mark.parametrize("scale", [0.4, 1.0, 2.0])
def test_a_machine_that_follows_with_a_gain_and_a_delay_of_its_own_is_none(tmp_path: Path, scale: float) -> None:
    assert not found(tmp_path, changed(driven_in(scale)))


def test_a_car_that_is_measured_along_the_world_is_found(tmp_path: Path) -> None:
    record_example("car", tmp_path / "car", 2, 20.0, 0)
    assert not check.check(tmp_path / "car", CAR).findings
    for path in (tmp_path / "car").glob("*.parquet"):
        session = pd.read_parquet(path)
        session["speed"] *= np.cos(session.yaw)
        session.to_parquet(path)
    said = check.check(tmp_path / "car", CAR).findings
    assert any("speed do not match" in line and "must be along the body's" in line for line in said), said


def test_a_sensor_that_was_off_in_a_session_is_found(tmp_path: Path) -> None:
    (line,) = found(tmp_path, rows(), changed(stuck), rows(start=50))[-2:-1]
    assert line.startswith("ee_z never changes in walk_1, but does in other sessions")


def test_sessions_of_different_rates_are_found(tmp_path: Path) -> None:
    assert (
        "The sessions have different rates: walk_1 has 30 Hz, walk_0 15 Hz."
        in found(tmp_path, rows(), rows(rate=30, start=50))[0]
    )
    (tmp_path / "other").mkdir()
    assert not found(tmp_path / "other", rows(), rows(rate=15.3, start=50))


def test_sessions_that_are_there_twice_or_overlap_are_found(tmp_path: Path) -> None:
    whole, late, other = rows(), rows(), rows(start=200)
    late["time_s"] += 5000.0
    (line,) = found(tmp_path, whole, late, other)
    assert line.startswith("Duplicate sessions: walk_1 (same as walk_0). Remove one")
    (line,) = found(tmp_path, whole.iloc[:200], whole.iloc[150:], other)
    assert line.startswith("Overlapping sessions: walk_0 and walk_1 (50 rows)")


def test_sessions_are_known_again_where_they_are_short_or_sensors_are_slow(tmp_path: Path) -> None:
    slow = rows()
    slow[list(SCHEMA.columns[1:])] = slow[list(SCHEMA.columns[1:])].iloc[slow.index // 2 * 2].to_numpy()
    short = rows(seconds=0.55, start=100)
    assert len(short) < repeats.RUN
    (line,) = [f for f in found(tmp_path, slow, slow, short, short, rows(start=200)) if "Duplicate" in f]
    assert line.startswith("Duplicate sessions: walk_1 (same as walk_0), walk_3 (same as walk_2). Remove one")


def test_sessions_that_repeat_at_rest_are_others(tmp_path: Path) -> None:
    """At rest, and measured in a few steps, rows of one session are rows of another: no export did that."""
    rng = np.random.default_rng(0)
    sessions = []
    for start in (0, 200):
        session = pd.concat([rows(start=start)] * 2, ignore_index=True)
        session["time_s"] = np.arange(len(session)) / RATE
        still = session.index > 100
        for name in SCHEMA.columns[1:]:
            session.loc[still, name] = 0.001 * rng.integers(0, 2, still.sum()) if name == "ee_z" else 0.0
        sessions.append(session)
    assert not [line for line in found(tmp_path, *sessions) if "Duplicate" in line or "Overlapping" in line]


@pytest.mark.parametrize(("mark", "word"), [(";", "semicolons"), ("\t", "tabs")])
def test_another_separator_is_named(tmp_path: Path, mark: str, word: str) -> None:
    at = folder(tmp_path, rows())
    rows(start=50).to_csv(at / "other.csv", index=False, sep=mark, decimal="," if mark == ";" else ".")
    (error,) = check.check(at, Spot()).left_out
    assert "other.csv" in error
    assert f"the header has {word} between the columns; there must be commas" in error


def test_a_name_that_is_no_utf_8_is_shown_and_read(tmp_path: Path) -> None:
    """With the installed command: the name reaches messages, the page and the terminal."""
    at = folder(tmp_path, rows())
    for name, session in ((b"caf\xe9.csv", rows(start=50)), (b"b\xff.csv", rows(start=90).iloc[:2])):
        with open(os.fsencode(at) + b"/" + name, "w") as file:
            session.to_csv(file, index=False)
    simgap = Path(sys.executable).parent / "simgap"
    done = subprocess.run([simgap, "check", "in"], cwd=tmp_path, capture_output=True, timeout=200)
    out = done.stdout.decode()
    assert done.returncode == 0, out + done.stderr.decode()
    assert "2 sessions" in out
    assert r"left out: in/b\udcff.csv: the session has 2 rows" in out
    page = (tmp_path / "diagnosis" / "check.html").read_text()
    assert r"caf\udce9" in page
    assert r"b\udcff.csv" in page


@pytest.mark.long
def test_two_thousand_sessions_are_a_page(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for i in range(2000):
        session = rows(seconds=40 / RATE, start=10.0 * i)
        session += rng.normal(0, 1e-3, session.shape) * ~session.columns.isin(["time_s", "base_yaw"])
        values = session.to_numpy().copy()
        if i == 1234:
            values[20:, 0] += 30.0
        if i % 7 == 0:
            (tmp_path / f"walk_{i:04d}.csv").write_text("time_s,base_x\n0,left\n")
        else:
            recording = Recording(f"walk_{i:04d}", values[:, 0], values[:, 1:13], values[:, 13:])
            write_recording(tmp_path, recording, SCHEMA)
    start = time.perf_counter()
    checked = check.check(tmp_path, Spot())
    page = check.page("many", checked, Spot())
    assert time.perf_counter() - start < 120
    assert len(page.encode()) < 5_000_000
    assert len(checked.sessions) == 1714
    assert "1,514 more sessions, those with the most even intervals, are left out of this table" in page
    assert "86 more files are left out and not listed" in page
    assert ">walk_1234</th>" in page
    assert len(checked.findings) < 10
    assert all(len(line) < 500 for line in checked.findings)


def test_stalls_are_counted_and_the_longest_is_named() -> None:
    stamps = np.cumsum(np.where(np.arange(100) % 10 == 9, 0.3, 0.1))
    stamps[50:] += 1.0
    rate = survey.rate(Recording("s", stamps, np.zeros((100, 1)), np.zeros((100, 1))))
    assert rate.median_s == pytest.approx(0.1)
    assert rate.stalls == pytest.approx(11 / 99, abs=0.011)
    assert (rate.longest_s, rate.longest_row) == (pytest.approx(1.1), 50)
    assert (rate.gaps, rate.others_s) == (0, pytest.approx(0.3))


def test_the_virtual_spot_has_no_findings(tmp_path: Path) -> None:
    for i, key in enumerate(jax.random.split(jax.random.key(3), 3)):
        write_recording(tmp_path, record(key, 60.0, VirtualSpotConfig(), OperatorConfig(), f"walk_{i}"), SCHEMA)
    assert not check.check(tmp_path, Spot()).findings


def test_the_real_spot_has_rows_that_last_longer_and_nothing_else() -> None:
    """Its published pickles have no time stamps: at 15 Hz positions change by more than the velocities say."""
    found = check.check(spot_recordings(), Spot()).findings
    assert len(found) == 6
    factors = [re.search("changes (.*) times as fast as", line) for line in found]
    assert all(f is not None and 1.5 < float(f[1]) < 2.5 for f in factors), found
    sessions, _ = read_recordings(spot_recordings(), SCHEMA, Spot().time_step)
    assert not derived(SCHEMA, sessions)


def test_a_folder_in_which_nothing_can_be_used_names_some_of_it(tmp_path: Path) -> None:
    for i in range(100):
        (tmp_path / f"walk_{i}.csv").write_text("a\n1\n")
    with pytest.raises(RecordingError, match=r"(?s)none of its 100 session files.*and 80 more") as error:
        check.check(tmp_path, Spot())
    assert len(str(error.value).splitlines()) == 22
