"""A damaged file is one line that says what is wrong and where; what YAML admits and nobody means is refused."""

from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from test_params import ROOT

from simgap.formats.yaml_files import read_yaml
from simgap.types import ConfigError
from tasks.params import load_params

CONFLICT = "a:\n<<<<<<< HEAD\n  b: 1\n=======\n  b: 2\n>>>>>>> other\n"
LAUGHS = "a: &a [1, 1]\nb: &b [*a, *a]\nc: [*b, *b]\n"


def refused(path: Path, text: str | bytes) -> str:
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ConfigError) as error:
        read_yaml(path)
    return str(error.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (CONFLICT, "line 2 is the mark <<<<<<< of a merge that git could not finish. Keep one"),
        ("a: 1\n>>>>>>> other\n", "line 2 is the mark >>>>>>>"),
        ("train:\n  bnn: {seed: 1}\n  bnn: {seed: 2}\n", "line 3: the key train.bnn stands twice, first in line 2"),
        ("a: 1\nb: [{c: 1, c: 1}]\n", "line 2: the key b.c stands twice"),
        ("a: " + "[" * 50 + "]" * 50, "line 1: a is nested deeper than 20 levels"),
        ("a: " + "{b: " * 5000, "line 1: a.b.b"),
        ("a: [1\nb: 2\n", "line 2: expected ',' or ']'"),
        ("a: 1\nb: [0x" + "f" * 5000 + "]\n", "line 2: b holds a whole number of 5,002 characters; it may have 100"),
        ("1" * 5000 + ": 1\n", "line 1: the file holds a whole number of 5,000 characters"),
        ("a: !!python/object:os.system x\n", "line 1: could not determine a constructor"),
        ("a: !!timestamp x\n", "is no YAML"),
        (b"\x00\x01\x02", "is no YAML"),
        (b"\xff\xfea", "is no YAML"),
    ],
)
def test_what_is_damaged_is_one_line_with_its_place(tmp_path: Path, text: str | bytes, words: str) -> None:
    message = refused(tmp_path / "x.yaml", text)
    assert message.startswith(f"{tmp_path / 'x.yaml'}: {words}")
    assert "\n" not in message


def test_what_is_not_there_or_no_file_is_one_line(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none.yaml"):
        with pytest.raises(ConfigError, match=r"cannot be read \([A-Z][a-z ]+\)\.$"):
            read_yaml(path)


def said(path: Path) -> str:
    """The refusal, or nothing."""
    try:
        read_yaml(path)
    except ConfigError as error:
        return str(error)
    return ""


@settings(deadline=None)
@given(st.text(max_size=60) | st.text("ab:-[]{}&*!|>'\"#%@`,? \n\t1.<=", max_size=60) | st.binary(max_size=40))
def test_any_text_is_read_or_refused_in_one_line(tmp_path_factory: pytest.TempPathFactory, text: str | bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode(errors="surrogatepass"))
    assert "\n" not in said(path)


@pytest.mark.parametrize(
    "name", ["params.yaml", "dvc.yaml", "dvc.lock", "pipelines/small.yaml", "pipelines/sealed/params.yaml"]
)
def test_the_projects_files_are_read_as_any_reader_reads_them(name: str) -> None:
    assert read_yaml(ROOT / name) == yaml.safe_load((ROOT / name).read_text())


def test_parts_that_repeat_others_are_refused(tmp_path: Path) -> None:
    """Merged ones can fill memory, and no parameter needs them."""
    for text in (LAUGHS, "a: &a {x: 1, y: 2}\nb: {<<: *a, x: 3}\n"):
        (tmp_path / "x.yaml").write_text(text)
        with pytest.raises(ConfigError, match=r"line 2: \*a.* repeats another part"):
            read_yaml(tmp_path / "x.yaml")


def test_a_key_that_stands_twice_in_params_is_named(tmp_path: Path) -> None:
    text = (ROOT / "params.yaml").read_text().replace("    particles: 5\n", "    particles: 5\n    particles: 6\n")
    (tmp_path / "params.yaml").write_text(text)
    with pytest.raises(ConfigError, match=r"line \d+: the key train\.bnn\.particles stands twice, first in line \d+"):
        load_params(tmp_path / "params.yaml")
