"""Hidden states behind joints, in the layout of diagnosis.json and in words."""

from typing import Any

from simgap.diagnosis.inference.explanation import Explanation, Hidden
from simgap.diagnosis.report.answers import credible_set
from simgap.diagnosis.report.names import listed, quantity, title
from simgap.diagnosis.report.schema import NO_LIMITS


def hidden_effects(found: Explanation) -> list[dict[str, Any]]:
    """The hidden states that are named, as effects; `parameters`: those of the simulator, fitted with it."""
    return [_effect(h) | {"parameters": h.phi.tolist()} for h in found.hidden if h.named]


def _effect(h: Hidden) -> dict[str, Any]:
    term = h.term
    constant = {"name": term.constant, "value": h.value, "unit": term.unit, "ci95": list(h.ci95)}
    text = term.says.format(**{term.constant: quantity(constant)})
    return {
        "id": term.effect, "form": term.form, "where": term.where, "probability": h.odds[term.effect],
        "channels": list(term.channels), "outputs": list(term.outputs),
        "statement": f"{text[0].upper()}{text[1:]} ({term.where}; its encoder is at the {term.form}).",
        "constants": [constant], "credible_set": credible_set(h.odds), "gain_nats": h.gain, "misfit_nats": 0.0,
        "heldout_gain_nats": h.heldout_gain, "support": NO_LIMITS | {"kind": "always"},
    }  # fmt: skip


def notes(found: Explanation) -> list[str]:
    """Which models of the report have a hidden state that is named."""
    named = [h for h in found.hidden if h.named]
    return [_in_simulator(h) if h is named[0] else _left_out(h) for h in named]


def _in_simulator(h: Hidden) -> str:
    others = listed([title(name) for name in h.replaces]) if h.replaces else "nothing"
    return (
        f"The corrected simulator has {title(h.term.effect)} at {h.term.where} as two more states, which are zero "
        "where a session starts; open-loop errors are of this simulator. The scores after some steps and the pictures "
        f"of forecasts are of the simulator with {others} in its place. Effects on the noise were not searched for."
    )


def _left_out(h: Hidden) -> str:
    return (
        f"The corrected simulator lacks {title(h.term.effect)} at {h.term.where}: it was fitted without the other "
        "hidden state, and a simulator has one."
    )
