"""Effects on the noise, of innovations drawn directly: named where planted, never where noise only looks like them;
their intervals hold the truth as often as they say."""

from functools import cache

import numpy as np
import pytest
from rows import BURST, JITTER, LOST, NULLS, ROBOT, SLOPE, STALL, STEP, drawn
from scipy.stats import binom

from simgap.diagnosis.hypotheses.support import Window
from simgap.diagnosis.inference.evidence.scan import edges_ci95
from simgap.diagnosis.inference.noise.effect import OTHER, NoiseEffect
from simgap.diagnosis.inference.noise.rows import explained
from simgap.diagnosis.inference.noise.spectral_line import SEGMENT, line_of
from simgap.diagnosis.likelihood.segments import Rows
from simgap.diagnosis.likelihood.student_t import fit_noise

SETS = 40
"""Data sets of a study of coverage."""
ROW_SETS = 40
"""Of rows, of which each takes a second: intervals that hold the truth in but two of three sets fail the study in more
than nine cases of ten."""
FEWEST = int(binom.ppf(0.001, SETS, 0.95))
"""Intervals of them that hold the truth, but for one study in a thousand: 33."""
PLANTED = {"lost commands": "dropout", "stalls": "sampling_interval", "jitter": "sampling_interval",
           "growing noise": "motion_dependent_noise"}  # fmt: skip
CONSTANTS = {
    "lost commands": {"rate": 60 / STEP / (1 / LOST + BURST - 1), "length": BURST * STEP},
    "stalls": {"share of stalls": STALL, "length of stalls": 2.5 * STEP},
    "jitter": {"jitter": JITTER * STEP},
    "growing noise": {"ratio": 1 + SLOPE},
}


@cache  # the studies of coverage go on where the tests of names end
def said(kind: str, seed: int) -> NoiseEffect | None:
    training, heldout = drawn(kind, seed)
    return explained(ROBOT, fit_noise(training.e), training, heldout)


@pytest.mark.parametrize("kind", NULLS)
def test_noise_and_misfit_are_not_taken_for_lost_commands_or_late_rows(kind: str) -> None:
    ids = {found.id for found in (said(kind, seed) for seed in range(5)) if found is not None}
    assert ids <= {"motion_dependent_noise"} if kind == "growing noise" else not ids


@pytest.mark.parametrize("kind", PLANTED)
def test_what_is_planted_is_likely_and_has_alternatives(kind: str) -> None:
    found = [f for f in (said(kind, seed) for seed in range(5)) if f is not None]
    assert len(found) >= 3
    for f in found:
        assert f.id == PLANTED[kind]
        assert OTHER in f.odds
        assert f.odds[f.id] == max(f.odds.values())
        assert sum(f.odds.values()) == pytest.approx(1)


def test_noise_of_every_body_may_grow_with_its_own_motion() -> None:
    """Rows of uneven length, or noise that grows with all motion, would move all bodies at once."""
    for seed in range(3):
        found = said("growing noise of each", seed)
        assert found is not None
        assert found.statement.startswith("The noise of every body grows with its own motion: it is ")
        assert found.constants[0]["value"] == pytest.approx(1 + SLOPE, rel=0.2)


@pytest.mark.filterwarnings("error")
def test_outputs_that_are_predicted_exactly_are_no_warning() -> None:
    samples = [sample._replace(e=np.zeros_like(sample.e)) for sample in drawn("stalls", 0)]
    assert explained(ROBOT, fit_noise(samples[0].e), *samples) is None


@pytest.mark.long
@pytest.mark.parametrize(("kind", "names"), CONSTANTS.items())
def test_intervals_of_rows_hold_the_truth_as_often_as_they_say(kind: str, names: dict[str, float]) -> None:
    found = [f.constants for f in (said(kind, seed) for seed in range(ROW_SETS)) if f is not None]
    for name, truth in names.items():
        intervals = [c["ci95"] for constants in found for c in constants if c["name"] == name]
        hits = sum(low <= truth <= high for low, high in intervals)
        assert len(intervals) > ROW_SETS / 2
        assert hits >= binom.ppf(0.001, len(intervals), 0.95), name


@pytest.mark.parametrize("pieces", [5, 12])
def test_intervals_of_shaking_hold_the_truth_as_often_as_they_say(pieces: int) -> None:
    rng, window, time = np.random.default_rng(pieces), np.hanning(SEGMENT), np.arange(SEGMENT)
    hits = np.zeros(2, int)
    for _ in range(SETS):
        amplitude, frequency = 1.0, rng.uniform(6, 20)
        phase = rng.uniform(0, 2 * np.pi, (pieces, 1))
        x = amplitude * np.sin(2 * np.pi * frequency * time / SEGMENT + phase) + rng.normal(size=(pieces, SEGMENT))
        line = line_of(window * (x - x.mean(1, keepdims=True)), round(frequency), 1.0)
        hits += [low <= true <= high for (_, low, high), true in zip(line, (amplitude, frequency), strict=True)]
    assert hits.min() >= FEWEST


@pytest.mark.parametrize("strength", [0.7, 1.5])
def test_intervals_of_edges_hold_the_truth_as_often_as_they_say(strength: float) -> None:
    rng, rows = np.random.default_rng(0), Rows(np.zeros(600, int), STEP * np.arange(600.0))
    hits = np.zeros(2, int)
    for _ in range(SETS):
        acts = slice(*(sorted(rng.choice(np.arange(60, 540, 40), 2, replace=False))))
        e, direction = rng.normal(size=600), rng.normal(size=600)
        e[acts] -= strength * direction[acts]
        score, power = -direction * e, direction**2
        edges = np.array([acts.start, acts.stop]) + rng.integers(-5, 6, 2)
        best = _best(score, power, edges)
        intervals = edges_ci95(rows, Window(0, *(STEP * best)), score, power)
        hits += [
            low <= STEP * true <= high for (low, high), true in zip(intervals, (acts.start, acts.stop), strict=True)
        ]
    assert hits.min() >= FEWEST


def _best(score: np.ndarray, power: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """The likeliest of the stretches with edges near these."""
    near = [
        (a, b) for a in range(edges[0] - 25, edges[0] + 26) for b in range(edges[1] - 25, edges[1] + 26) if b > a + 5
    ]
    s, p = np.append(0, score.cumsum()), np.append(0, power.cumsum())
    a, b = np.array([(a, b) for a, b in near if a >= 0 and b <= len(score)]).T
    best = ((s[b] - s[a]) ** 2 / (p[b] - p[a])).argmax()
    return np.array([a[best], b[best]])
