"""One case: a robot, a person, noise, what is concealed; and its key."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from concealed.catalogue import make_all
from concealed.form import Array, Form, Size
from concealed.operator import Habits, Person
from concealed.plain import (
    COMMAND,
    TIME_STEP,
    Noise,
    Robot,
    advance,
    correct,
    innovations,
    observer,
    observers,
    refit,
    robot,
    turned,
    wrapped,
)  # fmt: skip
from concealed.robot import Chance, Gate, Setting, Tape, run
from concealed.strength import Plain, reach_for, strengths

SIZES = {"usual": (8, 321), "few": (4, 161)}
"""Sessions and rows of each."""
LEVELS = (0.5, 1.0, 2.0)
"""Of noise, in the usual one's terms."""
PROCESS = np.array([4e-4, 4e-4, 8e-4, 5e-3, 5e-3, 8e-3, 4e-4, 4e-4, 4e-4, 5e-3, 5e-3, 5e-3])
MEASURED = np.array([2e-3, 2e-3, 3e-3, 1e-2, 1e-2, 1.5e-2, 2e-3, 2e-3, 2e-3, 1e-2, 1e-2, 1e-2])
REGIMES = {"reach": "m", "base speed": "m/s", "base |yaw rate|": "rad/s", "ee speed": "m/s", "ee height": "m"}
"""What a regime may depend on."""
HORIZON, STRIDE, RUN_IN = 50, 5, 10


class Recipe(NamedTuple):
    """What a case is to be.

    kind: null, single, duel, pair, triple, regime, onset, outside. names: ids, or laws without one. target: nats for
    each. size: of SIZES. poor: excitation. outliers: glitches in what is measured. wild: parameters far from usual.
    one_session: an onset in one session only. harder: forms in another variant.
    """

    kind: str
    names: tuple[str, ...]
    target: float
    size: str
    level: float
    poor: bool
    outliers: bool
    wild: bool
    one_session: bool
    harder: bool


class Case(NamedTuple):
    """The recorded sessions, measured [S, T, 12] and commanded [S, T, 6], and the key."""

    measured: Array
    command: Array
    key: dict[str, Any]


def noise_of(level: float) -> Noise:
    """Noise in terms of the usual one."""
    return Noise(PROCESS * level, MEASURED * level)


def conceal(recipe: Recipe, seed: int) -> Case:
    """The case of a recipe; equal arguments give equal cases."""
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(7)]
    drawn, _, form_rng, luck, person, noise_rng, gate_rng = streams
    sessions, rows = SIZES[recipe.size]
    of, noise = _robot(drawn, recipe.wild), noise_of(recipe.level)
    by, habits = observers(of, noise), _habits(drawn, recipe.poor)
    start = first(drawn, sessions)
    forms = make_all(recipe.names, recipe.harder, form_rng)
    seeds = {"person": int(person.integers(2**62)), "luck": int(luck.integers(2**62))}
    chance = _chance(noise_rng, sessions, rows, noise, recipe.outliers)

    def play(forms: Sequence[Form], magnitude: Array, noisy: bool, gate: Gate | None) -> Tape:
        size = Size(sessions, len(magnitude), rows)
        for i, form in enumerate(forms):
            form.begin(size, np.random.default_rng([seeds["luck"], i]))
        operate = Person(habits, size, np.random.default_rng(seeds["person"]))
        many = robot(np.repeat(of.flat, size.batch, axis=0))
        drawn = Chance(*(np.tile(a, (size.copies, 1, 1)) for a in chance)) if noisy else _silence(size)
        spread = np.repeat(magnitude, sessions, axis=0)
        setting = Setting(many, operate, np.tile(start, (size.copies, 1)), noise, drawn, size)
        return run(setting, forms, spread, gate)

    gate, when = _gate(recipe, gate_rng, sessions, rows, lambda: play([], np.zeros((1, 0)), False, None))
    plain = Plain(of, by, noise, Size(sessions, 1, rows))

    def found(forms: Sequence[Form], target: float) -> tuple[float, float]:
        scales = np.array([[form.scale for form in forms]])
        quiet = lambda f, m: play(f, m, False, gate)  # noqa: E731
        return reach_for(target, lambda factor: float(strengths(plain, forms, quiet, factor * scales)[0]))

    alone = [found([form], recipe.target) for form in forms]
    magnitude = np.array([[factor * form.scale for form, (factor, _) in zip(forms, alone, strict=True)]])
    if len(forms) > 1:
        total = float(strengths(plain, forms, lambda f, x: play(f, x, False, gate), magnitude)[0])
    else:
        total = alone[0][1] if alone else 0.0
    both = play(forms, np.concatenate([0 * magnitude, magnitude]), True, gate)
    tape, twin = (Tape(*(a[k * sessions : (k + 1) * sessions] for a in both)) for k in (1, 0))
    key = {
        "kind": recipe.kind, "strength": total, "target": recipe.target, "when": when,
        "verdicts": _verdicts(recipe), "recipe": recipe._asdict(), "seed": seed,
        "effects": [
            {"id": name, "form": type(form).__name__, "accept": [name, *form.accept], "why": form.why,
             "channels": list(form.channels), "outputs": list(form.outputs), "depends": list(form.depends),
             "constants": form.constants(float(m)), "magnitude": float(m), "strength": nats}
            for name, form, m, (_, nats) in zip(recipe.names, forms, magnitude[0], alone, strict=True)
        ],
        "parameters": of.flat[0].tolist(), "gated_share": float(tape.gate.mean()),
        "noise": {"level": recipe.level}, "error_50": _errors(of, noise, tape, twin),
    }  # fmt: skip
    return Case(tape.measured, tape.command, key)


def _verdicts(recipe: Recipe) -> list[str]:
    """Verdicts that are right."""
    return {"null": ["nothing", "parameters_only"], "outside": ["unexplained"]}.get(recipe.kind, ["missing_physics"])


def _robot(rng: np.random.Generator, wild: bool) -> Robot:
    """Parameters of a robot [1, ...]; wild ones are what a plain refit has to find by itself."""
    alpha = np.concatenate([rng.uniform(0.25, 0.7, 3), rng.uniform(0.03, 0.18, 2), rng.uniform(0.1, 0.5, 1)])
    v, p = rng.uniform(-0.003, 0.003, 6), rng.uniform(-0.002, 0.002, 6)
    gamma = rng.uniform(0.95, 1.35, 6)
    if wild:
        gamma = rng.uniform(0.95, 1.1, 6) * rng.uniform(0.8, 1.6)
        v, alpha = v * 8, np.clip(alpha * rng.uniform(0.4, 1.3, 6), 0.02, 0.8)
    return Robot(alpha[None], np.concatenate([v[:3], p[:3], v[3:], p[3:]])[None], gamma[None])


def _habits(rng: np.random.Generator, poor: bool) -> Habits:
    used = np.ones(6)
    if poor:
        used[rng.choice(6, 3, replace=False)] = 0.0
        return Habits(0.5, used)
    return Habits(float(rng.uniform(0.8, 1.2)), used)


def first(rng: np.random.Generator, sessions: int) -> Array:
    """Standing still somewhere in the room, the arm before the robot."""
    x = np.zeros((sessions, 12))
    x[:, :2], x[:, 2] = rng.uniform(-1, 1, (sessions, 2)), rng.uniform(-np.pi, np.pi, sessions)
    arm = np.stack([rng.uniform(0.55, 0.9, sessions), rng.uniform(-0.3, 0.3, sessions), 0 * x[:, 2]], axis=1)
    x[:, 6:9] = turned(x[:, 2], arm)
    x[:, 6:8] += x[:, :2]
    x[:, 8] = rng.uniform(0.4, 0.9, sessions)
    return x


def _chance(rng: np.random.Generator, sessions: int, rows: int, noise: Noise, outliers: bool) -> Chance:
    shape = (sessions, rows, 12)
    process, measured = rng.normal(size=shape), rng.normal(size=shape)
    hit = (rng.uniform(size=shape) < 1e-3) * outliers
    glitch = hit * rng.choice([-1, 1], shape) * rng.uniform(6, 40, shape) * noise.measured
    return Chance(process, measured, glitch)


def _silence(size: Size) -> Chance:
    nothing = np.zeros((size.batch, size.rows, 12))
    return Chance(nothing, nothing, nothing)


def features(state: Array, command: Array) -> dict[str, Array]:
    """What a regime may be said in, of rows [..., 12] and [..., 6]."""
    found = {
        "base speed": np.hypot(state[..., 3], state[..., 4]), "base |yaw rate|": np.abs(state[..., 5]),
        "reach": np.hypot(state[..., 6] - state[..., 0], state[..., 7] - state[..., 1]),
        "ee speed": np.linalg.norm(state[..., 9:12], axis=-1), "ee height": state[..., 8],
    }  # fmt: skip
    for i, name in enumerate(COMMAND):
        found |= {name: command[..., i], f"|{name}|": np.abs(command[..., i])}
    return found


def _gate(
    recipe: Recipe, rng: np.random.Generator, sessions: int, rows: int, bare: Any
) -> tuple[Gate | None, dict[str, Any] | None]:
    """Where and when an effect acts, as a function and as the key says it."""
    if recipe.kind == "regime":
        name = str(rng.choice(list(REGIMES)))
        tape = bare()
        edge = float(np.quantile(features(tape.true, tape.command)[name], rng.uniform(0.5, 0.75)))
        rule = f"{name} > {edge:.4g} {REGIMES[name]}"
        return lambda _, x, u: (features(x, u)[name] > edge).astype(float), {"regime": rule}
    if recipe.kind == "onset":
        row = int(rng.uniform(0.3, 0.65) * rows)
        session = int(rng.choice([s for s in range(sessions) if s % 4 != 3])) if recipe.one_session else None
        here = np.ones(sessions) if session is None else (np.arange(sessions) == session).astype(float)
        when = {"from_s": row * TIME_STEP, "session": session}
        return lambda t, x, _: float(t >= row) * np.tile(here, len(x) // sessions), when
    return None, None


def _errors(of: Robot, noise: Noise, tape: Tape, twin: Tape) -> dict[str, float]:
    """Share of the motion missed after 50 steps on held-out sessions: of the true form, and of the best plain robot.

    The true form's is that of the same robot and noise without the effect, whose form the plain robot is.
    """
    held = np.arange(len(tape.measured)) % 4 == 3
    by = observer(of, noise)
    flat, _ = refit(of, by, tape.measured[None, ~held], tape.command[None, ~held])
    bare, moved = _forecast(robot(flat), noise, tape.measured[held], tape.command[held])
    true, _ = _forecast(of, noise, twin.measured[held], twin.command[held])
    return {"true": float(np.sqrt((true / moved).mean())), "refitted": float(np.sqrt((bare / moved).mean()))}


def _forecast(of: Robot, noise: Noise, state: Array, command: Array) -> tuple[Array, Array]:
    """Mean squares over windows of the error and of the motion after HORIZON steps [12]."""
    by = observer(of, noise)
    starts = np.arange(0, state.shape[1] - RUN_IN - HORIZON, STRIDE)
    cut = lambda a, n: np.concatenate([a[:, s : s + n] for s in starts])  # noqa: E731
    y, u = cut(state, RUN_IN + HORIZON + 1), cut(command, RUN_IN + HORIZON)
    many = robot(np.repeat(of.flat, len(y), axis=0))
    e = innovations(many, by, y[:, : RUN_IN + 1], u[:, :RUN_IN])
    # The filtered state is the last prediction, corrected once more.
    x = y[:, RUN_IN] - e[:, -1]
    correct(by, x, e[:, -1])
    for k in range(HORIZON):
        x = advance(many, x, u[:, RUN_IN + k])
    error = wrapped(y[:, -1] - x)
    moved = wrapped(y[:, -1] - y[:, RUN_IN])
    return (error**2).mean(0), np.maximum((moved**2).mean(0), 1e-12)
