"""The probability that the cause is among the names of an effect, from what speaks for and against it."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simgap.diagnosis.config import KNOWN
from simgap.diagnosis.inference.noise.effect import NoiseEffect, Spectrum
from simgap.diagnosis.validation.adequacy import Verdict, is_likely
from simgap.diagnosis.validation.calibration import RANGES, probability
from simgap.diagnosis.validation.indicators import Indicators
from simgap.diagnosis.validation.mistaken import PER_HUNDRED, USUAL, mistaken
from simgap.types import Field

PLAIN = Indicators(
    gain=np.log(300), lesser=0, misfit=np.log(2), bending=0, heldout=1, next_row=np.log(0.8), far=np.log(0.3),
    nameless=0, rivals=np.log(3), mistaken=np.log(USUAL),
)  # fmt: skip
"""An effect that explains all there is to explain."""

indicators = st.tuples(*[st.floats(-1e6, 1e6)] * len(Indicators._fields)).map(lambda values: Indicators(*values))


def test_what_explains_all_there_is_has_its_name() -> None:
    assert probability(PLAIN._replace(mistaken=mistaken("lag"))) > 0.9


@pytest.mark.parametrize(
    "against",
    [
        {"misfit": np.log(450), "bending": 0.6, "nameless": 0.5},
        {"gain": np.log(20), "lesser": np.log(100), "far": 0.0, "next_row": 0.0, "mistaken": mistaken("gain")},
        {"gain": np.log(20), "far": np.log(1.003), "next_row": 0.0, "nameless": 0.7},
    ],
    ids=[
        "its law must bend and much is left",
        "it mends a stronger one",
        "it is weak, no forecast improves, much is left",
    ],
)
def test_what_stands_in_for_something_else_has_none(against: dict[str, float]) -> None:
    assert probability(PLAIN._replace(**against)) < KNOWN


@pytest.mark.parametrize(
    ("odds", "known", "likely"),
    [(1.0, 0.49, False), (1.0, 0.51, True), (0.34, 0.95, True), (0.34, 0.7, False), (0.5, 0.55, False)],
)
def test_a_name_needs_a_likely_set_and_a_probability_of_its_own(odds: float, known: float, likely: bool) -> None:
    member: Any = SimpleNamespace(hypothesis=SimpleNamespace(effect=SimpleNamespace(id="lag")), odds={"lag": odds})
    assert is_likely(member, known) == likely


@given(indicators)
def test_it_is_a_probability_and_beyond_experience_that_at_its_end(of: Indicators) -> None:
    p = probability(of)
    assert 0 < p < 1
    ends = {name: float(np.clip(getattr(of, name), *range_)) for name, range_ in RANGES.items()}
    assert p == probability(Indicators(**ends))


def test_what_scales_the_simulator_is_mistaken_more_often_than_a_limit() -> None:
    assert mistaken("asymmetric_gain") > mistaken("sensor_scale") > mistaken("saturation") > mistaken("rate_limit")
    assert mistaken("slope") == np.log(USUAL)
    assert all(RANGES["mistaken"][0] <= mistaken(name) <= RANGES["mistaken"][1] for name in PER_HUNDRED)


@pytest.mark.parametrize("name", ["lesser", "misfit", "far", "nameless", "rivals", "mistaken"])
def test_what_speaks_against_a_name_makes_it_less_likely(name: str) -> None:
    assert probability(PLAIN._replace(**{name: RANGES[name][1]})) < probability(PLAIN)


@pytest.mark.parametrize(
    ("verdict", "more", "named"),
    [("missing_physics", False, True), ("missing_physics", True, False), ("unexplained", True, False)],
)
def test_while_physics_is_missing_the_noise_has_no_name(verdict: str, more: bool, named: bool) -> None:
    """What is missing may scatter the rows: on the training ground all sure names that were wrong were of the noise."""
    assert Verdict(verdict, (), (), more, None, (), {}, False).noise_named == named


@pytest.mark.parametrize(
    ("named", "known", "expected"),
    [((), (), 1.0), ((True,), (0.6,), 0.6), ((True, False, True), (0.9, 0.2, 0.7), 0.7), ((False,), (), 1.0)],
)
def test_the_noise_is_no_surer_than_the_physics_that_is_named(
    named: tuple[bool, ...], known: tuple[float, ...], expected: float
) -> None:
    """If that is something else, it may scatter the rows; a line in their spectrum is not made so."""
    of = Verdict("missing_physics", named, named, False, None, (), {}, False, known=known)
    spectrum = Spectrum(np.ones(9), 1.0, 3, 1, 0.1, Field("x", "m", "position", "world", "base", "x"))
    scatter, line = (cast(NoiseEffect, SimpleNamespace(shown=shown)) for shown in (None, spectrum))
    assert of.noise_known(scatter) == expected
    assert of.noise_known(line) == 1.0
