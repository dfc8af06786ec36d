"""The best time from which an effect acts is the best of all rows' times."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from simgap.diagnosis.config import NO_ONSET
from simgap.diagnosis.hypotheses.support import From, Window
from simgap.diagnosis.inference.evidence.scan import onset
from simgap.diagnosis.likelihood.segments import Rows

STEP = 1 / 15


@given(st.integers(0, 2**32 - 1), st.lists(st.integers(3, 40), min_size=1, max_size=4), st.booleans())
def test_the_onset_gains_what_the_best_of_all_onsets_does(seed: int, lengths: list[int], in_one: bool) -> None:
    rng = np.random.default_rng(seed)
    time_s = np.concatenate([np.arange(n) * STEP for n in lengths])
    rows = Rows(np.repeat(np.arange(len(lengths)), lengths), time_s)
    score, power = rng.normal(size=len(time_s)), rng.uniform(0.1, 1.0, len(time_s))
    mine = rows.session == 0 if in_one else time_s >= 0
    gain = lambda on: 0.5 * score[on].sum() ** 2 / power[on].sum()  # noqa: E731
    last = time_s[mine].max()
    later = [t for t in np.unique(time_s[mine]) if NO_ONSET * last < t < (1 - NO_ONSET) * last or (in_one and t == 0)]
    best = max((gain(mine & (time_s >= t)) - gain(time_s >= 0) for t in later), default=0.0)

    support, more = onset(rows, score, power, 0 if in_one else None)
    assert support == (Window(0, support.from_s, np.inf) if in_one else From(support.from_s))
    assert np.isclose(more, max(best, 0.0))
    if best > 0:
        assert np.isclose(gain(mine & (time_s >= support.from_s)) - gain(time_s >= 0), more)
