"""The parameters as a page: `python -m tasks.params_table` prints docs/reference/parameters.md."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from simgap.formats.documents import read_bytes
from simgap.formats.yaml_files import read_yaml
from tasks.params import Params
from tasks.params_sealed import SealedParams
from tasks.ranges import RANGES

FILES = {"params.yaml": Params, "pipelines/sealed/params.yaml": SealedParams}
_HEAD = """# Parameters

Printed from `params.yaml` and `pipelines/sealed/params.yaml`, and from the types that check them, by
`python -m tasks.params_table`. A block has the name of the stage that reads it. The ranges hold in the files, in the
forms and on the command line: a value outside its range is refused, with a message that names the key.
"""
_LINE = re.compile(r"^(?P<indent> *)(?P<key>\w+):[^#]*(#\s*(?P<comment>.*))?$")
Schema = Mapping[str, Any]


def page(root: Path) -> str:
    """The page, in Markdown, of the files under the project's root."""
    lines = [_HEAD]
    for name, model in FILES.items():
        values, said = read_yaml(root / name), comments(read_bytes(root / name).decode())
        lines += [f"## {name}", ""]
        for block, value in values.items():
            lines += [f"### {block}", ""] + ([_sentence(said[block]), ""] if block in said else [])
            lines += ["| key | value | range | meaning |", "| --- | --- | --- | --- |"]
            lines += [_row(key, leaf, said.get(f"{block}.{key}", ""), kind)
                      for key, leaf, kind in _leaves(value, [model.model_json_schema()], (block,))]  # fmt: skip
            lines.append("")
    return "\n".join(lines)


def comments(text: str) -> dict[str, str]:
    """What a YAML file says behind its keys, by their dotted paths."""
    found, path = {}, []
    for line in text.splitlines():
        if match := _LINE.match(line):
            path = [*path[: len(match["indent"]) // 2], match["key"]]
            found |= {".".join(path): match["comment"]} if match["comment"] else {}
    return found


def _leaves(value: Any, kinds: list[Schema], path: tuple[str, ...]) -> Iterator[tuple[str, Any, Schema]]:
    """(dotted path within the block, value, schema) of every value."""
    whole = kinds[0]
    kind = _resolved(_resolved(kinds[-1], whole)["properties"][path[-1]], whole)
    if not isinstance(value, Mapping):
        yield ".".join(path[1:]), value, kind
        return
    for key, item in value.items():
        if "patternProperties" in kind:  # any source of recordings, of the kind that has its keys
            (either,) = kind["patternProperties"].values()
            fits = next(k for k in either["anyOf"] if set(_resolved(k, whole)["properties"]) == set(item))
            for inner, leaf in item.items():
                yield from _leaves(leaf, [whole, fits], (*path, key, inner))
        else:
            yield from _leaves(item, [whole, kind], (*path, key))


def _resolved(kind: Schema, whole: Schema) -> Schema:
    return whole["$defs"][kind["$ref"].rsplit("/", 1)[1]] if "$ref" in kind else kind


def _row(key: str, value: Any, comment: str, kind: Schema) -> str:
    described = kind.get("description") or RANGES.get(key.rsplit(".", 1)[-1], {}).get("description", "")
    shown = f"`{', '.join(map(str, value)) or 'none'}`" if isinstance(value, list) else f"`{value}`"
    return f"| `{key}` | {shown} | {_range(kind)} | {described or _sentence(comment)} |"


def _sentence(words: str) -> str:
    return words and f"{words[0].upper()}{words[1:]}."


def _range(kind: Schema) -> str:
    """What a value may be, or every entry of a list."""
    if "items" in kind or "prefixItems" in kind:
        entry = kind.get("items") or kind["prefixItems"][0]
        return f"each {_range(entry)}" if _range(entry) else ""
    if "enum" in kind:
        return ", ".join(f"`{name}`" for name in kind["enum"])
    if "maximum" not in kind and "exclusiveMaximum" not in kind:
        return ""
    low = f"{kind['minimum']:,}" if "minimum" in kind else f"above {kind['exclusiveMinimum']:,}"
    return f"{low} to {kind['maximum']:,}" if "maximum" in kind else f"{low}, below {kind['exclusiveMaximum']:,}"


if __name__ == "__main__":
    print(page(Path()), end="")
