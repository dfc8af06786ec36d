"""A process that diagnoses cannot read what lies with the keys, whoever runs it."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ATTEMPTS = {
    "open": "open(f'{keys}/secret').read()",
    "open by a detour": "open(f'{keys}/../{keys.name}/keys.sealed', 'rb').read()",
    "open by a link": "open(f'{keys.parent}/link').read()",
    "list": "os.listdir(keys)",
    "pathlib": "pathlib.Path(keys, 'secret').read_bytes()",
    "numpy": "numpy.fromfile(f'{keys}/secret', numpy.uint8)",
    "another process": "subprocess.run(['cat', f'{keys}/secret'], check=True)",
    "the shell": "os.system(f'cat {keys}/secret')",
    "carry off": "os.rename(f'{keys}/secret', f'{keys.parent}/taken')",
}


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    folder = tmp_path / "keys" / "development"
    folder.mkdir(parents=True)
    for name in ("secret", "keys.sealed"):
        (folder / name).write_text("the truth")
    (tmp_path / "keys" / "link").symlink_to(folder / "secret")
    (tmp_path / "recordings.csv").write_text("what may be read")
    return folder


def attempts(keys: Path, ways: dict[str, str], locked: bool) -> dict[str, list[str]]:
    """What each way came to in one process: the name of the error, or nothing, and what was read."""
    script = (
        "import json, os, pathlib, subprocess, sys, numpy\nfrom tasks.sealed.lock import lock\n"
        f"keys = pathlib.Path({str(keys)!r})\nfound = {{}}\n" + ("lock(keys)\n" if locked else "")
        + f"for name, code in {ways!r}.items():\n"
        "    try:\n        found[name] = ['', str(eval(code))]\n"
        "    except Exception as error:\n        found[name] = [type(error).__name__, str(error)]\n"
        "sys.stderr.write(json.dumps(found))\n"
    )  # fmt: skip
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return {**json.loads(done.stderr), "stdout": ["", done.stdout]}


def test_no_way_leads_to_a_key(keys: Path) -> None:
    found = attempts(keys, ATTEMPTS, locked=True)
    assert {way: found[way][0] for way in ATTEMPTS} == dict.fromkeys(ATTEMPTS, "PermissionError")
    assert not [way for way, (_, text) in found.items() if "the truth" in text]
    assert (keys / "secret").exists()


def test_without_the_lock_a_way_is_a_way_and_with_it_all_else_is_open(keys: Path) -> None:
    ways = {way: ATTEMPTS[way] for way in ("open", "open by a detour", "open by a link", "list")}
    found = attempts(keys, ways, locked=False)
    assert all(not error for error, _ in found.values())
    assert found["open by a detour"][1] == "b'the truth'"
    other = {"read": f"open({str(keys.parents[1] / 'recordings.csv')!r}).read()"}
    assert attempts(keys, other, locked=True)["read"] == ["", "what may be read"]


def test_it_holds_where_there_are_no_keys_yet(tmp_path: Path) -> None:
    assert attempts(tmp_path / "nothing", {"ran": "1 + 1"}, locked=True)["ran"] == ["", "2"]
