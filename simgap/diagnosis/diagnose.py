"""The whole diagnosis: is anything missing, where, what, how much, does it help, and what now."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from simgap.diagnosis import black_box, confidence, experiment, judge, locate, pictures, words
from simgap.diagnosis.candidates import candidates, changed, gated
from simgap.diagnosis.fit import Fit, Problem, evaluate, optimise, raw_innovations, start, whitening
from simgap.diagnosis.innovations import Chunks, Variables, cut
from simgap.diagnosis.judge import Contestant, Judged
from simgap.diagnosis.measure import measure
from simgap.diagnosis.rivals import Member, defend, outshone
from simgap.diagnosis.scatter import Scatter, scatter
from simgap.diagnosis.search import Round, Say, search
from simgap.diagnosis.times import acts_when, pushed
from simgap.diagnosis.when import When, gate
from simgap.effects import CATALOGUE
from simgap.effects.augmented import Augmented
from simgap.effects.effect import Scales
from simgap.types import Recording, StepModel

SEEN = 8.0
"""Nats that an effect of usual strength must be able to gain for the recordings to show it."""
EXPLAINED = 0.5
"""Share of what a black box removes that named physics must remove for the vocabulary to be the answer."""
CREDIBLE = 0.95
ODD_ROWS = ("sampling_interval", "dropout")
"""Effects on the scatter that are a matter of single rows."""


class Explained(NamedTuple):
    """The best explanation: `base` and `fit` are the models without and with the effects, fitted alike."""

    problem: Problem
    base: Fit
    fit: Fit
    nuisance: Float[np.ndarray, "M n s"]
    members: tuple[Member, ...]
    rounds: list[Round]


class AugmentedModel(NamedTuple):
    """The augmented simulator's constants: parameters, effects' internal constants, filter gain, one-step noise of the
    innovations that `whiten` decorrelates, and the scales that the laws refer to."""

    phi: Float[np.ndarray, " p"]
    theta: Float[np.ndarray, " P"]
    gain: Float[np.ndarray, " s"]
    noise_scale: Float[np.ndarray, " s"]
    noise_dof: Float[np.ndarray, " s"]
    whiten: Float[np.ndarray, "s s"]
    scales: Scales


class Diagnosis(NamedTuple):
    """statement: what is written as diagnosis.json. evidence: arrays for its pictures. model: the augmented simulator.
    experiment: time [s] and commands that would tell the best explanations apart."""

    statement: dict[str, Any]
    evidence: dict[str, Any]
    model: AugmentedModel
    experiment: tuple[Float[np.ndarray, " T"], Float[np.ndarray, "T u"]] | None


def split(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    """Sessions to fit and sessions held out: every fourth, the last of fewer; the last quarter of a single one."""
    if len(recordings) == 1:
        (r,) = recordings
        edge = 3 * len(r.time_s) // 4
        part = lambda name, rows: Recording(name, r.time_s[rows], r.state[rows], r.command[rows])  # noqa: E731
        return [part(r.name, slice(0, edge))], [part(f"{r.name} (last quarter)", slice(edge, None))]
    held = set(range(3, len(recordings), 4)) or {len(recordings) - 1}
    return [r for i, r in enumerate(recordings) if i not in held], [r for i, r in enumerate(recordings) if i in held]


def diagnose(
    simulator: StepModel,
    name: str,
    training: Sequence[Recording],
    heldout: Sequence[Recording],
    baseline: Sequence[Recording] = (),
    seed: int = 0,
    say: Say = lambda line: None,
) -> Diagnosis:
    """Diagnose a simulator against recordings; `say(line)` is told what is being tried.

    With a `baseline` the question is what changed since: the simulator is refitted to both sets, with the effects that
    the baseline shows by itself, and an effect is claimed where it differs between the two.

    Raises DivergenceError when the simulator leaves the finite numbers on the recordings at its nominal parameters.
    """
    rng = np.random.default_rng(seed)
    augmented = Augmented(simulator)
    sessions = [*baseline, *training]
    scales, time_step = measure(augmented, sessions), simulator.time_step
    chunks = cut(sessions, time_step)
    chunks = chunks._replace(gate=_since(chunks, len(baseline)))
    unseen = cut(heldout, time_step, least=len(chunks.row))
    problem = Problem(augmented, scales, chunks, np.eye(len(simulator.schema.state)))
    as_is = evaluate(problem, start(problem), ())
    problem = problem._replace(whiten=whitening(as_is.e))
    throughout, events = candidates(augmented, scales), candidates(augmented, scales, events=True)
    hypotheses = throughout
    if baseline:
        say(f"what the baseline of {len(baseline)} sessions shows by itself")
        before = problem._replace(chunks=cut(baseline, time_step, least=len(chunks.row)))
        agree = lambda *_: True  # noqa: E731  # no session of the baseline is held out
        known = search(before, evaluate(before, as_is.v, ()), throughout, agree, rng, say).model.fit
        as_is = evaluate(problem, known.v, known.groups)
        hypotheses = [changed(c) for c in throughout]

    def helps(problem: Problem, without: Fit, with_it: Fit) -> bool:
        # What acts in one session of training only is nothing to the others.
        elsewhere = not np.asarray(unseen.gate).any() and with_it.groups[-1].gated
        return elsewhere or _gain(problem, unseen, without, with_it) > 0

    say(f"fitting the {len(simulator.parameters)} parameters of {name} to {len(sessions)} sessions")
    searched = search(problem, evaluate(problem, as_is.v, as_is.groups), hypotheses, helps, rng, say)
    model, members, rounds = defend(searched, hypotheses, rng, say)
    odd = sum(s.gain for s in scatter(model.problem, model.fit, unseen) if s.id in ODD_ROWS)
    model, members = outshone(model, members, odd, say)
    when = None if baseline else acts_when(model, members, say)
    if when is not None:
        # What acts for a while only was looked for as if it acted throughout: look again.
        problem, unseen = problem._replace(chunks=chunks._replace(gate=gate(chunks, when))), _at(unseen, when)
        hypotheses = [*throughout, *(gated(c) for c in throughout)]
        searched = search(problem, evaluate(problem, as_is.v, as_is.groups), hypotheses, helps, rng, say)
        model, members, rounds = defend(searched, hypotheses, rng, say)
        members = tuple(m._replace(when=when) if m.candidate.groups[0].gated else m for m in members)
    elif not baseline and not odd:
        # Odd rows look like pushes, one by one.
        model, members = pushed(model, members, events, rng, say)
    when = next((m.when for m in members if m.when), None)
    unseen = _at(unseen, when)
    say("looking at the scatter that is left")
    scattered = scatter(model.problem, model.fit, unseen)
    base, _ = optimise(model.problem, evaluate(model.problem, searched.base.v, searched.base.groups), 8)
    found = Explained(model.problem, base, model.fit, model.nuisance, members, [*searched.rounds, *rounds])
    say("judging on held-out sessions")
    court = _Court(found.problem, training, heldout, when)
    contestants = _contestants(found, as_is.v, chunks, rng)
    judged = {model: court.hear(c) for model, c in contestants.items()}
    return _told(
        simulator, name, sessions, heldout, baseline, found, unseen, contestants, judged, scattered, as_is, rng, say
    )


def _since(chunks: Chunks, baseline: int) -> np.ndarray:
    """Gate that is open in the sessions after those of the baseline."""
    return np.repeat((np.asarray(chunks.session) >= baseline)[:, None], chunks.gate.shape[1], 1).astype(np.float32)


def _gain(problem: Problem, unseen: Chunks, without: Fit, with_it: Fit) -> float:
    """Log-likelihood [nats] that held-out sessions gain, all constants as fitted."""
    on = problem._replace(chunks=unseen)
    a, b = (evaluate(on, f.v, (), f.noise).loglik for f in (without, with_it))
    return b - a


def _at(unseen: Chunks, when: When | None) -> Chunks:
    """Held-out rows with the gate open when an effect acts there: never, where it belongs to a session of training."""
    if when is not None and when.session is not None:
        return unseen._replace(gate=0 * unseen.gate)
    return unseen._replace(gate=gate(unseen, when))


class _Court:
    """Held-out sessions, and training sessions for the noise."""

    def __init__(
        self, problem: Problem, training: Sequence[Recording], heldout: Sequence[Recording], when: When | None
    ) -> None:
        self.problem = problem
        step = problem.augmented.simulator.time_step
        fitted, unseen = judge.pieces_of(training, step), judge.pieces_of(heldout, step)
        if fitted is not None:
            fitted = fitted._replace(gate=gate(fitted, when))
        self.heldout = None if unseen is None else _at(unseen, when)
        self.training = fitted if fitted is None or unseen is None else judge.alike(fitted, unseen)

    def hear(self, contestant: Contestant) -> Judged | None:
        return judge.judge(self.problem, contestant, self.training, self.heldout)


def _contestants(found: Explained, as_is: Variables, chunks: Chunks, rng: np.random.Generator) -> dict[str, Contestant]:
    raw = raw_innovations(found.problem, found.base.v)
    box = black_box.train(found.problem.augmented, chunks, raw, rng)
    models = {"as_is": Contestant(as_is), "refitted": Contestant(found.base.v)}
    if found.members:
        models["augmented"] = Contestant(found.fit.v)
    return {**models, "black_box": Contestant(found.base.v, box)}


def _told(
    simulator: StepModel,
    name: str,
    training: Sequence[Recording],
    heldout: Sequence[Recording],
    baseline: Sequence[Recording],
    found: Explained,
    unseen: Chunks,
    contestants: dict[str, Contestant],
    judged: dict[str, Judged | None],
    scattered: Sequence[Scatter],
    as_is: Fit,
    rng: np.random.Generator,
    say: Say,
) -> Diagnosis:
    problem, layout = found.problem, found.problem.augmented.layout
    chunks = problem.chunks
    scores = {m: judge.scores(layout, j, rng) for m, j in judged.items() if j is not None}
    share, verdict = _verdict(found, judged, bool(scattered), rng)
    better = _better(problem, found, contestants, verdict)
    where = {
        split: locate.excess(problem.augmented, c, *(np.asarray(e) for e in better(c)))
        for split, c in (("training", chunks), ("heldout", unseen))
    }
    sd = confidence.spread(problem, found.fit, found.nuisance)
    effects = [_effect(problem, found, m, sd, unseen, training) for m in found.members]
    effects += [_scattered(s) for s in scattered]
    box = contestants["black_box"].box
    depends = []
    if verdict == "unexplained" and box is not None:
        raw = raw_innovations(problem._replace(chunks=chunks), found.base.v)
        depends = black_box.dependence(problem.augmented, box, chunks, raw, rng)[:3]
    say("looking for the experiment that would tell explanations apart")
    plan = _experiment(problem, found, training)
    located = {
        "outputs": locate.outputs(problem.augmented, where["training"]) if verdict in _MISMATCH else [],
        "regimes": locate.regimes(where["training"]) if verdict in _MISMATCH else [],
        "intervals": _intervals(found, where["training"], training) if verdict in _MISMATCH else [],
        "depends_on": [{"input": i, "share": s} for i, s in depends],
    }
    parameters = _parameters(simulator, as_is, found.fit, sd)
    statement = {
        "schema": 1, "simulator": name, "verdict": verdict,
        "recordings": {
            "training_sessions": [r.name for r in training[len(baseline) :]], "heldout_sessions": [r.name for r in heldout],
            "baseline": [r.name for r in baseline] or None,
            "transitions": int(np.asarray(chunks.counts).sum()),
            "duration_s": float(sum(r.time_s[-1] - r.time_s[0] for r in (*training, *heldout))),
        },
        "located": located, "effects": effects, "alternatives": _alternatives(found.members),
        "experiment": plan and plan[0], "parameters": parameters,
        "fit": {
            "heldout_sessions": [r.name for r in heldout], "models": scores,
            "explained_share": share and share["value"], "explained_share_ci95": share and share["ci95"],
        },
        "blind": _blind(found), "rounds": _rounds(found), "notes": _notes(heldout),
    }  # fmt: skip
    statement["statement"] = words.statement(statement)
    evidence = {
        "heat": locate.heat(problem.augmented, where["training"]),
        "strips": [*locate.strips(where["training"], training, False), *locate.strips(where["heldout"], heldout, True)],
        "laws": [p for m in found.members for p in pictures.laws(problem, found.fit, m.candidate, where["training"])],
        "rollouts": pictures.rollouts(problem, max(heldout, key=lambda r: len(r.time_s)), contestants),
        "experiment": plan and plan[1],
    }
    v = found.fit.v
    noise = found.fit.noise
    # Since the baseline, what changed acts besides; what acts for a while only is no part of the simulator.
    theta = v.theta + v.gated if baseline else v.theta
    phi, theta, gain = (np.asarray(a) for a in (v.phi, theta, v.gain))
    model = AugmentedModel(phi, theta, gain, noise.scale, noise.dof, problem.whiten, problem.scales)
    return Diagnosis(statement, evidence, model, plan and plan[2])


_MISMATCH = ("missing_physics", "unexplained")


def _verdict(
    found: Explained, judged: dict[str, Judged | None], scattered: bool, rng: np.random.Generator
) -> tuple[dict[str, Any] | None, str]:
    """Share of the black box's gain that named physics makes, and the verdict."""
    as_is, refitted, box = (judged[m] for m in ("as_is", "refitted", "black_box"))
    if refitted is None or as_is is None or box is None:
        return None, "missing_physics" if found.members or scattered else "nothing"
    named = judged.get("augmented")
    share = judge.explained_share(refitted, named or refitted, box, rng)
    if found.members:
        return share, "unexplained" if share is not None and share["ci95"][1] < EXPLAINED else "missing_physics"
    if share is not None:
        return share, "unexplained"
    if scattered:
        return share, "missing_physics"
    moved = judge.difference(as_is, refitted, rng)["ci95"][0] > 0
    return share, "parameters_only" if moved else "nothing"


def _better(
    problem: Problem, found: Explained, contestants: dict[str, Contestant], verdict: str
) -> Callable[[Chunks], tuple[Any, Any]]:
    """Innovations of the refitted simulator and of the best explanation: named physics, or else the black box."""
    box = contestants["black_box"].box

    def both(chunks: Chunks) -> tuple[Any, Any]:
        base = raw_innovations(problem._replace(chunks=chunks), found.base.v)
        if found.members and verdict == "missing_physics":
            return base, raw_innovations(problem._replace(chunks=chunks), found.fit.v)
        assert box is not None  # the black box always runs
        return base, base - black_box.predicted(problem.augmented, box, chunks)

    return both


def _scattered(s: Scatter) -> dict[str, Any]:
    return {
        "id": s.id, "form": "scatter", "where": "all", "probability": 1.0, "channels": [], "outputs": list(s.outputs),
        "statement": s.statement, "constants": s.constants, "credible_set": [s.id], "gain_nats": s.gain,
        "heldout_gain_nats": s.heldout_gain, "from_s": None,
    }  # fmt: skip


def _effect(
    problem: Problem,
    found: Explained,
    member: Member,
    sd: confidence.Spread,
    unseen: Chunks,
    training: Sequence[Recording],
) -> dict[str, Any]:
    candidate = member.candidate
    constants = confidence.constants(problem, found.fit, candidate, sd)
    cumulative, credible = 0.0, []
    for effect, p in member.odds.items():
        credible.append(effect)
        cumulative += p
        if cumulative >= CREDIBLE:
            break
    outputs = candidate.outputs or tuple(f.name for f in problem.augmented.simulator.schema.state)
    when = member.when
    if when is not None and candidate.effect.event:
        step = problem.scales.time_step
        constants += [{"name": n, "value": t, "unit": "s", "ci95": [t - 3 * step, t + 3 * step]}
                      for n, t in (("from", when.from_s), ("to", when.to_s))]  # fmt: skip
    during = words.during(when, training[when.session].name if when and when.session is not None else None)
    return {
        "id": candidate.effect.id, "form": candidate.effect.form, "where": candidate.where,
        "probability": member.odds[candidate.effect.id], "channels": list(candidate.channels),
        "outputs": list(outputs), "statement": words.effect(candidate, constants) + during, "constants": constants,
        "credible_set": credible, "gain_nats": member.gain,
        "heldout_gain_nats": _gain(problem, unseen, evaluate(problem, member.without.v, ()), found.fit),
        "from_s": when and when.from_s,
    }  # fmt: skip


def _intervals(found: Explained, where: locate.Excess, training: Sequence[Recording]) -> list[dict[str, Any]]:
    """When effects act that do not act throughout; else where the excess is, if it is in one place."""
    told = []
    for when in (m.when for m in found.members if m.when is not None):
        for s, r in enumerate(training):
            if when.session in (None, s) and r.time_s[-1] - r.time_s[0] > when.from_s:
                end = min(when.to_s, float(r.time_s[-1] - r.time_s[0]))
                told.append({"session": r.name, "from_s": when.from_s, "to_s": end, "share": None})
    return told or locate.intervals(where, training)


def _alternatives(members: Sequence[Member]) -> list[dict[str, Any]]:
    """Other sets: one member replaced by what could stand in its place."""
    ids = [m.candidate.effect.id for m in members]
    return [
        {"effects": [*ids[:i], other, *ids[i + 1 :]], "probability": p}
        for i, m in enumerate(members)
        for other, p in m.odds.items()
        if other != ids[i] and p > 0.001
    ]


def _parameters(simulator: StepModel, as_is: Fit, fit: Fit, sd: confidence.Spread) -> dict[str, Any]:
    names = [p.name for p in simulator.parameters]
    before, after = (dict(zip(names, map(float, np.asarray(f.v.phi)), strict=True)) for f in (as_is, fit))
    width = dict(zip(names, confidence.Z95 * sd.phi, strict=True))
    return {
        "before": before, "after": after,
        "ci95": {n: [after[n] - float(width[n]), after[n] + float(width[n])] for n in names},
        "units": {p.name: p.unit for p in simulator.parameters},
        "ranges": {p.name: [p.low, p.high] for p in simulator.parameters},
    }  # fmt: skip


def _experiment(problem: Problem, found: Explained, training: Sequence[Recording]):
    """For the least certain member: (for JSON, for the picture, for the file), or None."""
    open_questions = [m for m in found.members if m.rival is not None]
    if not open_questions:
        return None
    member = min(open_questions, key=lambda m: m.odds[m.candidate.effect.id])
    rival = member.rival
    assert rival is not None  # filtered above
    designed = experiment.design(problem, found.fit, rival.fit, list(training))
    if designed is None:
        return None
    ids = [member.candidate.effect.id, rival.candidate.effect.id]
    told = {"statement": words.experiment(designed, ids), "commands": "experiment.csv", "separates": ids}
    fields = problem.augmented.simulator.schema.command
    picture = {
        "time_s": designed.time_s,
        "channels": {f.name: designed.commands[:, i] for i, f in enumerate(fields)},
        "units": {f.name: f.unit for f in fields},
    }
    return told, picture, (designed.time_s, designed.commands)


def _blind(found: Explained) -> list[dict[str, str]]:
    """Effects that these recordings could not have shown at a usual strength."""
    power: dict[str, float] = {}
    for s in found.rounds[0].screening.found:
        power[s.candidate.effect.id] = max(power.get(s.candidate.effect.id, 0.0), s.power)
    present = {e.id for e, sites in zip(CATALOGUE, found.problem.augmented.sites, strict=True) if sites}
    weak = {e: p for e, p in power.items() if p < SEEN and e in present}
    return [{"effect": e, "reason": words.blind(p)} for e, p in weak.items()]


def _rounds(found: Explained) -> list[dict[str, Any]]:
    return [
        {
            "threshold_nats": r.screening.threshold / 2, "p_value": r.screening.p_value, "accepted": r.accepted,
            "candidates": [
                {"effect": t.candidate.effect.id, "where": t.candidate.where, "gain_nats": t.gain} for t in r.tried
            ] or [
                {"effect": s.candidate.effect.id, "where": s.candidate.where, "gain_nats": s.gain}
                for s in r.screening.found[:5]
            ],
        }
        for r in found.rounds
    ]  # fmt: skip


def _notes(heldout: Sequence[Recording]) -> list[str]:
    if len(heldout) < judge.LEAST_SESSIONS:
        return ["Intervals of held-out scores are a bootstrap over pieces of the held-out sessions, which are few."]
    return []
