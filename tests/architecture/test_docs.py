"""What the docs name exists."""

import importlib
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_every_function_in_the_table_of_equations_exists() -> None:
    names = re.findall(r"\| `(simgap\.[\w.]+)` \|", (ROOT / "docs" / "equations.md").read_text())
    assert len(names) > 15
    for name in names:
        module, function = name.rsplit(".", 1)
        assert callable(getattr(importlib.import_module(module), function)), name


def test_every_paper_tag_has_one_form() -> None:
    for path in (ROOT / "simgap").rglob("*.py"):
        for tag in re.findall(r"\[[^\]]*Hoffman[^\]]*\]", path.read_text()):
            assert re.fullmatch(r"\[Hoffman et al\. 2025, [^\]]+\]", " ".join(tag.split())), f"{path}: {tag}"


def test_make_targets_of_the_readme_exist() -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = set(re.findall(r"\bmake ([a-z]+)", (ROOT / "README.md").read_text()))
    assert named
    assert named <= targets


def test_pictures_of_the_readme_exist() -> None:
    for link in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", (ROOT / "README.md").read_text()):
        assert (ROOT / link).is_file(), link
