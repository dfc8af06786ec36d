"""A diagnosis as a page for people: one HTML document with everything in it, for the screen and for print.

`diagnosis` is what diagnosis.json holds; `evidence` holds the arrays behind its pictures. A part that is absent is left
out, a section with nothing to say says so. Names and statements come from recordings and are escaped wherever shown.
"""

import base64
import math
import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from simgap.diagnosis.report.wording import NO_COMMANDS
from tasks import diagnosis_plots as plots

Values = Mapping[str, Any]

_VERDICTS = {
    "missing_physics": ("Physics is missing", "#b3401f"),
    "parameters_only": ("Only parameters were wrong", "#8a6100"),
    "nothing": ("Nothing is missing", "#2b7a4b"),
    "unexplained": ("Unexplained mismatch", "#6b3fa0"),
    "inconclusive": ("Cannot say", "#5b6472"),
}
_NO_EFFECTS = {
    "missing_physics": "No effect is described.",
    "parameters_only": "No physics is missing: other parameters of the simulator explain the difference (section 5).",
    "nothing": "No physics is missing: what the simulator and the recordings differ by is noise.",
    "unexplained": "Something is missing that no effect of the vocabulary explains; section 1 says where it shows.",
    "inconclusive": "Whether an effect is missing cannot be said:",
}
_FLOOR, _FLOOR_OF_NOISE = 0.02, 0.5  # least top of the colour scales [nats a row]; noise is not to glow
_CANDIDATES, _INTERVALS, _SESSIONS = 8, 8, 6  # shown at most
_DASH, _MINUS = "\N{EN DASH}", "\N{MINUS SIGN}"
_WIDE_HEAT = 9  # regimes beyond which their labels stand upright


def page(diagnosis: Values, evidence: Values) -> str:
    """The whole document."""
    sections = (
        ("Where is the mismatch?", _where(diagnosis, evidence)),
        ("What is missing?", _what(diagnosis, evidence)),
        ("Does it help?", _fit(diagnosis, evidence)),
        ("What else could it be?", _alternatives(diagnosis, evidence)),
        ("What became of the parameters?", _parameters(diagnosis)),
        ("What was tried, and what could not be seen?", _tried(diagnosis)),
    )
    title = f"Diagnosis of {escape(str(diagnosis.get('simulator', 'the simulator')))}"
    body = "".join(
        f'<section><h2><span class="number">{k}</span>{heading}</h2>{content}</section>'
        for k, (heading, content) in enumerate(sections, 1)
    )
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{_CSS}</style></head>\n<body><main>{_headline(title, diagnosis)}{body}</main></body></html>\n"
    )


# Headline


def _headline(title: str, diagnosis: Values) -> str:
    verdict = str(diagnosis["verdict"])
    words, colour = _VERDICTS.get(verdict, (verdict, plots.GREY))
    return (
        f'<header><div class="kicker"><h1>{title}</h1><span class="badge" style="background:{colour}">{escape(words)}'
        f"</span></div>{_warnings(diagnosis.get('warnings') or [])}"
        f'<p class="statement">{escape(str(diagnosis.get("statement", "")))}</p>'
        f"{_tiles(diagnosis)}{_recordings(diagnosis.get('recordings') or {})}</header>"
    )


def _warnings(lines: Sequence[str]) -> str:
    return f'<ul class="warnings">{"".join(f"<li>{escape(line)}</li>" for line in lines)}</ul>' if lines else ""


def _tiles(diagnosis: Values) -> str:
    effects, fit = diagnosis.get("effects") or [], diagnosis.get("fit") or {}
    tiles = []
    if effects:
        named = "; ".join(" or ".join(_title(m) for m in e.get("credible_set") or [e["id"]]) for e in effects)
        tiles.append((named, "named as missing" if len(effects) == 1 else "named as missing, together"))
    elif diagnosis.get("rounds"):
        tiles += _closest(diagnosis["rounds"][-1])
    models = fit.get("models") or {}
    metric = max((m for m in _metrics(models) if _horizon(m)), key=lambda m: _horizon(m) or 0, default=None)
    if metric:
        shown = [
            (label, models[m][metric]["value"])
            for m, label in plots.MODELS.items()
            if m != "black_box" and metric in (models.get(m) or {})
        ]
        values = [_number(v) for _, v in shown]
        labels = " → ".join(label for label, _ in shown)
        tiles.append((" → ".join(values), f"held-out {_metric(metric, False).lower()}: {labels}"))
    if effects and _known(fit.get("explained_share")):
        tiles.append(
            (_percent(fit["explained_share"]), "of what a black box can remove is removed by the effects found")
        )
    if not tiles:
        return ""
    items = "".join(f"<li><b>{escape(value)}</b><span>{escape(label)}</span></li>" for value, label in tiles)
    return f'<ul class="tiles">{items}</ul>'


def _closest(tried: Values) -> list[tuple[str, str]]:
    """The tile of the effect that came closest to being accepted."""
    candidates, threshold = tried.get("candidates") or [], tried.get("threshold_nats")
    best = max(candidates, key=lambda c: c["gain_nats"] or 0.0, default=None)
    if best is None or threshold is None or (best["gain_nats"] or 0.0) >= threshold:
        return []
    gains = f"{_fixed(best['gain_nats'], 1)} < {_fixed(threshold, 1)} nats"
    return [(gains, f"gained by the best effect tried ({_title(best['effect'])}): too little to name it")]


def _recordings(recordings: Values) -> str:
    facts = []
    if recordings.get("transitions") is not None:
        facts.append(f"{recordings['transitions']:,} transitions")
    if _known(recordings.get("duration_s")):
        facts.append(_duration(recordings["duration_s"]))
    for key, what in (("training_sessions", "for fitting"), ("heldout_sessions", "held out")):
        sessions = recordings.get(key) or []
        names = _listed(sessions, _SESSIONS)
        facts.append(f"{_count(len(sessions), 'session')} {what}{f' ({names})' if names else ''}")
    if recordings.get("baseline"):
        facts.append(f"compared with the baseline {escape(str(recordings['baseline']))}")
    return f'<p class="facts">{" · ".join(facts)}</p>'


# Where


def _where(diagnosis: Values, evidence: Values) -> str:
    located = diagnosis.get("located") or {}
    outputs, regimes = located.get("outputs") or [], located.get("regimes") or []
    intervals = located.get("intervals") or []
    heat, strips = evidence.get("heat"), evidence.get("strips") or []
    floor = _FLOOR_OF_NOISE if diagnosis["verdict"] in ("nothing", "inconclusive") else _FLOOR
    parts = [f"<p>Excess is error beyond what noise accounts for. {_located(outputs, regimes, intervals)}</p>"]
    tables = [_excess_of_outputs(outputs)] if outputs else []
    tables += [_excess_of_regimes(regimes)] if regimes else []
    if tables:
        parts.append(f'<div class="pair">{"".join(tables)}</div>')
    if heat and len(heat["outputs"]) and len(heat["regimes"]):
        parts.append(_heat(heat, floor))
    if strips:
        parts.append(_strips(strips, intervals, floor))
    if intervals:
        parts.append(_listed_intervals(intervals))
    return "".join(parts)


def _located(outputs: Sequence[Values], regimes: Sequence[Values], intervals: Sequence[Values]) -> str:
    said = []
    if outputs:
        worst = max(outputs, key=lambda o: o["excess"])
        said.append(
            f"It is greatest in {_code(worst['name'])}: {_percent(worst['excess'])} of the error of that output."
        )
    if regimes:
        top = max(regimes, key=lambda r: r["share"])
        rows = f", which is {_percent(top['rows'])} of the rows" if _known(top.get("rows")) else ""
        said.append(f"{_percent(top['share'])} of all excess falls where <b>{escape(str(top['when']))}</b>{rows}.")
    if intervals:
        said.append(f"It stands out in {_count(len(intervals), 'interval')} of time.")
    return " ".join(said) or "No output, regime or time stands out."


def _excess_of_outputs(outputs: Sequence[Values]) -> str:
    rows = "".join(
        f"<tr><th>{_code(o['name'])}</th><td class='wide'>{_bar(o['excess'], plots.shade(0.6))}</td>"
        f"<td class='n'>{_percent(o['excess'])}</td></tr>"
        for o in sorted(outputs, key=lambda o: -o["excess"])
    )
    return f"<table class='bars'><caption>Outputs: excess as a share of their error</caption>{rows}</table>"


def _excess_of_regimes(regimes: Sequence[Values]) -> str:
    rows = "".join(
        f"<tr><th>{escape(str(r['when']))}</th><td class='wide'>{_bar(r['share'], plots.shade(0.6))}"
        f"{_bar(r.get('rows'), '#b9bec6')}</td><td class='n'>{_percent(r['share'])}"
        f"<small>{_percent(r.get('rows'))}</small></td></tr>"
        for r in sorted(regimes, key=lambda r: -r["share"])
    )
    return f"<table class='bars'><caption>Regimes: share of all excess, and (grey) of the rows</caption>{rows}</table>"


def _heat(heat: Values, floor: float) -> str:
    values = [[float(v) for v in row] for row in heat["values"]]
    top = plots.top_of_scale(values, floor)
    upright = " upright" if len(heat["regimes"]) > _WIDE_HEAT else ""
    head = "".join(f"<th><span>{escape(str(r))}</span></th>" for r in heat["regimes"])
    rows = "".join(
        f"<tr><th>{_code(name)}</th>{''.join(_heat_cell(v, top) for v in row)}</tr>"
        for name, row in zip(heat["outputs"], values, strict=True)
    )
    return (
        f"<figure><figcaption><b>Outputs and regimes.</b> Mean excess in nats a row. {_colour_scale(top)}</figcaption>"
        f'<table class="heat{upright}"><tr><td></td>{head}</tr>{rows}</table></figure>'
    )


def _heat_cell(value: float, top: float) -> str:
    if not math.isfinite(value):
        return '<td class="void">no data</td>'
    share = value / top
    ink = "#fff" if share > 0.58 else plots.INK
    digits = 2 if top >= 0.2 else 3
    return f'<td style="background:{plots.shade(share)};color:{ink}">{_fixed(value, digits)}</td>'


def _strips(strips: Sequence[Values], intervals: Sequence[Values], floor: float) -> str:
    top = plots.top_of_scale([s["excess"] for s in strips], floor)
    framed = " Framed: where it stands out." if intervals else ""
    picture = _picture(plots.strips(strips, intervals, top), "Excess error over time, a strip per session")
    return (
        "<figure><figcaption><b>Sessions over time.</b> Smoothed excess of all outputs in nats a row."
        f"{framed} {_colour_scale(top)}</figcaption>{picture}</figure>"
    )


def _listed_intervals(intervals: Sequence[Values]) -> str:
    ordered = sorted(intervals, key=lambda i: -(i.get("share") or 0))
    items = [
        f"{escape(str(i['session']))}, {_fixed(i['from_s'], 1)} to {_fixed(i['to_s'], 1)} s"
        + (f" ({_percent(i['share'])} of all excess)" if _known(i.get("share")) else "")
        for i in ordered[:_INTERVALS]
    ]
    more = f"; and {len(ordered) - _INTERVALS} more" if len(ordered) > _INTERVALS else ""
    return f'<p class="quiet">Intervals: {"; ".join(items)}{more}.</p>'


def _colour_scale(top: float) -> str:
    stops = ", ".join(plots.shade(k / 8) for k in range(9))
    ramp = f'<i style="background:linear-gradient(to right, {stops})"></i>'
    return f'<span class="ramp">0 {ramp} {_number(top, 2)} and more</span>'


# What


def _what(diagnosis: Values, evidence: Values) -> str:
    effects, laws = diagnosis.get("effects") or [], evidence.get("laws") or []
    parts = [_card(effect, [law for law in laws if _shows(law, effect)]) for effect in effects]
    if not effects:
        parts.append(f"<p>{escape(_NO_EFFECTS.get(str(diagnosis['verdict']), 'No effect was found.'))}</p>")
    parts += [_insufficient(diagnosis.get("insufficient") or []) if diagnosis["verdict"] == "inconclusive" else ""]
    parts += [_nearest(diagnosis.get("resembles") or []), _left_over(diagnosis.get("left_over") or {})]
    return "".join([*parts, _law(diagnosis.get("law") or [], bool(effects))])


def _insufficient(reasons: Sequence[Values]) -> str:
    """Why nothing can be concluded, and what to record."""
    items = "".join(f"<li>{escape(r['reason'])}. <b>{escape(r['remedy'])}.</b></li>" for r in reasons)
    return f"<ul>{items}</ul>" if items else ""


def _nearest(resembling: Sequence[Values]) -> str:
    """Effects that are like part of the mismatch, and are not named as missing."""
    if not resembling:
        return ""
    items = "".join(
        f"<li>{escape(str(e.get('statement', '')))} <small>{_fixed(e.get('gain_nats'), 1)} nats</small></li>"
        for e in resembling
    )
    return (
        f"<p>Closest matches, which explain only part of the mismatch and are not named as missing:</p><ul>{items}</ul>"
    )


def _left_over(left: Values) -> str:
    """What the innovations still tell of each other."""
    outputs = left.get("outputs") or []
    if not outputs:
        return ""
    shares = ", ".join(f"{_percent(o['share'])} in {_code(o['name'])}" for o in outputs)
    return (
        f"<p>Noise cannot be foretold, but of what this leaves over the rows before foretell {shares} "
        f"({_fixed(left.get('nats'), 0)} nats): there is more than what is named.</p>"
    )


def _law(terms: Sequence[Values], named: bool) -> str:
    """What pushes the robot, beside what is named if anything is, by what it depends on."""
    if not terms:
        return ""
    items = "".join(
        f"<li>{_code(t['axis'])} by {' and '.join(map(_code, t['depends_on']))} "
        f"<small>{_fixed(t['gain_nats'], 1)} nats</small></li>"
        for t in terms
    )
    something = "Beside all that is named, something" if named else "Something"
    said = f"{something} pushes the robot that depends on its motion, place or commands:"
    return f"<p>{said}</p><ul>{items}</ul>"


def _shows(law: Values, effect: Values) -> bool:
    """Whether a picture is of this effect; there may be others of its id, elsewhere."""
    return law["effect"] == effect["id"] and all(law.get(key) == effect.get(key) for key in ("form", "where"))


def _card(effect: Values, laws: Sequence[Values]) -> str:
    places = [
        f"<div><dt>{label}</dt><dd>{' '.join(_code(n) for n in effect[key])}</dd></div>"
        for key, label in (("channels", "acts on commands"), ("outputs", "shows in outputs"))
        if effect.get(key)
    ]
    gains = [
        f"<b>{_fixed(effect[key], 1)}</b> nats {label}"
        for key, label in (("gain_nats", "on the sessions fitted"), ("heldout_gain_nats", "on held-out sessions"))
        if _known(effect.get(key))
    ]
    if gains:
        places.append(f"<div><dt>gains in likelihood</dt><dd>{', '.join(gains)}</dd></div>")
    if _known(effect.get("from_s")):
        places.append(f"<div><dt>begins</dt><dd><b>{_fixed(effect['from_s'], 1)} s</b> into the session</dd></div>")
    if effect.get("regime"):
        places.append(f"<div><dt>acts where</dt><dd>{_code(effect['regime'])}</dd></div>")
    probability = ""
    if _known(effect.get("probability")):
        share = _percent(effect["probability"])
        bar = _bar(effect["probability"], plots.COLOURS["augmented"])
        probability = f'<div class="probability"><b>{share}</b> probable{bar}</div>'
    text = (
        f'<p class="says">{escape(str(effect.get("statement", "")))}</p>{_constants(effect.get("constants") or [])}'
        f"<dl>{''.join(places)}</dl>{_credible(effect)}"
    )
    beside = " beside" if len(laws) == 1 else ""
    return (
        f'<article class="card{beside}"><div class="top"><h3>{escape(_title(effect["id"]))}</h3>{probability}</div>'
        f'<div class="text">{text}</div>{_laws(laws)}</article>'
    )


def _constants(constants: Sequence[Values]) -> str:
    items = []
    for c in constants:
        value, interval = _with_interval(c.get("value"), c.get("ci95"))
        shown = f"{value} <i>{_unit(c.get('unit'))}</i>"
        items.append(f"<li><span>{escape(_title(c['name']))}</span><b>{shown}</b><small>{interval}</small></li>")
    return f'<ul class="constants">{"".join(items)}</ul>' if items else ""


def _credible(effect: Values) -> str:
    members = [str(m) for m in effect.get("credible_set") or []]
    if not members:
        return ""
    if len(members) == 1:
        said = f"The 95 % credible set is {escape(_title(members[0]))} alone."
    else:
        said = f"One of: <b>{escape(', '.join(_title(m) for m in members))}</b>; these recordings cannot tell which."
    return f'<p class="credible">{said}</p>'


def _laws(laws: Sequence[Values]) -> str:
    figures = []
    for law in laws:
        title, caption = escape(str(law.get("title", ""))), escape(str(law.get("caption", "")))
        picture = _picture(plots.law(law), f"Law of {_title(law['effect'])}: {law.get('title', '')}")
        figures.append(f"<figure><figcaption><b>{title}</b></figcaption>{picture}<small>{caption}</small></figure>")
    return f'<div class="laws">{"".join(figures)}</div>' if figures else ""


# Does it help


def _fit(diagnosis: Values, evidence: Values) -> str:
    fit = diagnosis.get("fit") or {}
    models = fit.get("models") or {}
    panels = evidence.get("rollouts") or []
    parts = []
    if _metrics(models):
        sessions = fit.get("heldout_sessions") or []
        parts += [_share(fit, diagnosis.get("effects") or []), _scores(models, len(sessions))]
    else:
        parts.append("<p>No scores: there was no held-out session to judge by.</p>")
    for session in dict.fromkeys(p["session"] for p in panels):
        parts.append(_rollouts(session, [p for p in panels if p["session"] == session]))
    return "".join(parts)


def _share(fit: Values, effects: Sequence[Values]) -> str:
    share = fit.get("explained_share")
    if not effects or not _known(share):
        return ""
    ends = _interval(fit.get("explained_share_ci95"))
    interval = f" (95 % interval {_percent(ends[0])} to {_percent(ends[1])})" if ends else ""
    return (
        '<div class="share"><p>What was found, nearest words included, removes '
        f"<b>{_percent(share)}</b>{interval} of the error that a black box with the same inputs can remove.</p>"
        f"{_bar(share, plots.COLOURS['augmented'])}</div>"
    )


def _scores(models: Values, sessions: int) -> str:
    named = _named(models)
    head = "".join(f"<th>{_swatch(m)}{plots.MODELS[m]}</th>" for m in named)
    rows = []
    for metric in _metrics(models):
        scores = {m: models[m][metric] for m in named if metric in models[m] and _known(models[m][metric].get("value"))}
        if not scores:
            continue
        best = min(s["value"] for s in scores.values())
        decimals = max((_decimals(s.get("ci95")) or 0 for s in scores.values()), default=0) or None
        cells = "".join(_score(scores.get(m), best, decimals) for m in named)
        marks = [(plots.COLOURS[m], float(s["value"]), _interval(s.get("ci95"))) for m, s in scores.items()]
        rows.append(f"<tr><th>{_metric(metric)}</th>{cells}<td class='marks'>{plots.whiskers(marks)}</td></tr>")
    over = f"On {_count(sessions, 'session')} that took no part in fitting" if sessions else "Held out"
    return (
        f"<table class='scores'><caption>{over}; lower is better, with 95 % intervals, the best in bold</caption>"
        f"<tr><td></td>{head}<td class='marks'><small>each row to its own scale</small></td></tr>"
        f"{''.join(rows)}</table>"
    )


def _score(score: Values | None, best: float, decimals: int | None) -> str:
    if score is None:
        return f"<td class='n'>{_DASH}</td>"
    value, interval = _with_interval(score["value"], score.get("ci95"), decimals)
    value = f"<b>{value}</b>" if score["value"] == best else value
    return f"<td class='n'>{value}<small>{interval}</small></td>"


def _rollouts(session: Any, panels: Sequence[Values]) -> str:
    there = [m for m in plots.MODELS if any(p.get(m) is not None for p in panels)]
    keys = "".join(f"<span>{_swatch(m)}{plots.MODELS[m]}</span>" for m in there)
    picture = _picture(plots.rollouts(panels), f"Measured and predicted outputs of session {session}")
    return (
        f"<figure><figcaption><b>Rolled out on the held-out session {escape(str(session))}.</b> "
        f'<span class="key"><span><i class="dot"></i>measured</span>{keys}</span></figcaption>{picture}'
        "<small>A line that leaves its panel has diverged.</small></figure>"
    )


# Alternatives and the experiment


def _alternatives(diagnosis: Values, evidence: Values) -> str:
    alternatives = diagnosis.get("alternatives") or []
    parts = []
    if alternatives:
        rows = "".join(
            f"<tr><th>{escape(' with '.join(_title(e) for e in a['effects']) or 'nothing missing')}</th>"
            f"<td class='wide'>{_bar(a['probability'], plots.GREY)}</td>"
            f"<td class='n'>{_percent(a['probability'])}</td></tr>"
            for a in sorted(alternatives, key=lambda a: -a["probability"])
        )
        parts.append(
            f"<table class='bars half'><caption>Other explanations and their probability</caption>{rows}</table>"
        )
    experiment = diagnosis.get("experiment")
    silent = NO_COMMANDS in (diagnosis.get("notes") or [])
    unasked = f"no {'experiment can be proposed' if silent else 'further experiment is called for'}.</p>"
    if not alternatives:
        parts.append("<p>No other explanation is in the running" + ("." if experiment else f", and {unasked}"))
    if not experiment:
        return "".join(parts) + (f"<p>{unasked.capitalize()}" if alternatives else "")
    pair = " from ".join(f"<b>{escape(_title(e))}</b>" for e in experiment.get("separates") or [])
    aim = f" It separates {pair}." if pair else ""
    where = f" The commands are in {_code(experiment['commands'])}." if experiment.get("commands") else ""
    parts.append(
        '<div class="experiment"><h3>The experiment that would tell</h3>'
        f"<p>{escape(str(experiment.get('statement', '')))}{aim}{where}</p>"
        f"{_commands(evidence.get('experiment'))}</div>"
    )
    return "".join(parts)


def _commands(experiment: Values | None) -> str:
    if not experiment or not plots.moving_channels(experiment):
        return ""
    still = [name for name in experiment["channels"] if name not in plots.moving_channels(experiment)]
    rest = f"<small>At zero throughout: {' '.join(_code(n) for n in still)}</small>" if still else ""
    return f"<figure>{_picture(plots.commands(experiment), 'Commands over time')}{rest}</figure>"


# Parameters


def _parameters(diagnosis: Values) -> str:
    parameters = diagnosis.get("parameters") or {}
    after = {name: v for name, v in (parameters.get("after") or {}).items() if _known(v)}
    if not after:
        return "<p>The parameters of the simulator were not refitted.</p>"
    before = {name: v for name, v in (parameters.get("before") or {}).items() if _known(v)}
    ends = {name: _interval((parameters.get("ci95") or {}).get(name)) for name in after}
    shifts = {name: _shift(before.get(name), after[name], ends[name]) for name in after}
    moved = [name for name in after if abs(shifts[name] or 0) > 1]
    said = (
        f"{len(moved)} of {_count(len(after), 'parameter')} moved further than the half width of their 95 % interval "
        "(shaded). "
        if moved
        else "No parameter moved further than the half width of its 95 % interval. "
    )
    rows = [_parameter(n, parameters, before.get(n), after[n], ends[n], shifts[n]) for n in after]
    split = math.ceil(len(rows) / 2) if len(rows) > 6 else len(rows)
    head = "<tr><td></td><th>before</th><th>after</th><th>shift</th><th class='l'>plausible range</th></tr>"
    tables = "".join(f"<table class='parameters'>{head}{''.join(r)}</table>" for r in (rows[:split], rows[split:]) if r)
    return (
        f"<p>{said}Shift: in half widths. Bars: the plausible range, a tick where the parameter was, a dot with its "
        f'interval where it is now.</p><div class="pair">{tables}</div>'
    )


def _parameter(
    name: str,
    parameters: Values,
    before: float | None,
    after: float,
    ends: tuple[float, float] | None,
    shift: float | None,
) -> str:
    value, interval = _with_interval(after, ends)
    was = _number(before) if before is None or ends is None else _with_interval(before, ends)[0]
    unit = _unit((parameters.get("units") or {}).get(name))
    limits = _interval((parameters.get("ranges") or {}).get(name))
    bar = plots.range_bar(before, after, ends, limits) if limits else ""
    marked = " class='moved'" if abs(shift or 0) > 1 else ""
    return (
        f"<tr{marked}><th>{escape(name)} <i>{unit}</i></th><td class='n'>{was}</td><td class='n'>{value}"
        f"<small>{interval}</small></td><td class='n'>{_signed(shift)}</td><td>{bar}</td></tr>"
    )


def _shift(before: float | None, after: float, ends: tuple[float, float] | None) -> float | None:
    if before is None or ends is None or ends[1] <= ends[0]:
        return None
    return (after - before) / ((ends[1] - ends[0]) / 2)


# What was tried


def _tried(diagnosis: Values) -> str:
    rounds, notes = diagnosis.get("rounds") or [], diagnosis.get("notes") or []
    parts = [_round(k, r) for k, r in enumerate(rounds, 1)] or ["<p>No effect was tried.</p>"]
    if rounds:
        parts.insert(
            0,
            "<p>In each round every effect is tried in every place, all parameters refitted; the best is accepted if "
            "its gain passes the threshold (line), which is calibrated on data in which nothing is missing.</p>",
        )
    parts.append(_sensitivity(diagnosis.get("sensitivity") or {}))
    if notes:
        parts.append(f"<h3>Notes</h3><ul>{''.join(f'<li>{escape(str(n))}</li>' for n in notes)}</ul>")
    return "".join(parts)


def _sensitivity(seen: Values) -> str:
    """For every effect the smallest size that would have been found, site by site."""
    sites: dict[str, list[Values]] = {}
    for visible in seen.get("effects") or []:
        sites.setdefault(visible["effect"], []).append(visible)
    if not sites:
        return ""
    rows = []
    for effect, visible in sites.items():
        sizes = [f"{_code(v['where'])} {_size(v)}" for v in visible if _known(v["size"])]
        hidden = [_code(v["where"]) for v in visible if not _known(v["size"])]
        rows.append(f"<tr><th>{escape(_title(effect))}</th><td>{', '.join(sizes) or _DASH}</td>"
                    f"<td>{' '.join(hidden) or _DASH}</td></tr>")  # fmt: skip
    return (
        "<h3>What would have been found</h3>"
        f"<details><summary>Smallest sizes that would have been found, each with a chance of "
        f"{_percent(seen.get('chance'))}</summary><table class='sizes'><tr><th>effect</th><th>smallest size</th>"
        f"<th>not visible at</th></tr>{''.join(rows)}</table></details>"
    )


def _size(visible: Values) -> str:
    return f"{visible['constant']} {_number(visible['size'])} {_unit(visible['unit'])}".rstrip()


def _round(k: int, tried: Values) -> str:
    candidates = sorted(tried.get("candidates") or [], key=lambda c: -(c["gain_nats"] or 0))
    accepted, threshold = tried.get("accepted"), tried.get("threshold_nats")
    chance = f", p = {_number(tried['p_value'], 2)}" if _known(tried.get("p_value")) else ""
    limit = f" (threshold {_fixed(threshold, 1)} nats{chance})" if _known(threshold) else chance
    effect, on, where = str(accepted).partition(" on ")
    outcome = f"<b>{escape(_title(effect) + on + where)}</b> accepted" if accepted else "nothing accepted"
    top = 1.02 * max([threshold or 0.0, *(c["gain_nats"] or 0.0 for c in candidates)]) or 1.0
    line = f'<u style="left:{100 * float(threshold or 0) / top:.2f}%"></u>' if _known(threshold) else ""
    rows = "".join(_candidate(c, top, line, accepted) for c in candidates[:_CANDIDATES])
    left = len(candidates) - _CANDIDATES
    rest = f"<p class='quiet'>And {left} more, of {_gain(candidates[_CANDIDATES])} at most.</p>" if left > 0 else ""
    return (
        f"<div class='round'><h3>Round {k}: {outcome}{limit}</h3>"
        f"<table class='bars candidates'>{rows}</table>{rest}</div>"
    )


def _candidate(candidate: Values, top: float, line: str, accepted: Any) -> str:
    effect, where = str(candidate["effect"]), str(candidate.get("where") or "")
    chosen = accepted in (f"{effect} on {where}", effect)
    name = f"{_title(effect)} on {where}" if where else _title(effect)
    colour = plots.COLOURS["augmented"] if chosen else "#b9bec6"
    width = 100 * max(candidate["gain_nats"] or 0.0, 0.0) / top
    bar = f'<span class="bar"><i style="width:{width:.2f}%;background:{colour}"></i>{line}</span>'
    mark = " class='chosen'" if chosen else ""
    return f"<tr{mark}><th>{escape(name)}</th><td class='wide'>{bar}</td><td class='n'>{_gain(candidate)}</td></tr>"


def _gain(candidate: Values) -> str:
    return f"{_fixed(candidate['gain_nats'], 1)} nats"


# Words and numbers


def _metrics(models: Values) -> list[str]:
    return list(dict.fromkeys(metric for model in _named(models) for metric in models[model]))


def _named(models: Values) -> list[str]:
    return [m for m in plots.MODELS if models.get(m)]


def _metric(metric: str, with_unit: bool = True) -> str:
    """A readable label of a metric such as `nll_1`, `error_50` or `error_50_base [m]`."""
    parts = re.fullmatch(r"(nll|error)_(\d+)(?:_([^\[]+?))?\s*(?:\[(.*)\])?", metric)
    if not parts:
        return escape(metric.replace("_", " "))
    kind, steps, body, unit = parts.groups()
    what = ("Error" if kind == "error" else "NLL") + (f" of {body.replace('_', ' ')}" if body else "")
    unit = unit or ("nats a row" if kind == "nll" else "normalised")
    after = "one step ahead" if steps == "1" else f"after {steps} steps"
    small = f" <small>{escape(unit)}</small>" if with_unit else ""
    return escape(f"{what} {after}") + small


def _horizon(metric: str) -> int | None:
    """Steps of a metric of the whole state's error; None for others."""
    found = re.fullmatch(r"error_(\d+)", metric)
    return int(found[1]) if found else None


def _title(effect: Any) -> str:
    return str(effect).replace("_", " ")


def _code(name: Any) -> str:
    return f"<code>{escape(str(name))}</code>"


def _unit(unit: Any) -> str:
    return "" if unit in (None, "", "-") else escape(str(unit))


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def _listed(names: Sequence[Any], most: int) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(escape(str(n)) for n in names[:most]) + more


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


def _known(value: Any) -> bool:
    return value is not None and math.isfinite(value)


def _interval(ends: Any) -> tuple[float, float] | None:
    if ends is None or not all(_known(e) for e in ends):
        return None
    return (float(min(ends)), float(max(ends)))


def _percent(share: Any) -> str:
    if not _known(share):
        return _DASH
    if 0 < share < 0.01:
        return "under 1 %"
    return "over 99 %" if 0.99 < share < 1 else _proper(f"{100 * share:.0f} %")


def _number(value: Any, digits: int = 3) -> str:
    if not _known(value):
        return _DASH
    return _fixed(value, 0) if abs(value) >= 1000 else _proper(f"{value:.{digits}g}")


def _fixed(value: Any, decimals: int) -> str:
    if not _known(value):
        return _DASH
    return _proper(f"{value:.1e}" if abs(value) >= 1e6 else f"{value:,.{decimals if abs(value) < 1000 else 0}f}")


def _signed(value: float | None) -> str:
    return _DASH if value is None else _proper(f"{value:+.1f}")


def _proper(number: str) -> str:
    """With a minus sign for a hyphen, and none before a number that is rounded to nil."""
    return number.lstrip("-") if not re.search("[1-9]", number) else number.replace("-", _MINUS)


def _with_interval(value: Any, ends: Any, decimals: int | None = None) -> tuple[str, str]:
    """A value to the digits that its interval warrants, and the interval; the latter is empty where unknown."""
    decimals = _decimals(ends) if decimals is None else decimals
    known = _interval(ends)
    shown = _number(value) if decimals is None else _fixed(value, decimals)
    if known is None or decimals is None:
        return shown, ""
    return shown, f"{_fixed(known[0], decimals)} to {_fixed(known[1], decimals)}"


def _decimals(ends: Any) -> int | None:
    """Decimals that show an interval's half width to one or two digits; None where there is no interval."""
    known = _interval(ends)
    if known is None or known[1] <= known[0]:
        return None
    return min(max(-math.floor(math.log10((known[1] - known[0]) / 4)), 0), 8)


# Marks


def _bar(share: Any, colour: str) -> str:
    width = 100 * min(max(share, 0.0), 1.0) if _known(share) else 0.0
    return f'<span class="bar"><i style="width:{width:.1f}%;background:{colour}"></i></span>'


def _swatch(model: str) -> str:
    return f'<i class="swatch" style="background:{plots.COLOURS[model]}"></i>'


def _picture(svg: bytes, alt: str) -> str:
    data = base64.b64encode(svg).decode()
    return f'<img alt="{escape(alt)}" src="data:image/svg+xml;base64,{data}">'


_CSS = f"""
:root {{ color-scheme: light; }}
* {{ box-sizing: border-box; }}
body {{ margin: 0; background: #f3f4f6; color: {plots.INK}; font: 15px/1.5 {plots.FONTS};
  -webkit-print-color-adjust: exact; print-color-adjust: exact; }}
main {{ max-width: 1040px; margin: 24px auto; padding: 36px 40px; background: #fff; border-radius: 12px; }}
h1 {{ font-size: 15px; font-weight: 600; color: {plots.GREY}; margin: 0; overflow-wrap: anywhere; }}
h2 {{ font-size: 21px; line-height: 1.25; margin: 0 0 12px; display: flex; align-items: center; gap: 12px; }}
h3 {{ font-size: 15px; margin: 0 0 6px; overflow-wrap: anywhere; }}
p {{ margin: 0 0 14px; max-width: 860px; overflow-wrap: anywhere; }}
section {{ border-top: 1px solid #e3e5e9; margin-top: 30px; padding-top: 26px; }}
figure {{ margin: 18px 0; break-inside: avoid; }}
figcaption {{ font-size: 13.5px; margin-bottom: 6px; }}
img {{ display: block; max-width: 100%; height: auto; }}
svg {{ display: block; }}
small {{ color: {plots.GREY}; font-size: 12px; font-weight: 400; }}
code {{ font: 12.5px ui-monospace, "SF Mono", Menlo, Consolas, "Liberation Mono", monospace; background: #f0f2f5;
  border-radius: 4px; padding: 1px 5px; overflow-wrap: anywhere; }}
ul {{ margin: 0 0 14px; padding-left: 20px; }}
.number {{ flex: none; width: 28px; height: 28px; border-radius: 50%; background: {plots.INK}; color: #fff;
  font-size: 14px; display: inline-grid; place-items: center; }}
.quiet {{ color: {plots.GREY}; font-size: 13px; max-width: none; }}
.kicker {{ display: flex; justify-content: space-between; align-items: center; gap: 16px; }}
.badge {{ flex: none; color: #fff; font-weight: 600; border-radius: 999px; padding: 5px 16px; }}
.statement {{ font-size: 23px; line-height: 1.38; font-weight: 500; margin: 16px 0 20px; max-width: none; }}
.warnings {{ margin: 14px 0 0; padding: 10px 16px 10px 32px; background: #fdf3e4; border-left: 4px solid #c97a00;
  border-radius: 6px; font-size: 15px; }}
.sizes td, .sizes th {{ vertical-align: top; border-top: 1px solid #eceef1; }}
.sizes th:first-child {{ width: 20%; }} .sizes td:last-child {{ width: 24%; }}
summary {{ cursor: pointer; margin-bottom: 8px; }}
.facts {{ color: {plots.GREY}; font-size: 13px; margin: 0; max-width: none; }}
.tiles {{ list-style: none; padding: 0; margin: 0 0 18px; display: flex; gap: 14px; }}
.tiles li {{ flex: 1 1 0; max-width: 480px; background: #f6f7f9; border-radius: 10px;
  padding: 12px 16px; }}
.tiles b {{ display: block; font-size: 19px; line-height: 1.3; }}
.tiles span {{ color: {plots.GREY}; font-size: 13px; line-height: 1.35; display: block; margin-top: 2px; }}
table {{ border-collapse: collapse; width: 100%; font-size: 13.5px; break-inside: avoid; }}
caption {{ text-align: left; font-weight: 600; padding-bottom: 6px; }}
th {{ text-align: left; font-weight: 500; padding: 4px 10px 4px 0; overflow-wrap: anywhere; }}
td {{ padding: 4px 10px 4px 0; }}
td.n {{ text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; padding-right: 0; }}
td.n small {{ display: block; line-height: 1.2; }}
th code {{ background: none; padding: 0; }}
.bars th {{ width: 32%; }}
.bars td.n {{ width: 62px; }}
.bars.candidates td.n {{ width: 110px; }}
.pair {{ display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 36px;
  align-items: start; margin-bottom: 18px; }}
.half {{ max-width: 600px; margin-bottom: 18px; }}
.bar {{ position: relative; display: block; height: 8px; background: #eef0f3; border-radius: 4px; margin: 2px 0; }}
.bar i {{ position: absolute; left: 0; top: 0; bottom: 0; border-radius: 4px; min-width: 2px; }}
.bar u {{ position: absolute; top: -6px; bottom: -6px; width: 2px; margin-left: -1px; background: {plots.INK}; }}
.ramp {{ white-space: nowrap; color: {plots.GREY}; margin-left: 8px; }}
.ramp i {{ display: inline-block; width: 110px; height: 9px; border-radius: 3px; margin: 0 3px; }}
.heat {{ table-layout: fixed; border-collapse: separate; border-spacing: 2px; font-size: 12.5px; }}
.heat td, .heat th {{ padding: 3px 4px; text-align: center; font-variant-numeric: tabular-nums; border-radius: 3px; }}
.heat td:first-child, .heat th:first-child {{ width: 104px; text-align: left; padding-left: 0; }}
.heat tr:first-child th {{ vertical-align: bottom; line-height: 1.25; font-size: 12.5px; }}
.heat.upright tr:first-child th span {{ writing-mode: vertical-rl; transform: rotate(180deg); max-height: 230px;
  display: inline-block; text-align: left; }}
.heat .void {{ color: #9aa0a8; font-size: 11px; background: #f1f2f4; }}
.card {{ border: 1px solid #dfe2e7; border-radius: 12px; padding: 18px 22px; margin: 16px 0; break-inside: avoid; }}
.card .top {{ display: flex; justify-content: space-between; align-items: start; gap: 24px;
  margin-bottom: 10px; }}
.card h3 {{ font-size: 19px; }}
.card h3::first-letter {{ text-transform: uppercase; }}
.card.beside {{ display: grid; grid-template-columns: 1fr 432px; column-gap: 30px; }}
.card.beside .top {{ grid-column: 1 / 3; }}
.card .says {{ font-size: 15.5px; }}
.card figure {{ margin: 0; }}
.card dl {{ margin: 0 0 12px; font-size: 13.5px; }}
.card dl div {{ display: flex; gap: 10px; margin-bottom: 5px; }}
.card dt {{ flex: none; width: 128px; color: {plots.GREY}; }}
.card dd {{ margin: 0; }}
.laws {{ display: flex; flex-wrap: wrap; gap: 24px; }}
.card:not(.beside) .laws {{ margin-top: 16px; }}
.laws figure {{ width: 432px; }}
.probability {{ flex: none; width: 170px; color: {plots.GREY}; font-size: 13.5px; }}
.probability b {{ font-size: 19px; color: {plots.INK}; }}
.constants {{ list-style: none; padding: 0; display: flex; flex-wrap: wrap; gap: 10px; }}
.constants li {{ background: #eef4fb; border-radius: 8px; padding: 7px 14px; }}
.constants span, .constants small {{ display: block; font-size: 12.5px; color: {plots.GREY}; }}
.constants b {{ font-size: 18px; white-space: nowrap; }}
.constants i {{ font-style: normal; font-weight: 400; font-size: 14px; }}
.credible {{ font-size: 13.5px; margin: 0; }}
.share {{ margin-bottom: 20px; }}
.share p {{ margin-bottom: 6px; }}
.share .bar {{ height: 14px; border-radius: 7px; }}
.share .bar i {{ border-radius: 7px; }}
.scores {{ margin-bottom: 22px; }}
.scores th {{ padding: 6px 12px 6px 0; }}
.scores th:first-child {{ min-width: 190px; }}
.scores tr:nth-child(n + 2) {{ border-top: 1px solid #eceef1; }}
.scores tr:first-child th {{ text-align: right; vertical-align: bottom; padding-right: 0; padding-left: 12px; }}
.scores td {{ padding: 6px 0 6px 12px; }}
.scores th small {{ display: block; }}
.scores .marks {{ width: 230px; padding-left: 20px; }}
.swatch {{ display: inline-block; width: 14px; height: 4px; border-radius: 2px; vertical-align: middle;
  margin-right: 6px; }}
.dot {{ display: inline-block; width: 5px; height: 5px; border-radius: 50%; background: {plots.INK};
  vertical-align: middle; margin-right: 6px; }}
.key > span {{ margin-left: 14px; white-space: nowrap; }}
.experiment {{ break-inside: avoid; border-left: 3px solid {plots.COLOURS["augmented"]}; padding-left: 20px; }}
.parameters th {{ white-space: nowrap; }}
.parameters th i {{ font-style: normal; font-weight: 400; color: {plots.GREY}; font-size: 12px; }}
.parameters tr:first-child th {{ color: {plots.GREY}; font-size: 12px; text-align: right; padding-right: 0; }}
.parameters tr:first-child th.l {{ text-align: left; padding-left: 12px; }}
.parameters td.n {{ padding-left: 8px; }}
.parameters td:last-child {{ width: 112px; padding: 0 0 0 12px; }}
.parameters .moved > * {{ background: #fdf3e4; }}
.round {{ margin-bottom: 20px; break-inside: avoid; }}
.round h3 {{ font-weight: 500; }}
.candidates th {{ padding: 2px 12px 2px 0; }}
.candidates td {{ padding: 2px 0 2px 12px; }}
.candidates .chosen > * {{ font-weight: 700; }}
@page {{ margin: 12mm; }}
@media print {{
  body {{ background: #fff; }}
  main {{ margin: 0; padding: 0; max-width: none; zoom: 0.72; }}
  h2, h3, section > p {{ break-after: avoid; }}
}}
"""
