"""Pages of made-up diagnoses of a Spot: what they say, that they stand alone, and what they do without."""

import base64
import copy
import json
import re
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

from simgap.diagnosis.report import wording
from simgap.page import drawings as diagnosis_plots
from simgap.page.diagnosis import page

OUTPUTS = ["base_x", "base_y", "base_yaw", "base_vx", "base_vy", "base_wz",
           "ee_x", "ee_y", "ee_z", "ee_vx", "ee_vy", "ee_vz"]  # fmt: skip
UNITS = ["m", "m", "rad", "m/s", "m/s", "rad/s", "m", "m", "m", "m/s", "m/s", "m/s"]
COMMANDS = ["cmd_base_vx", "cmd_base_vy", "cmd_base_wz", "cmd_ee_vx", "cmd_ee_vy", "cmd_ee_vz"]
COMMAND_UNITS = dict(zip(COMMANDS, ["m/s", "m/s", "rad/s", "m/s", "m/s", "m/s"], strict=True))
REGIMES = ["all rows", "reach > 0.93 m", "reach < 0.7 m", "|base speed| > 0.5 m/s", "|yaw rate| > 0.4 rad/s",
           "command just changed", "first minute"]  # fmt: skip
TRAINING, HELDOUT = ["walk_a", "walk_b", "reach_c", "reach_d", "mixed_e", "mixed_f"], ["walk_g", "mixed_h"]
INTERVALS = [{"session": "walk_a", "from_s": 6.7, "to_s": 9.3, "share": 0.12},
             {"session": "mixed_h", "from_s": 11.0, "to_s": 13.5, "share": 0.08}]  # fmt: skip
TIME = np.arange(300) / 15.0


def scored(value: float, spread: float) -> dict[str, Any]:
    return {"value": value, "ci95": [value - spread, value + spread]}


def scores(nll: float, *errors: float) -> dict[str, Any]:
    names = ["error_1", "error_10", "error_50", "error_50_base [m]", "error_50_ee [m]"]
    return {"nll_1": scored(nll, 0.4)} | {n: scored(e, 0.08 * e) for n, e in zip(names, errors, strict=True)}


def parameters(moved: tuple[str, ...]) -> dict[str, Any]:
    rng = np.random.default_rng(3)
    ranges = {f"alpha_{i}": [0.0, (0.8, 0.8, 0.8, 0.2, 0.2, 0.6)[i - 1]] for i in range(1, 7)}
    ranges |= {f"beta_{i}": [-0.01, 0.01] for i in range(1, 13)} | {f"gamma_{i}": [0.9, 2.4] for i in range(1, 7)}
    units = {name: "m/s" if name.startswith("beta") else "-" for name in ranges}
    before, after, ci95 = {}, {}, {}
    for name, (low, high) in ranges.items():
        half = 0.04 * (high - low) * rng.uniform(0.5, 2)
        before[name] = low + (high - low) * rng.uniform(0.3, 0.7)
        after[name] = before[name] + half * (rng.choice([-4, 3]) if name in moved else rng.uniform(-0.6, 0.6))
        ci95[name] = [after[name] - half, after[name] + half]
    return {"nominal": before, "fitted": after, "ci95": ci95, "units": units, "ranges": ranges}


def strips(strength: float) -> list[dict[str, Any]]:
    rng = np.random.default_rng(1)
    made = []
    for session in TRAINING + HELDOUT:
        time = np.arange(int(rng.integers(250, 420))) / 15.0
        excess = 0.03 * rng.standard_normal(len(time)) + 0.2 * strength * (np.sin(time + rng.uniform(0, 6)) > 0.7)
        for interval in (i for i in INTERVALS if i["session"] == session):
            excess += strength * ((time > interval["from_s"]) & (time < interval["to_s"]))
        made.append({"session": session, "heldout": session in HELDOUT, "time_s": time, "excess": excess})
    return made


def heat(strength: float) -> dict[str, Any]:
    rng = np.random.default_rng(2)
    values = 0.02 * rng.standard_normal((12, len(REGIMES)))
    values[3:6, [0, 3, 5]] += strength * np.array([0.3, 0.5, 1.0])
    values[9:11, 1] += 1.6 * strength
    values[[2, 8], 6] = np.nan
    return {"outputs": OUTPUTS, "regimes": REGIMES, "values": values}


def rollouts(models: tuple[str, ...]) -> list[dict[str, Any]]:
    rng = np.random.default_rng(4)
    off = {"nominal": 0.5, "refitted": 0.25, "augmented": 0.03, "black_box": 0.05}
    panels = []
    for k, (output, unit) in enumerate(zip(OUTPUTS, UNITS, strict=True)):
        truth = np.sin(TIME / 3 + k) + 0.3 * np.sin(TIME * 1.7)
        if unit == "rad":
            truth = (2.5 * truth + np.pi) % (2 * np.pi) - np.pi
        panel = {"session": "mixed_h", "output": output, "unit": unit, "time_s": TIME,
                 "measured": truth + 0.03 * rng.standard_normal(300)}  # fmt: skip
        panels.append(panel | {m: truth + off[m] * np.sin(TIME / 5 + k) * TIME / 20 for m in models})
    return panels


def missing_physics() -> tuple[dict[str, Any], dict[str, Any]]:
    """Late base commands and an arm at the end of its reach, with everything the contract can hold."""
    delay = {
        "id": "delay", "probability": 0.97, "channels": COMMANDS[:3], "outputs": OUTPUTS[3:6],
        "statement": "Commands to the base act 0.134 s after they were sent: two of the controller's steps.",
        "constants": [{"name": "delay", "value": 0.13412, "unit": "s", "ci95": [0.129, 0.139]}],
        "credible_set": ["delay"], "gain_nats": 812.0, "heldout_gain_nats": 301.4, "support": {"kind": "always"},
    }  # fmt: skip
    reach = {
        "id": "reach_limit", "probability": 0.81, "channels": COMMANDS[3:5], "outputs": OUTPUTS[9:11],
        "statement": "Beyond a reach of 0.93 m the hand cannot follow outward commands.",
        "constants": [{"name": "reach", "value": 0.931, "unit": "m", "ci95": [0.922, 0.94]}],
        "credible_set": ["reach_limit", "saturation"], "gain_nats": 164.2, "heldout_gain_nats": 58.3,
        "support": {"kind": "from", "from_s": 12.3}, "outside": 0.12,
    }  # fmt: skip
    effects = ["lag", "rate_limit", "saturation", "reach_limit", "gain", "slope", "viscous_drag", "gait_oscillation"]
    diagnosis = {
        "schema": 2, "simulator": "spot", "verdict": "missing_physics",
        "statement": "The simulator leaves out that commands to the base act 0.13 s late, and that the hand cannot "
                     "follow outward commands beyond a reach of 0.93 m. Together they account for 93 % of the error "
                     "that can be removed.",
        "recordings": {"training_sessions": TRAINING, "heldout_sessions": HELDOUT, "transitions": 2614,
                       "duration_s": 174.3, "baseline": None},
        "located": {"outputs": [{"name": n, "excess": e} for n, e in
                                zip(["base_vx", "base_wz", "ee_vx", "ee_vy"], [0.41, 0.33, 0.56, 0.12], strict=True)],
                    "regimes": [{"regime": "reach > 0.93 m", "share": 0.31, "rows": 0.08},
                                {"regime": "command of the base just changed", "share": 0.52, "rows": 0.2}],
                    "intervals": INTERVALS},
        "effects": [delay, reach],
        "alternatives": [{"effects": ["delay", "saturation"], "probability": 0.16},
                         {"effects": ["lag", "reach_limit"], "probability": 0.02}],
        "experiment": {"statement": "Push the hand outwards at three speeds, with the arm bent, then stretched.",
                       "commands": "experiment.csv", "separates": ["reach_limit", "saturation"]},
        "parameters": parameters(("alpha_1", "alpha_3", "gamma_4")),
        "fit": {"heldout_sessions": HELDOUT,
                "change": {"than": "refitted", "at": 50, "value": -0.69, "ci95": [-0.74, -0.63]},
                "explained_share": 0.93, "explained_share_ci95": [0.88, 0.97],
                "models": {"nominal": scores(-21.3, 0.31, 0.62, 1.84, 0.41, 0.52),
                           "refitted": scores(-24.9, 0.22, 0.41, 0.93, 0.22, 0.3),
                           "augmented": scores(-31.2, 0.13, 0.17, 0.29, 0.07, 0.09),
                           "black_box": scores(-30.8, 0.12, 0.18, 0.33, 0.09, 0.09)}},
        "sensitivity": {"power": 0.9, "effects": [
            {"effect": "delay", "where": "cmd_base_vx", "constant": "delay", "size": 0.0123, "unit": "s"},
            {"effect": "delay", "where": "cmd_ee_vz", "constant": "delay", "size": None, "unit": "s"},
            {"effect": "slope", "where": "base", "constant": "pull x", "size": None, "unit": "-"}]},
        "rounds": [
            {"threshold_nats": 11.4, "p_value": 0.002, "accepted": "delay on base",
             "hypotheses": [{"effect": "delay", "where": "base", "gain_nats": 812.0}] +
                           [{"effect": e, "where": w, "gain_nats": 640.0 / (k + 1) ** 2} for k, (e, w) in
                            enumerate((e, w) for e in effects for w in ("base", "ee"))]},
            {"threshold_nats": 11.6, "p_value": 0.002, "accepted": "reach_limit on ee",
             "hypotheses": [{"effect": "reach_limit", "where": "ee", "gain_nats": 164.2},
                            {"effect": "saturation", "where": "ee", "gain_nats": 160.1},
                            {"effect": "gain", "where": "ee", "gain_nats": 31.0}]},
            {"threshold_nats": 11.2, "p_value": 0.44, "accepted": None,
             "hypotheses": [{"effect": "gain", "where": "cmd_ee_vz", "gain_nats": 5.2},
                            {"effect": "coulomb_friction", "where": "base_vx", "gain_nats": 3.9},
                            {"effect": "slope", "where": "base", "gain_nats": -0.4}]}],
        "notes": ["Session reach_d has 3 outliers; they were kept, with heavy-tailed noise."],
    }  # fmt: skip
    line = np.linspace(0, 0.4, 60)
    bins = np.linspace(0.02, 0.38, 13)
    commanded = np.where(TIME < 4, 0.2, np.where(TIME < 8, 0.4, np.where(TIME < 12, 0.6, -0.6)))
    evidence = {
        "heat": heat(0.4), "strips": strips(0.7),
        "rollouts": rollouts(("nominal", "refitted", "augmented", "black_box")),
        "laws": [
            {"effect": "delay", "title": "Response to a command of 1", "x_label": "time since the command [s]",
             "y_label": "share of the command [-]", "x": bins, "y": (bins > 0.134) * 0.95, "y_err": 0.04 + 0 * bins,
             "line_x": line, "line_y": (line > 0.134) * 1.0,
             "caption": "Average of 214 changes of command; the line is the fitted delay."},
            {"effect": "reach_limit", "title": "Outward motion against reach", "x_label": "reach [m]",
             "y_label": "followed share [-]", "x": 0.6 + bins, "y": np.clip(1 - 8 * (bins - 0.33), 0, 1),
             "y_err": 0.05 + 0 * bins, "line_x": 0.6 + line, "line_y": (line < 0.331) * 1.0,
             "caption": "Share of outward commands that the hand follows, in bins of reach."}],
        "experiment": {"time_s": TIME, "units": COMMAND_UNITS,
                       "channels": {c: commanded * (c in ("cmd_ee_vx", "cmd_base_vx")) for c in COMMANDS}},
    }  # fmt: skip
    return diagnosis, evidence


def nothing() -> tuple[dict[str, Any], dict[str, Any]]:
    """A simulator that is right: no effect, no augmented model, no experiment."""
    diagnosis, evidence = missing_physics()
    models = {
        m: scores(-30 - k, 0.13, 0.17, 0.29, 0.07, 0.09) for k, m in enumerate(("nominal", "refitted", "black_box"))
    }
    diagnosis |= {
        "verdict": "nothing", "effects": [], "alternatives": [], "experiment": None, "notes": [],
        "statement": "No physics is missing: the recordings differ from the simulator by noise only.",
        "located": {"outputs": [], "regimes": [], "intervals": []}, "parameters": parameters(()),
        "fit": {"heldout_sessions": HELDOUT, "models": models, "explained_share": None, "explained_share_ci95": None},
        "rounds": diagnosis["rounds"][2:],
    }  # fmt: skip
    evidence |= {"heat": heat(0.0), "strips": strips(0.0), "laws": [], "experiment": None,
                 "rollouts": rollouts(("nominal", "refitted", "black_box"))}  # fmt: skip
    return diagnosis, evidence


def unexplained() -> tuple[dict[str, Any], dict[str, Any]]:
    """Something outside the vocabulary, located but not named."""
    diagnosis, evidence = nothing()
    located = missing_physics()[0]["located"]
    diagnosis |= {
        "verdict": "unexplained", "located": located,
        "statement": "Something is missing that no effect of the vocabulary explains. It lives in ee_vx, where the "
                     "reach exceeds 0.93 m.",
    }  # fmt: skip
    evidence |= {"heat": heat(0.4), "strips": strips(0.7)}
    return diagnosis, evidence


EXAMPLES = {"missing_physics": missing_physics, "nothing": nothing, "unexplained": unexplained}


class Reader(HTMLParser):
    """What a page says, and what it would load or run."""

    def __init__(self) -> None:
        super().__init__()
        self.words: list[str] = []
        self.references: list[str] = []
        self.open: list[str] = []
        self.tags: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.references += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data")]
        if tag not in ("meta", "img", "line", "circle", "rect"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in ("line", "circle", "rect"):
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] != "style":
            self.words.append(data)


def read(html: str) -> Reader:
    """The page as read; every tag is closed where it must be."""
    reader = Reader()
    reader.feed(html)
    assert not reader.open
    return reader


def text(html: str) -> str:
    return re.sub(r"\s+", " ", "".join(read(html).words))


def pictures(html: str) -> list[str]:
    return [base64.b64decode(r.split(",")[1]).decode() for r in read(html).references]


@pytest.fixture(scope="module")
def pages() -> dict[str, str]:
    return {name: page(*example()) for name, example in EXAMPLES.items()}


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_page_stands_alone(pages: dict[str, str], name: str) -> None:
    html = pages[name]
    reader = read(html)
    assert html.startswith("<!DOCTYPE html>")
    assert all(r.startswith("data:image/svg+xml;base64,") for r in reader.references)
    assert not {"script", "link", "iframe", "object"} & set(reader.tags)
    assert "url(" not in html
    assert "@import" not in html
    for picture in pictures(html):
        assert not re.search(r'(href|src)="(?!#|data:)', picture)
    assert len(html) < 3e6


def test_missing_physics_is_described_from_headline_to_notes(pages: dict[str, str]) -> None:
    said = text(pages["missing_physics"])
    order = ["Physics is missing", "Missing in the simulator: delay. Probably missing too: reach limit or saturation.",
             "probability 97 %", "0.134 s (0.129 to 0.139)",
             "How sure", "reach limit or saturation: these recordings cannot decide which",
             "reach limit or saturation: with a probability of 12 % the cause is another one",
             "Noise alone would gain as much with a probability of 0.002",
             "Does it help?", "Yes: held-out error falls from 93.0 % to 29.0 % of the motion",
             "What was found removes 93 % (88 % to 97 %)", "Held-out error after 50 steps", "as is184.0 %",
             "black box33.0 %", "What to do",
             "Check on the machine: reach limit or saturation is likely, not certain",
             "Push the hand outwards", "commands to the base act 0.13 s late", "Where is the mismatch?",
             "52 % of all excess falls where command of the base just changed, which is 20 % of the rows",
             "walk_a, 6.7 to 9.3 s (12 % of all excess)", "What is missing?", "97 % probable", "0.134 s",
             "0.129 to 0.139",
             "812.0 nats on the sessions fitted, 301.4 nats on held-out", "Of the known effects, delay alone fits",
             "from 12.3 s on", "One of: reach limit, saturation", "With a probability of 12 % the cause is another one",
             "How good are the forecasts?",
             "removes 93 % (95 % interval 88 % to 97 %)", "Error after 50 steps", "Error of base after 50 steps m",
             "What else could it be?", "delay with saturation", "The experiment that would decide",
             "experiment.csv", "How did the parameters change?", "3 of 24 parameters moved",
             "Round 1: delay on base accepted",
             "And 9 more", "reach limit on ee accepted", 
             "Round 3: nothing accepted (noise alone gains as much with a probability of 0.44)",
             "cmd_base_vx delay 0.0123 s",
             "Session reach_d has 3 outliers"]  # fmt: skip
    place = 0
    for words in order:  # the summary at the top says some of it before
        assert words in said[place:], words
        place = said.index(words, place)


def test_pictures_show_strips_laws_rollouts_and_commands(pages: dict[str, str]) -> None:
    strips_drawn, delay, reach, rolled, commanded = pictures(pages["missing_physics"])
    assert all(session in strips_drawn for session in TRAINING + HELDOUT)
    assert "Held-out sessions" in strips_drawn
    assert "time since the command [s]" in delay
    assert "reach [m]" in reach
    assert all(f"{output} [{unit}]" in rolled for output, unit in zip(OUTPUTS, UNITS, strict=True))
    assert "cmd_ee_vx [m/s]" in commanded
    assert "cmd_ee_vz" not in commanded
    assert "At zero throughout" in text(pages["missing_physics"])


def test_effects_of_one_id_show_each_its_own_pictures() -> None:
    diagnosis, evidence = missing_physics()
    effect, law = diagnosis["effects"][0], evidence["laws"][0]
    diagnosis["effects"] = [effect | {"form": "", "where": where} for where in ("base", "ee")]
    evidence["laws"] = [law | {"form": "", "where": where, "title": f"Of the {where}"} for where in ("ee", "base")]
    said = text(page(diagnosis, evidence))
    assert said.count("Of the base") == said.count("Of the ee") == 1
    assert said.index("Of the base") < said.index("Of the ee")


def test_the_regime_of_an_effect_stands_on_its_card() -> None:
    diagnosis, evidence = missing_physics()
    diagnosis["effects"][0]["support"] = {"kind": "regime", "regime": "base height > 0.4 m"}
    assert "acts where base height > 0.4 m" in text(page(diagnosis, evidence))


def test_a_law_without_a_name_is_listed_term_by_term() -> None:
    diagnosis, evidence = missing_physics()
    terms = [{"axis": "base_vx", "depends_on": ["base_x", "base_y"], "gain_nats": 41.26},
             {"axis": "ee_vz", "depends_on": ["reach"], "gain_nats": 17.0}]  # fmt: skip
    assert "an unexplained push" not in text(page(diagnosis, evidence))
    said = text(page(diagnosis | {"nonparametric": terms}, evidence))
    assert "on base_vx, depending on base_x and base_y 41.3 nats" in said
    assert "In addition, an unexplained push acts on the machine" in said
    unnamed = text(page(diagnosis | {"nonparametric": terms, "effects": []}, evidence))
    assert "An unexplained push acts on the machine" in unnamed
    assert "on ee_vz, depending on reach 17.0 nats" in said


def test_nothing_missing_says_so_in_every_section(pages: dict[str, str]) -> None:
    said = text(pages["nothing"])
    for words in ("Nothing is missing", "No output, regime or time stands out",
                  "No physics is missing: the simulator and the recordings differ by noise only",
                  "No other explanation remains, and no further experiment is needed",
                  "The best effect tried is gain; noise alone gains as much with a probability of 0.44",
                  "No parameter moved further",
                  "cmd_base_vx delay 0.0123 s"):  # fmt: skip
        assert words in said
    assert "with effects" not in said
    assert len(pictures(pages["nothing"])) == 2


def test_noise_does_not_glow(pages: dict[str, str]) -> None:
    assert "0.5 and more" in text(pages["nothing"])
    assert "0.5 and more" not in text(pages["unexplained"])


def test_an_unexplained_mismatch_is_still_located(pages: dict[str, str]) -> None:
    said = text(pages["unexplained"])
    assert "Unexplained mismatch" in said
    assert "none of the known effects explains; section 1 says where it shows" in said
    assert "It is greatest in ee_vx: 56 %" in said


def undecided(outside: float, probability: float) -> tuple[dict[str, Any], dict[str, Any]]:
    """Unexplained, with one closest match that has three names."""
    diagnosis, evidence = unexplained()
    match = copy.deepcopy(missing_physics()[0]["effects"][0])
    match |= {
        "id": "gain",
        "credible_set": ["gain", "viscous_drag", "sensor_scale"],
        "outside": outside,
        "probability": probability,
        "statement": "Commands are followed by a factor of 0.9 (cmd_ee_vz).",
    }
    located = {"depends_on": []} | diagnosis["located"]
    fit = {"black_box_better_at": []} | diagnosis["fit"]
    return diagnosis | {"closest_matches": [match], "located": located, "fit": fit}, evidence


def test_where_one_of_several_effects_is_missing_the_page_says_so() -> None:
    """None has a name of its own. That no effect explains it would be false."""
    diagnosis, evidence = undecided(outside=0.4, probability=0.2)
    said = text(page(diagnosis, evidence))
    names = "gain, viscous drag or sensor scale"
    assert f"One of these is probably missing: {names}. These recordings cannot tell which." in said
    assert f"With a probability of 60 % it is {names}; none by itself has more than 20 %." in said
    assert f"Check on the machine: {names} is likely, not certain." in said
    assert "none of the known effects" not in said
    assert wording.statement(diagnosis).startswith(
        "With a probability of 60% this is missing: gain, viscous drag or sensor scale; the recordings cannot tell "
        "which. If it is gain: Commands are followed by a factor of 0.9 (cmd_ee_vz)."
    )
    assert "Closest match" not in wording.statement(diagnosis)


@pytest.mark.parametrize(("outside", "probability"), [(0.6, 0.15), (0.4, 0.4)])
def test_a_match_whose_cause_is_likelier_another_one_is_no_tie(outside: float, probability: float) -> None:
    diagnosis, evidence = undecided(outside, probability)
    assert "none of the known effects explains" in text(page(diagnosis, evidence))
    assert "Closest match, which explains only part of the mismatch: Commands" in wording.statement(diagnosis)


@pytest.mark.parametrize("hostile", ["<b>x", '"><script>alert(1)</script>', "&amp;", "$\\frac{", "' onload='x"])
def test_hostile_names_are_text(hostile: str) -> None:
    diagnosis, evidence = missing_physics()
    diagnosis["recordings"]["training_sessions"] = [hostile]
    diagnosis["recordings"]["baseline"] = hostile
    diagnosis["located"] = {"outputs": [{"name": hostile, "excess": 0.5}],
                            "regimes": [{"regime": hostile, "share": 0.5, "rows": 0.1}],
                            "intervals": [{"session": hostile, "from_s": 1.0, "to_s": 2.0, "share": 0.1}]}  # fmt: skip
    diagnosis["notes"] = diagnosis["fit"]["heldout_sessions"] = [hostile]
    diagnosis |= {"statement": hostile, "simulator": hostile}
    diagnosis["effects"] = [{k: hostile if isinstance(v, str) else v for k, v in diagnosis["effects"][0].items()}]
    diagnosis["rounds"][0]["accepted"] = hostile
    evidence["strips"][0]["session"] = hostile
    evidence["rollouts"] = [evidence["rollouts"][0] | {"session": hostile, "output": hostile, "unit": hostile}]
    evidence["laws"] = [evidence["laws"][0] | dict.fromkeys(("effect", "title", "x_label", "caption"), hostile)]
    html = page(diagnosis, evidence)
    reader = read(html)
    assert "script" not in reader.tags
    assert "b>x" not in html.replace("&lt;b&gt;x", "").replace("<b>", "")
    assert text(html).count(hostile) >= 8


def test_only_a_verdict_is_needed() -> None:
    said = text(page({"verdict": "parameters_only", "statement": "Gains were wrong."}, {}))
    assert "Only parameters were wrong" in said
    assert "No scores" in said
    assert "were not refitted" in said


@pytest.mark.parametrize("part", ["heat", "strips", "laws", "rollouts", "experiment"])
def test_a_picture_may_be_absent(part: str) -> None:
    diagnosis, evidence = missing_physics()
    del evidence[part]
    some = {**evidence, "rollouts": evidence.get("rollouts", [])[:1]}
    assert "How good are the forecasts?" in text(page(diagnosis, some))


def test_unknown_numbers_are_dashes() -> None:
    diagnosis, _ = missing_physics()
    diagnosis["effects"][0]["constants"][0] |= {"value": None, "ci95": None}
    diagnosis["effects"][1] |= {"heldout_gain_nats": float("nan"), "constants": []}
    del diagnosis["fit"]["models"]["nominal"]["error_10"]
    diagnosis["fit"]["models"]["black_box"] = {"nll_1": {"value": -30.0, "ci95": None}}
    diagnosis["fit"]["models"]["refitted"]["note_of_another_kind"] = {"value": 1.25e-6, "ci95": [None, None]}
    diagnosis["parameters"]["ci95"] = diagnosis["parameters"]["ranges"] = {}
    said = text(page(diagnosis, {}))
    assert "nan" not in said.replace("explan", "").lower()
    assert "note of another kind" in said
    assert "1.25e\N{MINUS SIGN}06" in said


def test_a_page_is_the_same_for_the_same_diagnosis_and_leaves_it_alone() -> None:
    diagnosis, evidence = missing_physics()
    evidence["rollouts"] = evidence["rollouts"][:1]
    before = copy.deepcopy(diagnosis)
    assert page(diagnosis, evidence) == page(json.loads(json.dumps(diagnosis)), evidence)
    assert diagnosis == before


def test_scores_that_span_magnitudes_are_on_a_logarithmic_scale() -> None:
    diagnosis, _ = missing_physics()
    assert ">log<" not in page(diagnosis, {})
    diagnosis["fit"]["models"]["nominal"]["error_50"] = {"value": 3e7, "ci95": None}
    assert page(diagnosis, {}).count(">log<") == 1


def test_a_diverged_rollout_does_not_hide_the_others() -> None:
    panel = rollouts(("nominal",))[0]
    diverged = panel | {"nominal": np.where(TIME > 5, np.inf, np.exp(TIME * 9)), "measured": np.full(300, np.nan)}
    for drawn in (diverged, diverged | {"measured": panel["measured"]}):
        assert b"</svg>" in diagnosis_plots.rollouts([drawn])


def test_strips_without_rows_or_numbers_are_drawn() -> None:
    void = [
        {"session": n, "heldout": True, "time_s": [0.0] * k, "excess": [np.nan] * k} for n, k in (("a", 0), ("b", 1))
    ]
    assert diagnosis_plots.top_of_scale([s["excess"] for s in void], 0.02) == 0.02
    assert b"Training" not in diagnosis_plots.strips(void, [], 0.02)
