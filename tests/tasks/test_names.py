"""A name stays in its folder, whatever text it is; and nothing outside a workspace is deleted, whoever asks."""

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError
from test_params import ROOT

from simgap.formats.folders import remove_file, remove_folder
from simgap.types import ConfigError, SimgapError
from tasks import forms, names, ranges
from tasks.params import load_params
from tasks.sealed.workspace import SealedWorkspace
from tasks.workspace import Workspace

HOSTILE = [
    "", ".", "..", "../x", "../../x", "a/b", "/tmp", "a\\b", ".hidden", "-rf", "a b", "a.b", "a\0b", "a\n", "~", "*",
    "$HOME", "%2e%2e", "ä", "\u212a", "x" * 101,
]  # fmt: skip
"""The last but one, the sign for kelvin, is a K to a search that ignores case."""
NOBODY = 65534


def admitted(text: str) -> bool:
    try:
        return names.check(text) == text
    except ConfigError:
        return False


@pytest.mark.parametrize("text", HOSTILE)
def test_what_could_leave_a_folder_or_hide_in_it_is_no_name(text: str) -> None:
    assert not admitted(text)


@settings(deadline=None)
@given(st.text(st.characters(), max_size=120) | st.text("aZ09_-./\\", max_size=120))
def test_a_name_is_one_visible_folder_below_any_other(text: str) -> None:
    if admitted(text):
        below = Path("/w") / text
        assert below.parts == ("/", "w", text)
        assert Path(os.path.normpath(below)) == below
        assert text.isascii()
        assert text[0].isalnum()
        assert 0 < len(os.fsencode(text)) <= 100
    else:
        assert text == "" or len(text) > 100 or not text[0].isalnum() or not set(text) <= set(names_admit())


def names_admit() -> str:
    """Every character that a name may hold."""
    return "".join(chr(c) for c in range(128) if chr(c).isalnum()) + "_-"


@settings(deadline=None)
@given(st.text(names_admit(), min_size=1, max_size=100).filter(lambda text: text[0] not in "_-"))
def test_every_such_text_is_a_name(text: str) -> None:
    assert admitted(text)


@settings(deadline=None)
@given(st.text(max_size=30) | st.sampled_from(HOSTILE))
def test_every_door_admits_the_same_names(text: str) -> None:
    """The file, the form, the command line, the sealed suites: all by one type."""
    block = {"folder": "f", "training": ["*"], "test": ["*"]}
    doors: list[Callable[[], object]] = [
        lambda: TypeAdapter(ranges.Name).validate_python(text),
        lambda: load_params(ROOT / "params.yaml", {"recordings": {text: block}}),
        lambda: forms.Recordings(source=text),
        lambda: Workspace(Path("w"), text),
        lambda: SealedWorkspace(Path("w"), text),
        lambda: SealedWorkspace(Path("w"), "engine").record(text),
        lambda: SealedWorkspace(Path("w"), "engine").case(text),
    ]
    for door in doors:
        if admitted(text):
            door()
        else:
            with pytest.raises((ConfigError, ValidationError)):
                door()


@pytest.mark.parametrize("variant", ["../x", "a=../x", "a=1/..", "x", "=1", "a=1,", "..", "a=1,../x=2", "a=1\n"])
def test_a_variant_is_names_with_their_numbers(variant: str) -> None:
    with pytest.raises(ConfigError, match="the variant is"):
        Workspace(Path("w"), "virtual", variant)


def test_every_folder_of_a_workspace_lies_in_it() -> None:
    made = Workspace(Path("w"), "mine", "learning_rate=1e-05,hidden_layer_sizes=16x16")
    found = [getattr(made, name) for name, value in vars(Workspace).items() if isinstance(value, property)]
    folders = [path for path in found if isinstance(path, Path)]
    assert len(folders) >= 10
    for path in folders:
        assert Path("w") in Path(os.path.normpath(path)).parents


# Deleting


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """Someone's folder, with something in it."""
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs" / "thesis.tex").write_text("years of work")
    return tmp_path / "theirs"


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    (tmp_path / "w" / "data").mkdir(parents=True)
    return tmp_path / "w"


def test_nothing_outside_is_deleted(workspace: Path, outside: Path) -> None:
    """Given by dots, by a link, through a link; nor the workspace itself."""
    (workspace / "link").symlink_to(outside)
    (workspace / "up").symlink_to("..")
    theirs = [workspace / "data" / ".." / ".." / "theirs", workspace / "link", workspace / "up" / "theirs", outside]
    for path in (*theirs, workspace, workspace / "data" / "..", workspace.parent):
        with pytest.raises(SimgapError, match="does not lie in"):
            remove_folder(path, workspace)
    for path in theirs:
        with pytest.raises(SimgapError, match="does not lie in"):
            remove_file(path / "thesis.tex", workspace)
    assert (outside / "thesis.tex").read_text() == "years of work"


def test_of_a_link_in_a_folder_that_is_deleted_the_link_goes_alone(workspace: Path, outside: Path) -> None:
    (workspace / "data" / "link").symlink_to(outside)
    (workspace / "loose").symlink_to(outside / "thesis.tex")
    remove_folder(workspace / "data", workspace)
    remove_file(workspace / "loose", workspace)
    remove_file(workspace / "loose", workspace)
    assert list(workspace.iterdir()) == []
    assert (outside / "thesis.tex").exists()


@pytest.fixture
def readonly() -> Iterator[Path]:
    """A workspace in which this user may not write: root, who may everywhere, is nobody for as long."""
    folder, user = Path(tempfile.mkdtemp()), os.geteuid()
    part = folder / "data" / "part"
    part.mkdir(parents=True)
    (part / "kept").write_text("")
    for path in (part, part.parent, folder):
        path.chmod(0o555)
    if user == 0:
        os.seteuid(NOBODY)
    yield folder
    os.seteuid(user)
    for path in (folder, part.parent, part):
        path.chmod(0o755)
    shutil.rmtree(folder)


def test_what_could_not_be_deleted_is_named_with_the_reason(readonly: Path) -> None:
    kept = readonly / "data" / "part" / "kept"
    words = rf"data: {kept} cannot be deleted \(Permission denied\), nor 2 others\. Fix the permissions"
    with pytest.raises(SimgapError, match=words):
        remove_folder(readonly / "data", readonly)
    with pytest.raises(SimgapError, match=rf"{kept}: cannot be deleted \(Permission denied\)"):
        remove_file(kept, readonly)
