"""The page of a diagnosis, without pictures: its headline, its names, and that no text becomes markup."""

import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from simgap.page import marks, wording
from simgap.page.figures import Figures
from simgap.page.render import page
from simgap.page.to_do import to_do
from simgap.page.tried import tried

PAGE = Path(__file__).parents[3] / "simgap" / "page"
EFFECT = {
    "id": "reach_limit", "form": "", "where": "ee", "probability": 0.81, "channels": ["cmd_ee_vx"],
    "outputs": ["ee_vx"], "statement": "Beyond a reach of 0.93 m the hand cannot follow outward commands.",
    "constants": [{"name": "reach", "value": 0.931, "unit": "m", "ci95": [0.922, 0.94]}],
    "support": {"kind": "regime", "regime": "height > 0.4 m"},
    "credible_set": ["reach_limit", "rate_limit"], "gain_nats": 164.2, "heldout_gain_nats": 58.3,
}  # fmt: skip
STATEMENT: dict[str, Any] = {
    "simulator": "spot", "verdict": "missing_physics", "statement": "The simulator leaves out the reach limit.",
    "warnings": ["The refitted simulator is worse."], "more_missing": True,
    "recordings": {"training_sessions": ["walk"], "heldout_sessions": ["turn"], "baseline": ["before"]},
    "located": {"outputs": [{"name": "ee_vx", "excess": 0.5}], "regimes": [{"regime": "reach > 0.9 m", "share": 0.4}],
                "intervals": [{"session": "walk", "from_s": 1.0, "to_s": 2.0, "share": 0.1}]},
    "effects": [EFFECT], "closest_matches": [EFFECT],
    "whiteness": {"nats": 9.0, "outputs": [{"name": "ee_vx", "share": 0.1}]},
    "nonparametric": [{"axis": "ee_vx", "depends_on": ["reach", "ee_x"], "gain_nats": 20.0}],
    "alternatives": [{"effects": ["rate_limit"], "probability": 0.19}],
    "experiment": {"statement": "To separate reach limit from rate limit, push.", "commands": "experiment.csv",
                   "separates": ["reach_limit", "rate_limit"]},
    "parameters": {"nominal": {"alpha": 0.1}, "fitted": {"alpha": 0.2}, "ci95": {"alpha": [0.1, 0.3]},
                   "units": {"alpha": "m"}, "ranges": {"alpha": [0.0, 1.0]}},
    "fit": {"heldout_sessions": ["turn"], "explained_share": 0.9,
            "models": {"nominal": {"error_50": {"value": 0.5, "ci95": [0.4, 0.6]}}}},
    "sensitivity": {"power": 0.9, "effects": [
        {"effect": "rate_limit", "where": "ee", "constant": "limit", "size": 0.1, "unit": "m/s/s"},
        {"effect": "rate_limit", "where": "base", "constant": "limit", "size": None, "unit": "m/s/s"}]},
    "rounds": [{"threshold_nats": 11.4, "p_value": 0.002, "accepted": "reach_limit.horizontal on ee",
                "hypotheses": [{"effect": "reach_limit.horizontal", "where": "ee", "gain_nats": 164.2}]}],
    "notes": ["Could not test rate limit on base."],
}  # fmt: skip
HEAT = {"outputs": ["ee_vx"], "regimes": ["reach > 0.9 m"], "values": [[0.3]], "top": 0.5}
LAW = {"effect": "reach_limit", "form": "", "where": "ee", "title": "Law", "caption": "A line", "svg": b"<svg/>"}
ROLLOUT = {"session": "turn", "models": ["nominal"], "svg": b"<svg/>"}
SHOWN = {"heat": HEAT, "laws": [LAW], "rollouts": [ROLLOUT], "commands": {"svg": b"<svg/>", "still": ["cmd_ee_vz"]}}
KEPT = {"verdict", "models", "svg"}
"""What the program itself writes: none of it is a user's text."""


class Outline(HTMLParser):
    """The elements of a page with the names of their attributes, and its words."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, ...]] = []
        self.words = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, *(name for name, _ in attrs)))

    def handle_data(self, data: str) -> None:
        self.words += data


def replaced(value: Any, text: str) -> Any:
    """The value with every text in it replaced, and every parameter's name."""
    if isinstance(value, dict):
        return {
            ("alpha" + text if k == "alpha" else k): v if k in KEPT else replaced(v, text) for k, v in value.items()
        }
    if isinstance(value, list):
        return [replaced(v, text) for v in value]
    return text if isinstance(value, str) else value


def outline(text: str) -> Outline:
    return Outline(page(replaced(STATEMENT, text), Figures(**replaced(SHOWN, text))))


@pytest.fixture(scope="module")
def plain() -> Outline:
    return outline("plain")


@given(st.text(min_size=1))
@example("<script>alert(1)</script>")
@example('"><img src=x onerror=alert(1)>')
@example("' autofocus onfocus='alert(1)")
@example("</style></title><b>")
@example("{{ 7 * 7 }}{% raw %}")
@example("&lt;b&gt;")
@settings(max_examples=50, deadline=None)
def test_no_text_becomes_markup(plain: Outline, text: str) -> None:
    assert outline(text).elements == plain.elements


def test_a_hostile_channel_name_is_read_as_it_is() -> None:
    hostile = '<img src=x onerror="alert(1)">'
    effect = EFFECT | {"channels": [hostile]}
    html = page(STATEMENT | {"effects": [effect], "statement": f"Commands of {hostile} act late."}, Figures())
    assert hostile not in html
    assert Outline(html).words.count(hostile) == 3  # list, statement, card


@pytest.mark.parametrize("share", [k / 20 for k in range(21)])
def test_numbers_on_colours_have_enough_contrast(share: float) -> None:
    def luminance(colour: str) -> float:
        red, green, blue = ((c / 255) ** 2.2 for c in bytes.fromhex(colour[1:]))
        return 0.2126 * red + 0.7152 * green + 0.0722 * blue

    low, high = sorted((luminance(marks.shade(share)), luminance(marks.ink(share).ljust(7, marks.ink(share)[1]))))
    assert (high + 0.05) / (low + 0.05) > 4.4


def test_nothing_in_the_package_switches_escaping_off() -> None:
    for path in filter(Path.is_file, PAGE.iterdir()):
        assert not re.search(r"Markup|\|\s*safe|autoescape\s+false", path.read_text()), path


@given(
    st.lists(
        st.lists(st.from_regex(r"[a-z]{1,9}(_[a-z]{1,9}){0,4}", fullmatch=True), min_size=1, max_size=4), max_size=9
    ),
    st.integers(0, 9),
    st.booleans(),
    st.sampled_from([*wording.VERDICTS, "a verdict of another kind"]),
)
@settings(deadline=None)
def test_a_headline_has_at_most_25_words(sets: list[list[str]], certain: int, more: bool, verdict: str) -> None:
    effects = [{"id": names[0], "credible_set": names, "gain_nats": float(k), "outside": 0.3 * (k < certain)}
               for k, names in enumerate(sets)]  # fmt: skip
    said = wording.headline({"verdict": verdict, "effects": effects, "more_missing": more})
    assert 0 < len(said.split()) <= 25


def test_effects_come_by_what_held_out_sessions_gain() -> None:
    small, large, unknown = ({"id": i, "gain_nats": 1.0, "heldout_gain_nats": g} for i, g in
                             (("small", 2.0), ("large", 30.0), ("unknown", None)))  # fmt: skip
    statement = {"verdict": "missing_physics", "effects": [unknown, small, large]}
    assert wording.headline(statement) == "Missing in the simulator: large, small and unknown."
    words = Outline(page(statement, Figures())).words
    assert words.rindex("large") < words.rindex("small") < words.rindex("unknown")


@pytest.mark.parametrize(
    ("outside", "headline", "to_check"),
    [((0.01, 0.0), "Missing in the simulator: delay and slope.", []),
     ((0.4, 0.3), "Probably missing in the simulator: delay and slope.", ["delay and slope are likely"]),
     ((0.4, 0.0), "Missing in the simulator: slope. Probably missing too: delay.", ["delay is likely"])],
)  # fmt: skip
def test_a_name_that_is_not_certain_is_said_to_be_probable(
    outside: tuple[float, float], headline: str, to_check: list[str]
) -> None:
    effects = [{"id": i, "outside": p, "heldout_gain_nats": g}
               for i, p, g in zip(("delay", "slope"), outside, (9.0, 5.0), strict=True)]  # fmt: skip
    statement = {"verdict": "missing_physics", "effects": effects}
    assert wording.headline(statement) == headline
    checks = [line for line in to_do(statement) if line.startswith("Check on the machine: ")]
    assert len(checks) == len(to_check)
    assert all(words in line for words, line in zip(to_check, checks, strict=True))


def test_an_effect_has_one_name() -> None:
    words = Outline(page(STATEMENT, Figures())).words
    assert "reach_limit" not in words
    assert "rate_limit" not in words
    assert "reach limit (horizontal) on ee accepted" in words


def test_a_round_that_tries_an_accepted_effect_again_is_a_retest() -> None:
    (search,) = STATEMENT["rounds"]
    again = search | {"accepted": None}
    other = again | {"hypotheses": [{"effect": "rate_limit", "where": "ee", "gain_nats": 9.0}]}
    words = Outline(page(STATEMENT | {"rounds": [search, other, again]}, Figures())).words
    assert "Round 2: nothing accepted" in words
    assert "Round 3: re-test of reach limit (horizontal) on ee, accepted before" in words


def test_what_noise_alone_gains_has_no_threshold_and_every_candidate_one_bar() -> None:
    candidates = [{"effect": "gain", "where": "ee", "gain_nats": g} for g in (9.0, 8.0)]
    last = {"threshold_nats": 5.0, "p_value": 0.3, "accepted": None, "hypotheses": candidates}
    (shown,) = tried({"rounds": [last]})["rounds"]
    assert (shown["threshold"], len(shown["rows"])) == ("", 1)
    (passed,) = tried({"rounds": [last | {"p_value": 0.001}]})["rounds"]
    assert 50 < float(passed["threshold"]) < 60


@pytest.mark.parametrize(
    ("after", "ends", "words"),
    [(0.2, [-0.7, -0.5], "Yes: held-out error falls from 50.0 % to 20.0 %"),
     (0.49, [-0.1, 0.06], "Not clear: held-out error goes from 50.0 % to 49.0 % of the motion, which may be chance"),
     (0.7, [0.3, 0.5], "No: held-out error rises from 50.0 % to 70.0 %"),
     (0.2, None, "Held-out error goes from 50.0 % to 20.0 %")],
)  # fmt: skip
def test_the_first_screen_says_whether_the_effects_help(after: float, ends: list[float] | None, words: str) -> None:
    models = STATEMENT["fit"]["models"] | {"augmented": {"error_50": {"value": after, "ci95": None}}}
    change = ends and {"than": "nominal", "at": 50, "value": after / 0.5 - 1, "ci95": ends}
    said = Outline(page(STATEMENT | {"fit": STATEMENT["fit"] | {"models": models, "change": change}}, Figures())).words
    first_screen = said[: said.index("Where is the mismatch?")]
    assert words in first_screen
    assert ("Do not forecast with these effects" in first_screen) == words.startswith("No:")
    assert ("Add these effects to the simulator" in first_screen) != words.startswith("No:")


@pytest.mark.parametrize("verdict", ["missing_physics", "parameters_only"])
def test_of_a_model_file_the_patched_model_is_what_to_use(verdict: str) -> None:
    patched = {"file": "arm.patched.xml", "changes": [{}], "unwritten": []}
    (line,) = to_do({"verdict": verdict, "patched": patched})
    assert line == "Use arm.patched.xml in place of the model; section 5 lists its changes."
    (line,) = to_do({"verdict": verdict, "patched": {**patched, "unwritten": ["play of a command"]}})
    assert line.endswith("simgap.load() has that too.")
    (line,) = to_do({"verdict": verdict, "patched": {**patched, "changes": []}})
    assert "arm.patched.xml" not in line


@pytest.mark.parametrize("verdict", wording.VERDICTS)
def test_every_verdict_has_a_headline_and_landmarks(verdict: str) -> None:
    elements = Outline(page({"verdict": verdict}, Figures())).elements
    tags = [tag for tag, *_ in elements]
    assert [tags.count(tag) for tag in ("header", "main", "h1")] == [1, 1, 1]
    assert ("html", "lang") in elements


def test_tables_have_captions_and_scopes_and_pictures_alternatives() -> None:
    elements = Outline(page(STATEMENT, Figures(**SHOWN))).elements
    tags = [tag for tag, *_ in elements]
    assert tags.count("table") == tags.count("caption") > 4
    assert all("scope" in attrs for tag, *attrs in elements if tag == "th")
    assert tags.count("img") == 3
    assert all("alt" in attrs for tag, *attrs in elements if tag == "img")


def test_colours_run_from_none_to_the_top_of_the_scale() -> None:
    assert [marks.shade(s) for s in (-1.0, 0.0, 0.5, 1.0, 2.0)] == [
        *(2 * marks.EXCESS[:1]), marks.EXCESS[2], *(2 * marks.EXCESS[-1:])
    ]  # fmt: skip
