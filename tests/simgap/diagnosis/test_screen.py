"""Where promising hypotheses are looked at more closely."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planted import SCALES, SPOT
from small import RICH, sessions

from simgap.diagnosis.config import BLOCK, FEW, LEAST_BLOCK, LEVEL
from simgap.diagnosis.hypotheses.space import hypotheses_of
from simgap.diagnosis.inference.evidence.null_distribution import (
    LOOKS,
    Chance,
    Evidence,
    blocks,
    by_chance,
    weigh,
    weigh_each,
)
from simgap.diagnosis.inference.evidence.score_test import closer
from simgap.diagnosis.inference.evidence.screening import Screened, Screening
from simgap.diagnosis.likelihood.scales import measure

KNOWN = hypotheses_of(SPOT, SCALES)


def screened(name: str, *starts: float) -> list[Screened]:
    (hypothesis,) = (c for c in KNOWN if c.name == name)
    return [Screened(hypothesis, (start,), 0, 1.0, 1.0, 1.0, 1.0, start) for start in starts]


@pytest.mark.parametrize("seed", [RICH, 11, 12])
def test_limits_are_looked_for_out_to_where_few_rows_reach(seed: int) -> None:
    """From the usual to the extreme, the next start is within a factor of two, which closer looks bridge."""
    training, _ = sessions({}, seed)
    scales = measure(SPOT, training)
    known = {c.name: c for c in hypotheses_of(SPOT, scales)}
    hand = np.concatenate([r.state[:, 6:8] - r.state[:, :2] for r in training])
    extremes = [("reach_limit.horizontal on ee", float(np.median(scales.reach)), np.hypot(*hand.T).max())]
    for k, field in enumerate(SPOT.simulator.schema.command):
        sent = np.abs(np.concatenate([r.command[:, k] for r in training])).max()
        step = max(np.abs(np.diff(r.command[:, k])).max() for r in training)
        extremes.append((f"saturation on {field.name}", scales.command[k], sent))
        extremes.append((f"rate_limit on {field.name}", scales.command_step[k], step))
    for name, usual, extreme in extremes:
        starts = np.array([1 / start for (start,) in known[name].starts])
        for limit in np.geomspace(usual, 0.98 * extreme, 20):
            assert np.abs(np.log(starts / limit)).min() < np.log(2), (name, limit)


def test_of_commands_of_one_sign_no_law_tells_signs_apart() -> None:
    """A thrust that is never negative has a gain, and no asymmetric one. Zero has no sign."""
    training, _ = sessions({}, RICH)
    forward = [r._replace(command=np.abs(r.command) * [1, -1, 1, 1, 1, 1]) for r in training]
    forward[0].command[0, 2] = -0.1  # this one has both signs
    names = [c.name for c in hypotheses_of(SPOT, measure(SPOT, forward))]
    assert {n for n in names if n.startswith("asymmetric_gain")} == {
        f"asymmetric_gain.{side} on cmd_base_wz" for side in ("negative", "positive")
    }
    assert "gain on cmd_base_vx" in names


def test_a_law_that_is_no_multiple_of_its_constant_is_looked_at_between_its_starts() -> None:
    values = [d.values[0] for d in closer(screened("delay on base", 1.0, 0.5, 2.0), KNOWN)]
    assert all(0.5 < v < 2.0 for v in values)
    assert any(v < 1 for v in values)
    assert any(v > 1 for v in values)


def test_nothing_lies_between_starts_of_opposite_signs() -> None:
    values = [d.values[0] for d in closer(screened("delay on base", 0.5, -1.0), KNOWN)]
    assert set(values) == {0.5}


def test_where_all_other_starts_explode_there_is_nothing_between() -> None:
    (direction,) = closer(screened("rate_limit on cmd_ee_vx", 8.0), KNOWN)
    assert direction.values == (8.0,)


def test_a_staircase_is_looked_for_at_odd_parts_and_on_single_commands() -> None:
    found = closer(screened("quantization on ee", 0.3, 0.27, 0.33), KNOWN)
    assert {d.hypothesis.where for d in found} == {"ee", "cmd_ee_vx", "cmd_ee_vy", "cmd_ee_vz"}
    for hypothesis in {d.hypothesis.where for d in found}:
        assert {0.3, 0.1, 0.06} <= {round(d.values[0], 9) for d in found if d.hypothesis.where == hypothesis}


@pytest.mark.parametrize("count", [FEW - 1, FEW])
def test_in_too_few_blocks_nothing_can_be_told_from_noise(count: int) -> None:
    """However strong an effect is: one whose score is ten times its information in every row."""
    power = np.ones((3, count * BLOCK))
    weighed = weigh(Evidence(10 * power, power, np.ones(3, bool)), np.arange(0, count * BLOCK, BLOCK))
    p_value = by_chance(weighed, np.random.default_rng(0)).p_value(weighed.statistic.max())
    assert (p_value < LEVEL) == (count == FEW)
    assert p_value <= 1


@given(st.lists(st.integers(0, 40), min_size=1, max_size=30))
def test_blocks_are_as_long_as_the_recordings_allow(rows: list[int]) -> None:
    """Never across two segments, never longer than `BLOCK`, and enough of them if there are enough rows."""
    counts = np.arange(40) < np.array(rows)[:, None]
    starts = blocks(counts)
    ends = np.array([*starts[1:], sum(rows)])
    assert starts.tolist() == sorted(set(starts))
    assert {0, *np.cumsum(rows).tolist()} <= {*starts.tolist(), sum(rows)}
    assert ((ends - starts) <= BLOCK).all()
    if sum(rows) >= FEW * LEAST_BLOCK:
        assert len(starts) >= FEW
    if sum(rows) >= FEW * BLOCK:
        assert len(starts) == sum(-(-n // BLOCK) for n in rows)


@pytest.mark.parametrize("spread", [1.0, 4.0])
def test_a_fit_passes_by_its_likelihood_ratio_on_the_scale_of_its_score(spread: float) -> None:
    """spread: variance of the score over its information: noise that is not independent."""
    maxima = np.random.default_rng(0).chisquare(1, 4000)
    (delay,) = screened("delay on base", 1.0)
    found = [delay._replace(gain=2.0, statistic=4.0 / spread)]
    screening = Screening(found, Evidence(*np.zeros((2, 1, 0)), np.ones(1, bool)), Chance(maxima, enough=True), ())
    assert screening.p_value_of_fit("delay on base", 2.0) == screening.p_value
    needed = spread * screening.threshold / 2
    assert screening.p_value_of_fit("delay on base", 1.01 * needed) <= LEVEL + 1e-3
    assert screening.p_value_of_fit("delay on base", 0.8 * needed) > LEVEL


@pytest.mark.parametrize("size", [0.1, 1.0, 30.0])
@given(
    rows=st.lists(st.integers(0, 70), min_size=1, max_size=8),
    looks=st.integers(1, 2 * LOOKS + 1),
    seed=st.integers(0, 2**32 - 1),
)
def test_looks_weigh_as_their_rows_do(size: float, rows: list[int], looks: int, seed: int) -> None:
    """However many are weighed at once: evidence outside of a look counts as none, that of silent laws too."""
    rng = np.random.default_rng(seed)
    counts = np.arange(70) < np.array(rows)[:, None]
    n, starts = sum(rows), blocks(counts)
    direction = size * rng.normal(size=(5, n)).astype(np.float32) * (rng.random((5, n)) < 0.5)
    direction[0] = 0.0
    noise = rng.normal(size=n).astype(np.float32)
    evidence = Evidence(direction * (noise + 0.3 * direction), direction**2, rng.random(5) < 0.5)
    chosen = rng.random((looks, n)) < rng.random((looks, 1))
    for look, found in zip(chosen, weigh_each(evidence, starts, chosen), strict=True):
        alone = weigh(Evidence(evidence.score * look, evidence.power * look, evidence.two_sided), starts)
        for a, b in zip(found, alone, strict=True):
            np.testing.assert_allclose(a, b, rtol=2e-3, atol=1e-4 * np.abs(b).max(initial=1.0))
