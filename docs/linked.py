"""MkDocs hook: what pages link to outside docs/ becomes part of the site, so a link works there and in the repository.

Markdown becomes a page, other text a page that shows it; pictures and whole documents are copied as they are.
"""

import posixpath
import re
from collections.abc import Callable
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files, InclusionLevel
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
LINK = re.compile(r"(?<=\]\()(?!\w+:|#)([^)#\s]+)")
COPIED = {".png", ".svg", ".gif", ".html", ".json", ".csv", ".ipynb"}
UNLISTED = "---\nsearch: {exclude: true}\n---\n"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what is linked, and what that links to."""
    queue = [f"docs/{file.src_uri}" for file in files.documentation_pages()]
    while queue:
        source = queue.pop()
        for path in LINK.findall((ROOT / source).read_text()):
            target = _target(source, path)
            if (ROOT / target).is_file() and files.get_file_from_path(_place(target)) is None:
                files.append(_made(target, config))
                queue += [target] if target.endswith(".md") else []
    return files


def on_page_markdown(markdown: str, page: Page, files: Files, **_: object) -> str:
    """Point links at where these files are in the site."""
    here = page.file.src_uri
    source = f"docs/{here}" if (ROOT / "docs" / here).is_file() else here

    def placed(link: re.Match[str]) -> str:
        place = _place(_target(source, link[1]))
        there = files.get_file_from_path(place) is not None
        return posixpath.relpath(place, posixpath.dirname(here)) if there else link[1]

    return LINK.sub(placed, markdown)


def _target(source: str, path: str) -> str:
    """A link's file, by its path from the project's root."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(source), path))


def _place(target: str) -> str:
    """Where a file of the project is in the site's sources."""
    shown = "" if target.endswith(".md") or Path(target).suffix in COPIED else ".md"
    return f"{target.removeprefix('docs/')}{shown}"


def _made(target: str, config: MkDocsConfig) -> File:
    make: Callable[..., File] = lambda **what: File.generated(  # noqa: E731
        config, _place(target), inclusion=InclusionLevel.NOT_IN_NAV, **what
    )
    if Path(target).suffix in COPIED:
        return make(abs_src_path=str(ROOT / target))
    text = (ROOT / target).read_text()
    if not target.endswith(".md"):
        text = f"# {target}\n\n````{Path(target).suffix[1:]}\n{text}\n````\n"
    return make(content=UNLISTED + text)
