"""What is stated of a machine that other code simulates, with something planted in it or nothing."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.types import Recording, Sessions, StepModel

Session = Callable[..., Recording]
"""(rng, what is planted) -> a recording."""


def stated(simulator: StepModel, session: Session, seed: int, **planted: Any) -> dict[str, Any]:
    """The statement on three sessions to fit and one held out."""
    rng = np.random.default_rng(seed)
    recordings = [session(rng, **planted) for _ in range(4)]
    return diagnose(simulator, "machine", Sessions(recordings[:3], recordings[3:])).statement


def check_named_alone(statement: Mapping[str, Any], key: str, constants: Mapping[str, float]) -> None:
    (named,) = statement["effects"]
    assert f"{named['id']}.{named['form']}".rstrip(".") == key
    for c in named["constants"]:
        assert c["value"] == pytest.approx(constants[c["name"]], rel=0.05), c


def check_nothing_found(statement: Mapping[str, Any]) -> None:
    assert statement["found"] == []
    assert statement["verdict"] in ("nothing", "parameters_only", "inconclusive")
