"""A diagnosis in an engineer's words."""

from collections.abc import Sequence
from typing import Any

from simgap.diagnosis.candidates import Candidate
from simgap.diagnosis.experiment import Experiment
from simgap.diagnosis.when import When


def number(value: float) -> str:
    """Three significant digits."""
    return f"{value:.3g}"


def quantity(constant: dict[str, Any]) -> str:
    """Value and unit."""
    unit = "" if constant["unit"] == "-" else f" {constant['unit']}"
    return f"{number(constant['value'])}{unit}"


def effect(candidate: Candidate, constants: list[dict[str, Any]]) -> str:
    """One effect: its law with its constants, and where it acts."""
    said = candidate.effect.says.format(**{c["name"]: quantity(c) for c in constants})
    # Along one axis of a body that turns it shows in two outputs.
    shown = (candidate.where,) if candidate.where in candidate.outputs else candidate.outputs
    where = ", ".join(candidate.channels or shown) or candidate.where
    return f"{said[0].upper()}{said[1:]} ({where})."


def during(when: When | None, session: str | None, regime: str | None) -> str:
    """When an effect acts, if not throughout."""
    if when is None:
        return ""
    if regime is not None:
        return f" It acts where {regime} only."
    if session is None:
        return f" It acts from {when.from_s:.1f} s on in every session."
    return f" It acts from {when.from_s:.1f} s to {when.to_s:.1f} s of session {session} only."


NO_COMMANDS = "The machine takes no commands, so no experiment can be proposed."


def experiment(designed: Experiment, ids: Sequence[str]) -> str:
    """What to command, and what for."""
    return (
        f"To tell {ids[0]} from {ids[1]}, start at rest and command {designed.words}; "
        f"the two differ there by {designed.nats:,.0f} nats in {designed.time_s[-1]:.0f} s."
    )


def blind(power: float) -> str:
    """Why an effect could not have been seen."""
    return (
        "the recordings hardly excite it: at a usual strength, beyond what the parameters absorb, it would change the "
        f"likelihood by {power:.1f} nats"
    )


def law(term: dict[str, Any]) -> str:
    """A term of a law without a name."""
    return f"{term['axis']} is pushed, depending on {' and '.join(term['depends_on'])}"


def statement(told: dict[str, Any]) -> str:
    """The diagnosis in a few sentences."""
    models = told["fit"]["models"]
    lines = {
        "nothing": "Nothing is missing: the simulator and the recordings differ by noise.",
        "parameters_only": "No physics is missing; the simulator's parameters were off and are refitted.",
        "unexplained": "Something is missing that the vocabulary does not explain.",
        "missing_physics": "The simulator leaves out: " + " ".join(e["statement"] for e in told["effects"]),
    }[told["verdict"]]
    if told["verdict"] == "unexplained":
        where = ", ".join(o["name"] for o in told["located"]["outputs"][:3])
        depends = ", ".join(d["input"] for d in told["located"]["depends_on"][:3])
        lines += f" It shows in {where}." if where else ""
        lines += f" It depends most on {depends}." if depends else ""
    if told["resembles"]:
        lines += " There is something that looks like this, and is more than this: "
        lines += " ".join(e["statement"] for e in told["resembles"])
    if told["left_over"]["outputs"] and told["verdict"] == "missing_physics":
        lines += " More is missing: " + ", ".join(
            f"{o['share']:.0%} of what is left in {o['name']}" for o in told["left_over"]["outputs"][:3]
        ) + " can be foretold from the rows before."  # fmt: skip
    if told["law"] and told["verdict"] == "missing_physics":
        lines += " And more that is not named: " + "; ".join(law(term) for term in told["law"]) + "."
    acts_in = [e["regime"] for e in told["effects"]]
    elsewhere = [r for r in told["located"]["regimes"] if r["when"] not in acts_in]
    if elsewhere and told["verdict"] == "missing_physics":
        rule = elsewhere[0]
        lines += f" {rule['share']:.0%} of the mismatch lies where {rule['when']} ({rule['rows']:.0%} of the rows)."
    return lines + _improvement(models)


def _improvement(models: dict[str, Any]) -> str:
    if "augmented" not in models or "refitted" not in models:
        return ""
    before, after = models["refitted"], models["augmented"]
    longest = max((m for m in before if m.startswith("error_") and "[" not in m), key=lambda m: int(m.split("_")[1]))
    steps = longest.split("_")[1]
    return (
        f" On sessions it never saw, the error after {steps} steps goes from {before[longest]['value']:.1%} to "
        f"{after[longest]['value']:.1%} of the motion, the one-step log-likelihood up by "
        f"{before['nll_1']['value'] - after['nll_1']['value']:.2f} nats a row, against the refitted simulator."
    )
