"""The documentation site: built without a warning, read in a browser without a server and without another host."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built as `make docs` builds it, but elsewhere."""
    site = tmp_path_factory.mktemp("site")
    command = [Path(sys.executable).parent / "mkdocs", "build", "--strict", "--quiet", "--site-dir", site]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")
    return site


def test_the_site_has_every_page_and_what_they_link_to(site: Path) -> None:
    for page in (ROOT / "docs").rglob("*.md"):
        assert (site / page.relative_to(ROOT / "docs").with_suffix(".html")).exists(), page
    assert (site / "reports/spot/diagnosis/diagnosis.html").exists()
    assert "def</span>" in (site / "concealed/strength.py.html").read_text()


@pytest.mark.parametrize("width", [1400, 390])
def test_every_page_fits_and_asks_no_other_host(site: Path, browser: Any, width: int) -> None:
    asked: list[str] = []
    page = browser.new_page(viewport={"width": width, "height": 900})
    page.on("request", lambda request: asked.append(request.url))
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    for path in sorted((ROOT / "docs").rglob("*.md")):
        page.goto((site / path.relative_to(ROOT / "docs").with_suffix(".html")).as_uri())
        assert page.evaluate("document.documentElement.scrollWidth") <= width, path
        loaded = "[...document.images].filter(i => i.complete && !i.naturalWidth).map(i => i.src)"
        assert page.evaluate(loaded) == [], path
    page.close()
    assert errors == []
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []


def test_search_works_without_a_server(site: Path, browser: Any) -> None:
    page = browser.new_page()
    page.goto((site / "index.html").as_uri())
    page.locator(".md-search__input").press_sequentially("remote", delay=50)
    page.locator(".md-search-result__link").first.wait_for()
    assert "reproduce.html" in page.locator(".md-search-result__link").first.get_attribute("href")
    page.close()
