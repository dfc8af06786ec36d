"""The table of scores, each with its interval and its goal."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from tasks.sealed.judge import MANY, ONE, SEEN, Row

Z95 = 1.96
DRAWS = 2000
CLOSE = 0.05
"""Relative error of a constant that is close."""
BINS = ((SEEN, 6.0), (6.0, 20.0), (20.0, 60.0), (60.0, 200.0), (200.0, np.inf))
"""Strengths [nats] that are distinguished."""


class Score(NamedTuple):
    """A score with its 95 % interval over n cases (nan where there are none) and the goal in words."""

    name: str
    value: float
    low: float
    high: float
    n: int
    goal: str


def wilson(hits: int, n: int) -> tuple[float, float]:
    """Interval of a share [Wilson 1927]."""
    if n == 0:
        return np.nan, np.nan
    p, z2 = hits / n, Z95**2
    middle, half = (p + z2 / (2 * n)) / (1 + z2 / n), Z95 / (1 + z2 / n) * np.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
    return max(float(middle - half), 0.0), min(float(middle + half), 1.0)


def share(name: str, goal: str, rows: Sequence[Row], holds: Callable[[Row], bool]) -> Score:
    hits = sum(bool(holds(r)) for r in rows)
    low, high = wilson(hits, len(rows))
    return Score(name, hits / len(rows) if rows else np.nan, low, high, len(rows), goal)


def average(
    name: str, goal: str, values: Sequence[float], statistic: Callable[..., Any], rng: np.random.Generator
) -> Score:
    """A mean or median with its bootstrap interval over cases."""
    found = np.array([v for v in values if v is not None and not np.isnan(v)], float)
    if not len(found):
        return Score(name, np.nan, np.nan, np.nan, 0, goal)
    drawn = statistic(found[rng.integers(0, len(found), (DRAWS, len(found)))], axis=1)
    low, high = np.quantile(drawn, [0.025, 0.975], method="nearest")
    return Score(name, float(statistic(found)), float(low), float(high), len(found), goal)


def table(rows: Sequence[Row], rng: np.random.Generator) -> list[Score]:
    """Every score that the suite has cases for."""
    return [score for score in _table(rows, rng) if score.n]


def _table(rows: Sequence[Row], rng: np.random.Generator) -> list[Score]:
    of = lambda *kinds: [r for r in rows if r["kind"] in kinds]  # noqa: E731
    nulls, singles, duels = of("null"), of("single"), of("duel")
    known = [r for r in of("single", "duel", "regime", "onset") if r["strength"] >= SEEN]
    named = [r for r in known if r["named"]]
    strong, ten = at_least(singles, 20.0), [r for r in singles if 6.0 <= r["strength"] < 20.0]
    values = lambda rows, name: [r.get(name, np.nan) for r in rows]  # noqa: E731
    return [
        share("false alarms on nulls", "at most 1 %", nulls, lambda r: not r["right_verdict"]),
        share("nulls on which nothing is concluded", "-", nulls, lambda r: r["inconclusive"]),
        share("top-1, 30 nats and more", "97 %", strong, lambda r: r["top1"]),
        share("top-1, 10 nats", "85 %", ten, lambda r: r["top1"]),
        share("top-1 or in a declared tie, 30 nats and more", "95 %", strong, lambda r: r["tied"]),
        share("top-1 or in a declared tie, 10 nats", "75 %", ten, lambda r: r["tied"]),
        share("the right name and no other, 30 nats and more", "90 % of arms", strong, lambda r: r["alone"]),
        share("confident-wrong on duels", "at most 1 %", duels, lambda r: r["confident_wrong"]),
        share("confident-wrong on all single effects", "-", known, lambda r: r["confident_wrong"]),
        share("coverage of credible sets, where an effect is named", "93 to 97 %", named, lambda r: r["covered"]),
        average("size of credible sets", "at most 1.5", values(named, "set_size"), np.mean, rng),
        average("set F1, pairs", ".95", values(of("pair"), "set_f1"), np.mean, rng),
        average("set F1, triples", ".85", values(of("triple"), "set_f1"), np.mean, rng),
        average("set F1, pairs, declared ties counted as right", ".95",
                values(of("pair"), "set_f1_tied"), np.mean, rng),
        average("set F1, triples, declared ties counted as right", ".85",
                values(of("triple"), "set_f1_tied"), np.mean, rng),
        average("outputs F1, where the name is right", ".98", values(known, "outputs_f1"), np.mean, rng),
        share("ties settled by the prescribed experiment", "95 %", [r for r in rows if "settled" in r],
              lambda r: r["settled"]),
        average("regime overlap", ".85", values(of("regime"), "regime_overlap"), np.mean, rng),
        average("onset error, median, where the name is right [steps]", "5",
                values(known, "onset_error"), np.median, rng),
        average("constants: median relative error, 30 nats and more", "5 %",
                values(at_least(known, 20.0), "constant_error"), np.median, rng),
        share("constants: coverage of 95 % intervals", "95 %", [r for r in known if "constant_held" in r],
              lambda r: r["constant_held"]),
        share("constants: within 5 %, or in their interval", "-", [r for r in known if "constant_held" in r],
              lambda r: r["constant_held"] or r["constant_error"] <= CLOSE),
        average("share of the true form's improvement, 50 steps", ".97", values(rows, "share"), np.median, rng),
        average("the same, black box", "-", values(rows, "share_black_box"), np.median, rng),
        share("wrong names outside the vocabulary", "at most 3 %", of("outside"), lambda r: bool(r["answer"])),
        share("outside the vocabulary, reported as missing physics", "-", of("outside"), lambda r: r["right_verdict"]),
        share("outside the vocabulary, surely wrong", "0", of("outside"), lambda r: r["confident_wrong"]),
        share("wrong parameters, called that and nothing else", "90 %", of("parameters"), lambda r: r["right_verdict"]),
        average("wrong parameters: median relative error after the refit", "5 %",
                values(of("parameters"), "parameter_error"), np.median, rng),
        average("open-loop error of the corrected model, in noise, median", "at most 1.5",
                values(of("single", "parameters"), "open_loop"), np.median, rng),
        average("the same, of the model as it is", "-",
                values(of("single", "parameters"), "open_loop_nominal"), np.median, rng),
        share("causes in a physics engine, named rightly", "-", of("engine"), lambda r: r["top1"]),
        share("spikes in real recordings, named rightly", "-", of("real"), lambda r: r["top1"]),
        average("seconds per case", "30 s for 3,000 transitions", values(rows, "seconds"), np.median, rng),
        share("cases that failed", "0", rows, lambda r: r["error"] is not None),
    ]  # fmt: skip


HEADLINE = {
    "false alarms on nulls": "false_alarms",
    "top-1, 30 nats and more": "right_name",
    "causes in a physics engine, named rightly": "right_name",
    "spikes in real recordings, named rightly": "right_name",
    "confident-wrong on all single effects": "sure_wrong",
}
"""Scores that `dvc metrics show` prints, by their names in the table; no suite has two of one name."""


def headline(table: Sequence[Score]) -> dict[str, float]:
    """The few scores by which versions of the diagnosis are compared."""
    return {HEADLINE[score.name]: score.value for score in table if score.name in HEADLINE}


def at_least(rows: Sequence[Row], strength: float) -> list[Row]:
    return [r for r in rows if r["strength"] >= strength]


def power(rows: Sequence[Row]) -> list[Row]:
    """Shares of single effects named rightly, wrongly and not at all, by strength."""
    singles = [r for r in rows if r["kind"] in ("single", "duel")]
    found = []
    for low, high in BINS:
        mine = [r for r in singles if low <= r["strength"] < high]
        hits = sum(r["top1"] for r in mine)
        bounds = wilson(hits, len(mine))
        found.append({"from_nats": low, "to_nats": high, "n": len(mine), "right": hits / max(len(mine), 1),
                      "low": bounds[0], "high": bounds[1],
                      "wrong": sum(r["named"] and not r["top1"] for r in mine) / max(len(mine), 1),
                      "unexplained": sum(r["verdict"] == "unexplained" for r in mine) / max(len(mine), 1)})  # fmt: skip
    return found


def reliability(rows: Sequence[Row]) -> list[Row]:
    """How often the first name is right, by the probability that was stated for it."""
    named = [r for r in rows if r["kind"] in ONE and r["named"]]
    found = []
    for low, high in ((0.0, 0.5), (0.5, 0.7), (0.7, 0.85), (0.85, 0.95), (0.95, 0.99), (0.99, 1.01)):
        mine = [r for r in named if low <= r["probability"] < high]
        if mine:
            hits = sum(r["top1"] for r in mine)
            bounds = wilson(hits, len(mine))
            found.append({"stated": float(np.mean([r["probability"] for r in mine])), "right": hits / len(mine),
                          "low": bounds[0], "high": bounds[1], "n": len(mine)})  # fmt: skip
    return found


def failures(rows: Sequence[Row]) -> list[Row]:
    """Cases that went wrong, the worst first: broke off, cried wolf, surely wrong, wrong, missed, half right."""
    order = []
    for r in rows:
        rank = _rank(r)
        if rank is not None:
            order.append((rank, -r["strength"], r["case"], r))
    return [r for *_, r in sorted(order, key=lambda o: o[:3])]


QUIET = ("nothing", "inconclusive")
"""Verdicts that claim nothing."""
FAULTS = ("broke off", "false alarm", "surely wrong", "wrong name", "nothing said", "wrong set", "name beyond words",
          "not seen", "further name")  # fmt: skip


def fault(row: Row) -> str:
    """What is wrong with a case, in words; empty where nothing is."""
    rank = _rank(row)
    return "" if rank is None else FAULTS[rank]


def _rank(r: Row) -> int | None:
    kind, seen = r["kind"], r["strength"] >= 6.0
    if r["error"] is not None:
        return 0
    if kind == "null":
        return None if r["right_verdict"] else 1
    if kind == "parameters":
        return None if r["right_verdict"] else 7 if r["verdict"] in QUIET else 1
    if kind == "outside":
        return 6 if r["answer"] else 7 if not r["right_verdict"] and seen else None
    if r["confident_wrong"]:
        return 2
    if kind in MANY:
        return 5 if r["set_f1"] < 1 else None
    if r["top1"]:
        return None if r["alone"] else 8
    return 3 if r["named"] else 4 if seen else None
