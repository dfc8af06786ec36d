"""Pages in a real browser, on a phone and on a desk, by day and by night."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from test_diagnosis_page import EXAMPLES, missing_physics

from examples.drive import DRIVE
from examples.record import record
from simgap.page import check
from simgap.page.diagnosis import page

SCREENS = {"phone": (390, 844), "desk": (1400, 900)}

CONTRASTS = """() => {
  const numbers = text => text.match(/[0-9.]+/g).map(Number);
  const luminance = rgb => rgb.slice(0, 3).map(c => c / 255)
    .map(c => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4)
    .reduce((sum, c, k) => sum + c * [0.2126, 0.7152, 0.0722][k], 0);
  const ground = e => {
    const rgb = numbers(getComputedStyle(e).backgroundColor);
    return rgb.length == 3 || rgb[3] > 0 ? rgb : ground(e.parentElement);
  };
  const worst = {};
  for (const e of document.querySelectorAll("body *")) {
    const own = [...e.childNodes].some(n => n.nodeType == 3 && n.data.trim());
    if (!own || e.closest("svg, [aria-hidden], .drawn")) continue;
    const [a, b] = [luminance(numbers(getComputedStyle(e).color)), luminance(ground(e))];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (ratio < 4.5) worst[e.outerHTML.slice(0, 80)] = ratio;
  }
  return worst;
}"""
"""Text whose contrast with what is behind it is below 4.5 (WCAG 2, AA); coloured cells have a test of their own."""

CUT = """() => [...document.querySelectorAll("header *")]
  .filter(e => e.getBoundingClientRect().right > innerWidth).map(e => e.outerHTML.slice(0, 80))"""
"""What of the summary reaches over the right edge of the screen."""


@pytest.fixture(scope="module")
def documents(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Pages of every kind: diagnoses, one with many effects and long names, and a check of recordings."""
    diagnosis, evidence = missing_physics()
    effect = diagnosis["effects"][1]
    long = {"channels": ["cmd_of_a_joint_with_a_name_that_no_line_of_a_phone_can_hold_because_it_is_too_long"]}
    many = [effect | {"id": f"an_effect_with_a_long_name_{k}", "credible_set": [], **long} for k in range(12)]
    folder = tmp_path_factory.mktemp("recordings")
    record("drive", folder, sessions=2, seconds=4.0, seed=0)
    return {
        **{name: page(*example()) for name, example in EXAMPLES.items()},
        "many": page(diagnosis | {"effects": many, "warnings": ["A warning."]}, evidence),
        "inconclusive": page(
            {"verdict": "inconclusive", "insufficient": [{"reason": "too short", "remedy": "Record more"}]}, {}
        ),
        "check": check.page("drive", check.check(folder, DRIVE), DRIVE),
    }


@pytest.mark.parametrize("name", [*EXAMPLES, "many", "inconclusive", "check"])
@pytest.mark.parametrize("screen", SCREENS)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_page_fits_its_screen_and_can_be_read(
    browser: Any, documents: dict[str, str], tmp_path: Path, name: str, screen: str, scheme: str
) -> None:
    width, height = SCREENS[screen]
    (tmp_path / "page.html").write_text(documents[name])
    shown = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
    try:
        shown.goto((tmp_path / "page.html").as_uri())
        shown.evaluate("document.querySelectorAll('details').forEach(d => d.open = true)")
        assert shown.evaluate("document.documentElement.scrollWidth") <= width
        assert shown.evaluate(CUT) == []
        assert shown.evaluate(CONTRASTS) == {}
        assert shown.locator("h1").bounding_box()["y"] < height / 2
        levels = [int(tag[1]) for tag in shown.locator("h1, h2, h3").evaluate_all("all => all.map(e => e.tagName)")]
        assert levels[0] == 1
        assert all(after - before <= 1 for before, after in pairwise(levels))
    finally:
        shown.close()


def test_a_phone_shows_what_is_missing_and_whether_it_helps_without_scrolling(
    browser: Any, documents: dict[str, str], tmp_path: Path
) -> None:
    (tmp_path / "page.html").write_text(documents["missing_physics"])
    width, height = SCREENS["phone"]
    shown = browser.new_page(viewport={"width": width, "height": height})
    try:
        shown.goto((tmp_path / "page.html").as_uri())
        for words in ("reach limit or saturation", "probability 97 %", "Does it help?", "Yes: held-out error falls"):
            box = shown.get_by_text(words).last if words[0] == "Y" else shown.get_by_text(words).first
            assert box.bounding_box()["y"] < height, words
    finally:
        shown.close()
