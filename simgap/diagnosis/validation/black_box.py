"""A black box on top of the refitted simulator: how much error any function of state and commands could remove.

Ridge regression of the innovations on random Fourier features [Rahimi & Recht 2007] of the bodies' own motion and the
last commands, in each body's own frame. It names nothing. It measures how much there is to explain, and shows that
something is missing where no known effect fits.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from simgap.diagnosis.hypotheses.features import seen, seen_names
from simgap.diagnosis.likelihood.problem import Problem, estimates, raw_innovations
from simgap.diagnosis.likelihood.segments import counted
from simgap.diagnosis.likelihood.variables import Variables
from simgap.kinematics import to_own_frame, to_world
from simgap.layout import Layout
from simgap.rows import by_row

COMMANDS = 4
"""Rows of commands that it sees: the present one and those before it."""
FEATURES = 300
RIDGES = (1e-1, 1e0, 1e1, 1e2, 1e3)
WIDTHS = (4.0, 10.0)
"""Widths of the kernel, in standard deviations of the inputs."""
FOLDS = 4


class BlackBox(NamedTuple):
    """Weights of the regression, with the standardisation of its inputs."""

    mean: Float[Array, " d"]
    std: Float[Array, " d"]
    omega: Float[Array, "d f"]
    phase: Float[Array, " f"]
    weights: Float[Array, "k s"]


def silent(layout: Layout) -> BlackBox:
    """A box that adds nothing."""
    d, s = len(input_names(layout)), len(layout.schema.state)
    return BlackBox(
        jnp.zeros(d), jnp.ones(d), jnp.zeros((d, FEATURES)), jnp.zeros(FEATURES), jnp.zeros((1 + d + FEATURES, s))
    )


def inputs(layout: Layout, state: Float[Array, " s"], commands: Float[Array, "k u"]) -> Float[Array, " d"]:
    """Inputs of the black box."""
    return jnp.concatenate([seen(layout, state, commands[0]), commands[1:COMMANDS].ravel()])


def input_names(layout: Layout) -> list[str]:
    """Names of the black box's inputs."""
    before = [f"{f.name} {k} rows before" for k in range(1, COMMANDS) for f in layout.schema.command]
    return [*seen_names(layout), *before]


def _features(box: BlackBox, z: Float[Array, " d"]) -> Float[Array, " k"]:
    z = jnp.clip((z - box.mean) / box.std, -5, 5)
    wave = jnp.cos(z @ box.omega + box.phase) * np.sqrt(2 / FEATURES)
    return jnp.concatenate([jnp.ones(1), z / 3, wave])


@jax.jit
def _every_row(box: BlackBox, z: Float[Array, "n d"]) -> Float[Array, "n k"]:
    return jax.vmap(_features, (None, 0))(box, z)


def correct(
    layout: Layout, box: BlackBox, state: Float[Array, " s"], commands: Float[Array, "k u"]
) -> Float[Array, " s"]:
    """What the box adds to the next state."""
    return to_world(layout, _features(box, inputs(layout, state, commands)) @ box.weights, state)


def _scored_inputs(problem: Problem, v: Variables) -> tuple[Float[np.ndarray, "n s"], Float[np.ndarray, "n k u"]]:
    """What the box sees in the scored rows: the state at the beginning of each step, and the last commands.

    The state is the filter's estimate, as in forecasts. The measured state holds noise that predicts the next
    innovation, but none after it.
    """
    chunks, counts = problem.chunks, np.asarray(problem.chunks.counts)
    x = estimates(problem, v)
    sent = np.concatenate([np.asarray(chunks.past)[:, ::-1][:, -COMMANDS:], np.asarray(chunks.command)[:, :-1]], axis=1)
    last = np.stack([sent[:, COMMANDS - k : sent.shape[1] - k] for k in range(COMMANDS)], axis=2)
    return x[counts], last[counts]


def _design(problem: Problem, v: Variables) -> tuple[np.ndarray, np.ndarray]:
    """Inputs [n, d] and own-frame innovations [n, s] of the scored rows."""
    e = counted(problem.chunks, raw_innovations(problem, v))
    e = np.pad(e, ((0, 0), (0, len(problem.augmented.layout.observed) - e.shape[1])))
    layout, (x, sent) = problem.augmented.layout, _scored_inputs(problem, v)
    return by_row(inputs, layout, x, sent), by_row(to_own_frame, layout, e, x)


def train(problem: Problem, v: Variables, rng: np.random.Generator) -> BlackBox:
    """Fit the box, with ridge and kernel width by cross-validation over runs of segments; innovations are clipped to
    4 sd."""
    z, target = _design(problem, v)
    scale = np.maximum(1.4826 * np.median(np.abs(target), axis=0), 1e-9)
    target = np.clip(target / scale, -4, 4)
    counts = np.asarray(problem.chunks.counts)
    fold = np.repeat(np.arange(len(counts)) * FOLDS // len(counts), counts.sum(1))
    std = z.std(0)
    best: tuple[float, BlackBox | None, float] = (np.inf, None, RIDGES[-1])
    for width in WIDTHS:
        box = BlackBox(
            jnp.asarray(z.mean(0)), jnp.asarray(np.where(std > 1e-6, std, 1.0)),
            jnp.asarray(rng.normal(size=(z.shape[1], FEATURES)) / width, jnp.float32),
            jnp.asarray(rng.uniform(0, 2 * np.pi, FEATURES), jnp.float32), jnp.zeros((0, 0)),
        )  # fmt: skip
        features = np.asarray(_every_row(box, z), np.float64)
        errors = _cross_validated(features, target, fold)
        ridge = min(errors, key=lambda r: errors[r])
        if errors[ridge] < best[0]:
            weights = _solve(features.T @ features, features.T @ target, ridge) * scale
            best = (errors[ridge], box._replace(weights=jnp.asarray(weights, jnp.float32)), ridge)
    assert best[1] is not None  # an error is always finite
    return best[1]


def _solve(gram: np.ndarray, moment: np.ndarray, ridge: float) -> np.ndarray:
    return np.linalg.solve(gram + ridge * np.eye(len(gram)), moment)


def _cross_validated(features: np.ndarray, target: np.ndarray, fold: Int[np.ndarray, " n"]) -> dict[float, float]:
    """Squared error on the left-out folds, per ridge."""
    parts = [(features[fold == k], target[fold == k]) for k in np.unique(fold)]
    grams, moments = [f.T @ f for f, _ in parts], [f.T @ t for f, t in parts]
    gram, moment = sum(grams), sum(moments)
    return {
        ridge: sum(
            float(((t - f @ _solve(gram - g, moment - m, ridge)) ** 2).sum())
            for (f, t), g, m in zip(parts, grams, moments, strict=True)
        )
        for ridge in RIDGES
    }


def predicted(problem: Problem, v: Variables, box: BlackBox) -> Float[np.ndarray, "C t s"]:
    """The box's prediction of every innovation, in the outputs' own frame; zero in rows that are not scored."""
    counts, layout = np.asarray(problem.chunks.counts), problem.augmented.layout
    prediction = np.zeros((*counts.shape, box.weights.shape[1]), np.float32)
    x, sent = _scored_inputs(problem, v)
    added = np.asarray(_every_row(box, by_row(inputs, layout, x, sent)) @ box.weights)
    prediction[counts] = by_row(to_world, layout, added, x)
    return prediction
