"""Sentences of a diagnosis."""

from collections.abc import Mapping, Sequence
from typing import Any

from simgap.diagnosis.hypotheses.space import Hypothesis
from simgap.diagnosis.report import forecasts
from simgap.diagnosis.report.experiment import RUNS, Experiment
from simgap.diagnosis.report.names import (
    by_certainty,
    either,
    like_parameters,
    listed,
    number,
    outside,
    quantity,
    tied,
    title,
)
from simgap.effects import CATALOGUE


def effect(hypothesis: Hypothesis, constants: list[dict[str, Any]], support: Mapping[str, Any]) -> str:
    """One effect: its law with its constants, and where and when it acts."""
    text = hypothesis.effect.says.format(**{c["name"]: quantity(c) for c in constants})
    # Along one axis of a body that turns, an effect shows in two outputs.
    shown = (hypothesis.where,) if hypothesis.where in hypothesis.outputs else hypothesis.outputs
    # A joint, an actuator or a body of an engine by its own name.
    own = hypothesis.effect.place == "engine" and len(hypothesis.sites) == 1 and hypothesis.where != "all"
    where = hypothesis.where if own else ", ".join(hypothesis.channels or shown) or hypothesis.where
    limits = acts(support)
    return f"{text[0].upper()}{text[1:]} ({where})." + (f" It acts only {limits}." if limits else "")


def acts(support: Mapping[str, Any] | None) -> str:
    """Where and when an effect acts: `where reach > 0.9 m`; empty if it always does."""
    match support:
        case {"kind": "regime", "regime": regime}:
            return f"where {regime}"
        case {"kind": "from", "from_s": from_s}:
            return f"from {from_s:.1f} s on in every session"
        case {"kind": "window", "session": session, "from_s": from_s, "to_s": to_s}:
            return f"from {from_s:.1f} s to {to_s:.1f} s of session {session}"
    return ""


NO_COMMANDS = "The machine takes no commands, so no experiment can be proposed."


def experiment(designed: Experiment, ids: Sequence[str]) -> str:
    """What to command, and what for."""
    return (
        f"To separate {title(ids[0])} from {title(ids[1])}, start at rest and command {designed.words} for "
        f"{designed.time_s[-1]:.0f} s, {RUNS} times from different places. If it is {title(ids[0])}, it gains "
        f"{designed.nats:,.0f} nats, even with all constants of {title(ids[1])} fitted again."
    )


def law(term: dict[str, Any]) -> str:
    """A term of the nonparametric law."""
    return f"an unexplained push on {term['axis']} depends on {' and '.join(term['depends_on'])}"


def insufficient(diagnosis: dict[str, Any]) -> list[dict[str, str]]:
    """Why the recordings cannot show whether something is missing, and what would help."""
    seen, reasons = diagnosis["sensitivity"], []

    def add(reason: str, remedy: str) -> None:
        reasons.append({"reason": reason, "remedy": remedy})

    if seen["segments"] < seen["least_segments"]:
        add(
            f"the fitted recordings have {seen['segments']} independent segments; a diagnosis needs at least "
            f"{seen['least_segments']}",
            f"Record at least {seen['least_rows']} rows in the sessions that are fitted",
        )
    if not diagnosis["fit"]["models"]:
        add(
            "the held-out sessions are too short to score a forecast",
            f"Record held-out sessions of at least {diagnosis['fit']['least_rows']} rows",
        )
    if shown := diagnosis["recordings"]["heldout_only"]:
        sessions = listed(diagnosis["recordings"]["heldout_sessions"])
        add(
            f"held-out sessions ({sessions}) show what the fitted ones do not, most like {title(shown['effect'])} on "
            f"{shown['where']}",
            "Give such sessions among those that are fitted, or record more like them",
        )
    if beyond := diagnosis["parameters"]["beyond"]:
        low, high = ({name: ends[k] for name, ends in diagnosis["parameters"]["ranges"].items()} for k in (0, 1))
        values = [f"{n} = {number(v)} (range {number(low[n])} to {number(high[n])})" for n, v in beyond.items()]
        add(
            f"parameters outside their declared ranges would explain the recordings: {listed(values)}",
            "Widen the ranges if these values are plausible; if they are not, physics is missing",
        )
    if channels := seen["unexcited_channels"]:
        add(
            f"no effect of a usual size on {listed(channels)} would have been found",
            f"Record steps and reversals of {listed(channels)} over the usual range",
        )
    if hidden := seen["undetectable_effects"]:
        where = dict.fromkeys(v["where"] for v in seen["effects"] if v["effect"] in hidden)
        add(
            f"{listed([title(e) for e in hidden])} of a usual size would not have been found anywhere",
            f"Record longer sessions with more motion of {listed(list(where))}",
        )
    return reasons


def statement(diagnosis: dict[str, Any]) -> str:
    """The diagnosis in a few sentences."""
    lines = _VERDICTS[diagnosis["verdict"]](diagnosis)
    ties = tied(diagnosis)
    if matches := " ".join(e["statement"] for e in diagnosis["closest_matches"] if e not in ties):
        lines += f" Closest match, which explains only part of the mismatch: {matches}"
    if diagnosis["verdict"] == "missing_physics":
        lines += forecasts.improvement(diagnosis)
    return lines


def _nothing(diagnosis: dict[str, Any]) -> str:
    return "Nothing is missing: the simulator and the recordings differ by noise." + _would_show(diagnosis)


def _parameters_only(diagnosis: dict[str, Any]) -> str:
    off = _off(diagnosis["parameters"])
    which = f": {listed(off)}" if off else ", though none is by itself certain to have another value"
    return (
        f"No physics is missing; the simulator's parameters were off and are refitted{which}.{_would_show(diagnosis)}"
    )


def _off(parameters: dict[str, Any]) -> list[str]:
    """Parameters whose 95 % interval excludes their nominal value, the one that moved furthest in its range first."""

    def moved(name: str) -> float:
        low, high = parameters["ranges"][name]
        return abs(parameters["fitted"][name] - parameters["nominal"][name]) / max(high - low, 1e-12)

    def value(of: str, name: str) -> str:
        return quantity({"value": parameters[of][name], "unit": parameters["units"][name]})

    outside = [n for n, (low, high) in parameters["ci95"].items() if not low <= parameters["nominal"][n] <= high]
    return [f"{n} is {value('fitted', n)}, not {value('nominal', n)}" for n in sorted(outside, key=moved, reverse=True)]


def _inconclusive(diagnosis: dict[str, Any]) -> str:
    reasons = "; ".join(r["reason"] for r in diagnosis["insufficient"])
    remedies = ". ".join(r["remedy"] for r in diagnosis["insufficient"])
    moved = " Other parameters fit the held-out sessions better." if diagnosis["parameters"]["moved"] else ""
    return f"Cannot say whether physics is missing: {reasons}. {remedies}.{moved}"


def _tie(effect: Mapping[str, Any]) -> str:
    return (
        f"With a probability of {1 - effect['outside']:.0%} this is missing: {either(effect)}; the recordings cannot "
        f"tell which. If it is {title(effect['id'])}: {effect['statement']}"
    )


def _unexplained(diagnosis: dict[str, Any]) -> str:
    where = ", ".join(o["name"] for o in diagnosis["located"]["outputs"][:3])
    depends = ", ".join(d["input"] for d in diagnosis["located"]["depends_on"][:3])
    better_at = diagnosis["fit"]["black_box_better_at"]
    first = " ".join(map(_tie, tied(diagnosis))) or "Something is missing that none of the known effects explains."
    return (
        first
        + (f" It shows in {where}." if where else "")
        + (f" It depends most on {depends}." if depends else "")
        + (f" On held-out sessions a black box predicts better after {listed([forecasts.steps(h) for h in better_at])}."
           if better_at else "")
    )  # fmt: skip


def _missing_physics(diagnosis: dict[str, Any]) -> str:
    certain, likely = (" ".join(map(_named, effects)) for effects in by_certainty(diagnosis["effects"]))
    lines = f"The simulator leaves out: {certain}" if certain else ""
    if likely:
        lines += (" It probably also leaves out: " if certain else "The simulator probably leaves out: ") + likely
    more = []
    if diagnosis["whiteness"]["outputs"]:
        shares = [
            f"{o['share']:.0%} of the residual variance in {o['name']}" for o in diagnosis["whiteness"]["outputs"][:3]
        ]
        more.append(f"{listed(shares)} can be predicted from earlier rows")
    more += [law(term) for term in diagnosis["nonparametric"]]
    if diagnosis["more_missing"] or more:
        lines += " Something else is missing as well" + (f": {'; '.join(more)}." if more else ".")
    acts_in = [e["support"]["regime"] for e in diagnosis["effects"]]
    elsewhere = [r for r in diagnosis["located"]["regimes"] if r["regime"] not in acts_in]
    if elsewhere:
        rule = elsewhere[0]
        lines += f" {rule['share']:.0%} of the mismatch lies where {rule['regime']} ({rule['rows']:.0%} of the rows)."
    return lines


_VERDICTS = {
    "nothing": _nothing,
    "parameters_only": _parameters_only,
    "inconclusive": _inconclusive,
    "unexplained": _unexplained,
    "missing_physics": _missing_physics,
}


def _named(effect: Mapping[str, Any]) -> str:
    """A named effect, what else in its credible set it may be, and how likely its cause is none of these."""
    others = [title(name) for name in effect["credible_set"] if name != effect["id"]]
    lines = [effect["statement"]]
    if others:
        lines.append(f"The recordings cannot tell this from {listed(others)}: that it is {title(effect['id'])} has a "
                     f"probability of {effect['probability']:.0%}.")  # fmt: skip
    if other := outside(effect):
        lines.append(f"With a probability of {other:.0%} the cause is another one, which looks like it.")
    return " ".join(lines)


def _would_show(diagnosis: dict[str, Any]) -> str:
    """What would have been found, and at what size: one example for every place where laws act."""
    seen, place_of = diagnosis["sensitivity"], {e.id: e.place for e in CATALOGUE}
    first: dict[str, dict[str, Any]] = {}
    for v in seen["effects"]:
        if v["size"] is not None:
            first.setdefault(place_of.get(v["effect"], "engine"), v)  # an effect outside the catalogue is an engine's
    sizes = [f"{title(v['effect'])} on {v['where']} ({v['constant']} {sized(v)})" for v in first.values()]
    found = f" With a probability of {seen['power']:.0%} these would have been found, for example: {'; '.join(sizes)}."
    return f"{found} {like_parameters(seen['imitated_effects'])}".rstrip()


def sized(visible: dict[str, Any]) -> str:
    """The smallest detectable size of an effect, with its unit."""
    return quantity({"value": visible["size"], "unit": visible["unit"]})
