"""The HTML page of a diagnosis, with its figures drawn."""

from collections.abc import Mapping, Sequence
from typing import Any

from simgap.page import drawings, render
from simgap.page.figures import Figures
from simgap.page.marks import MODELS

Values = Mapping[str, Any]

_FLOOR, _FLOOR_OF_NOISE = 0.02, 0.5  # minimum top of the colour scales [nats a row]: noise stays pale


def page(diagnosis: Values, evidence: Values) -> str:
    """The HTML document; `diagnosis` is what diagnosis.json holds, `evidence` the arrays behind its pictures."""
    return render.page(diagnosis, figures(diagnosis, evidence))


def figures(diagnosis: Values, evidence: Values) -> Figures:
    """Draw the page's figures."""
    floor = _FLOOR_OF_NOISE if diagnosis["verdict"] in ("nothing", "inconclusive") else _FLOOR
    intervals = (diagnosis.get("located") or {}).get("intervals") or []
    panels, experiment = evidence.get("rollouts") or [], evidence.get("experiment")
    sessions = dict.fromkeys(p["session"] for p in panels)
    return Figures(
        heat=_heat(evidence.get("heat"), floor),
        strips=_strips(evidence.get("strips") or [], intervals, floor),
        laws=[{**law, "svg": drawings.law(law)} for law in evidence.get("laws") or []],
        rollouts=[_rollouts(session, [p for p in panels if p["session"] == session]) for session in sessions],
        commands=_commands(experiment) if experiment else None,
    )


def _heat(heat: Values | None, floor: float) -> Values | None:
    if not heat or not len(heat["outputs"]) or not len(heat["regimes"]):
        return None
    return {**heat, "top": drawings.top_of_scale([heat["values"]], floor)}


def _strips(strips: Sequence[Values], intervals: Sequence[Values], floor: float) -> Values | None:
    if not strips:
        return None
    top = drawings.top_of_scale([s["excess"] for s in strips], floor)
    return {"svg": drawings.strips(strips, intervals, top), "top": top}


def _rollouts(session: Any, panels: Sequence[Values]) -> Values:
    drawn = [m for m in MODELS if any(p.get(m) is not None for p in panels)]
    return {"session": session, "models": drawn, "svg": drawings.rollouts(panels)}


def _commands(experiment: Values) -> Values | None:
    moving = drawings.moving_channels(experiment)
    still = [name for name in experiment["channels"] if name not in moving]
    return {"svg": drawings.commands(experiment), "still": still} if moving else None
