"""Reads all YAML files; an error says in one line what is wrong and where."""

import re
from pathlib import Path
from typing import Any

import yaml

from simgap.types import ConfigError

DEEPEST = 20
"""Maximum levels of nested blocks; the project's own files have four."""
LARGEST = 2**20
"""Maximum size of a file [bytes]."""
LONGEST_NUMBER = 100
"""Maximum characters of an integer. One of 64 bits has twenty; Python refuses to print one of thousands."""
_MERGE = re.compile(r"^(<{7}|={7}|>{7}|\|{7})( .*)?$", re.MULTILINE)
"""Marks that git writes around the two sides of a merge that it could not finish."""
_WHOLE = "tag:yaml.org,2002:int"


class _Problem(yaml.MarkedYAMLError):
    """A problem, with its place in the file and no more."""


class _Loader(yaml.SafeLoader):
    """Refuses what YAML allows but nobody means: a key that occurs twice, of which the last would win. Also refuses
    what can fill memory: unlimited nesting, and parts that repeat others."""

    def __init__(self, stream: Any) -> None:
        super().__init__(stream)
        self._within: list[str] = []

    def compose_node(self, parent: Any, index: Any) -> Any:
        """A node; an error where it repeats another part or is nested too deep."""
        if self.check_event(yaml.AliasEvent):
            alias = self.peek_event()
            raise _Problem(problem=f"*{alias.anchor} repeats another part; write it out", problem_mark=alias.start_mark)
        if len(self._within) > DEEPEST:
            raise _Problem(problem=f"{self._named()} is nested deeper than {DEEPEST} levels",
                           problem_mark=self.peek_event().start_mark)  # fmt: skip
        self._within.append(index.value if isinstance(index, yaml.ScalarNode) else "")
        try:
            return super().compose_node(parent, index)  # type: ignore[arg-type]  # in a block, the key's node
        finally:
            self._within.pop()

    def compose_scalar_node(self, anchor: Any) -> yaml.ScalarNode:
        """A value; an error where it is an integer that is too long."""
        node = super().compose_scalar_node(anchor)
        if node.tag == _WHOLE and len(node.value) > LONGEST_NUMBER:
            raise _Problem(problem=f"{self._named() or 'the file'} holds a whole number of {len(node.value):,} "
                           f"characters; it may have {LONGEST_NUMBER}", problem_mark=node.start_mark)  # fmt: skip
        return node

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """A block; an error where a key occurs twice."""
        node = super().compose_mapping_node(anchor)
        lines: dict[str, int] = {}
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in lines:
                first = lines[key.value]
                raise _Problem(problem=f"the key {self._named(key.value)} stands twice, first in line {first}",
                               problem_mark=key.start_mark)  # fmt: skip
            lines[key.value] = key.start_mark.line + 1
        return node

    def _named(self, *key: str) -> str:
        return ".".join(part for part in (*self._within, *key) if part)


def read_yaml(path: Path) -> Any:
    """The content of a YAML file; ConfigError, one line, where it is missing or damaged, or has a key twice."""
    try:
        if path.stat().st_size > LARGEST:
            raise ConfigError(f"{path}: has more than {LARGEST:,} bytes. Is it the right file?")
        text = path.read_text(encoding="utf-8")
        if merge := _MERGE.search(text):
            line = text.count("\n", 0, merge.start()) + 1
            raise ConfigError(
                f"{path}: line {line} is the mark {merge[0][:7]} of a merge that git could not finish. Keep one of the "
                "two sides, and delete the marks."
            )
        return yaml.load(text, _Loader)
    except ConfigError:
        raise
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}).") from None
    except yaml.MarkedYAMLError as error:
        at = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise ConfigError(f"{path}: {at}{error.problem or error.context}. Correct the line.") from None
    except Exception as error:  # a damaged file may raise anything
        raise ConfigError(f"{path}: is no YAML ({' '.join(str(error).split())}). Correct or restore it.") from None
