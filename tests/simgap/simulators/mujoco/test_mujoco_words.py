"""Nothing that is said of a machine of joints speaks of bodies, their frames or their yaw."""

import re
from typing import Any, cast

import pytest
from arms import arm
from hypothesis import given
from hypothesis import strategies as st

from simgap.diagnosis.hypotheses.features import seen_names
from simgap.diagnosis.report.names import number, title
from simgap.effects.augmented import Augmented
from simgap.effects.regime import features
from simgap.engines import Engine
from simgap.simulators.mujoco import load
from simgap.simulators.spot import Spot

OF_BODIES = r"\b(yaw|body|bodies|frame|robot's own)\b"


@pytest.fixture(scope="module")
def augmented(tmp_path_factory: pytest.TempPathFactory) -> Augmented:
    """Of two hinges and a slide."""
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(arm())
    return Augmented(cast(Engine, load(path, 0.02)))


def said(augmented: Augmented) -> list[str]:
    """Sentences and names of all effects that can act, of the regimes, and of what laws without a name depend on."""
    acting = [(e, sites) for e, sites in zip(augmented.catalogue, augmented.sites, strict=True) if sites]
    sentences = [text for e, _ in acting for text in (e.says, title(e.key), *(c.name for c in e.constants))]
    sites = [site.name for _, sites in acting for site in sites]
    return [*sentences, *sites, *(f.name for f in features(augmented.layout)), *seen_names(augmented.layout)]


def test_joints_have_no_words_of_bodies(augmented: Augmented) -> None:
    assert [text for text in said(augmented) if re.search(OF_BODIES, text)] == []
    assert {f.name for f in features(augmented.layout)} >= {"pan speed", "lift speed", "reach speed"}


def test_a_steady_push_on_a_joint_is_a_load_in_its_unit(augmented: Augmented) -> None:
    pushes: dict[str, Any] = {e.key: sites for e, sites in zip(augmented.catalogue, augmented.sites, strict=True)}
    for key in ("constant_load", "external_push.on_joint"):
        assert [(site.name, site.unit) for site in pushes[key]] == [
            ("pan_vel", "N m"),
            ("lift_vel", "N m"),
            ("reach_vel", "N"),
        ]
    assert pushes["body_frame_bias"] == pushes["external_push.own_frame"] == ()


def test_a_body_keeps_them() -> None:
    texts = said(Augmented(Spot()))
    assert {"base |yaw rate|", "body frame bias", "base yaw rate"} <= set(texts)
    assert "constant load" not in texts


@given(st.floats(1e-3, 9.99e5))
def test_a_number_has_three_digits_and_no_power_of_ten(value: float) -> None:
    said = number(value)
    assert "e" not in said
    assert float(said) == pytest.approx(value, rel=0.005)
    assert len(said.replace(".", "").strip("0")) <= 3
