"""The regime to which an effect is restricted is the best of all edges, and an effect that acts everywhere has none."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from simgap.diagnosis.config import LEAST_ROWS_OF_REGIME, SILENT
from simgap.diagnosis.inference.evidence.scan import narrowest
from simgap.effects.regime import EVERYWHERE

SHARE = 0.03


def gain(score: np.ndarray, power: np.ndarray) -> float:
    return 0.5 * score.sum() ** 2 / power.sum()


@given(st.integers(0, 2**32 - 1), st.integers(30, 200), st.sampled_from([-1.0, 1.0]), st.booleans())
def test_the_regime_gains_what_the_best_of_all_edges_does(seed: int, rows: int, side: float, coarse: bool) -> None:
    rng = np.random.default_rng(seed)
    found = rng.normal(size=(rows, 3))
    found = found.round(1) if coarse else found
    power = rng.uniform(0.5, 2.0, rows)
    score = rng.normal(size=rows) * np.sqrt(power) + 2 * power * (side * found[:, 1] > 0)
    regime, more = narrowest(found, score, power, SHARE)

    best = 0.0
    for column in found.T:
        for edge in np.unique(column)[:-1]:
            for acting in (column > edge, column <= edge):
                into = gain(score[acting], power[acting])
                if (
                    LEAST_ROWS_OF_REGIME <= acting.mean() <= 1 - LEAST_ROWS_OF_REGIME
                    and gain(score[~acting], power[~acting]) < SILENT + SHARE * into
                ):
                    best = max(best, into - gain(score, power))
    np.testing.assert_allclose(more, best, rtol=1e-9, atol=1e-9)
    if more > 0:
        within = regime.side * (found[:, regime.feature] - regime.edge) > 0
        np.testing.assert_allclose(gain(score[within], power[within]) - gain(score, power), more)


@given(st.integers(0, 2**32 - 1))
def test_what_acts_everywhere_has_no_regime(seed: int) -> None:
    rng = np.random.default_rng(seed)
    power = rng.uniform(0.5, 2.0, 400)
    score = power + 0.3 * rng.normal(size=400)
    assert narrowest(rng.normal(size=(400, 5)), score, power, SHARE) == (EVERYWHERE, 0.0)
