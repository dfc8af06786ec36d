"""A velocity in other units than its position is refused; one that is badly calibrated is left to the diagnosis."""

import numpy as np
import pytest

from simgap.findings import findings, look
from simgap.formats.purposes import Given, Purposes, arranged
from simgap.types import Field, Recording, RecordingError, Schema

SCHEMA = Schema(
    state=(
        Field("jaw_pos", "rad", "position", "jaw", "jaw", "yaw"),
        Field("jaw_vel", "rad/s", "velocity", "jaw", "jaw", "yaw"),
    ),
    command=(),
)


def sessions(factor: float, noise: float = 0.0) -> list[Recording]:
    """Two sessions of a sine; their velocities are `factor` times the rate of the position."""
    time, rng = np.arange(300) / 50, np.random.default_rng(0)
    rate = 2 * np.cos(2 * time)
    columns = [np.column_stack([np.sin(2 * time), factor * rate + rng.normal(0, 1e-3 + noise, 300)]) for _ in range(2)]
    return [Recording(f"walk_{i}", time, state, np.zeros((300, 0))) for i, state in enumerate(columns)]


@pytest.mark.parametrize(("factor", "says"), [(180 / np.pi, "0.017"), (-1.0, "-(1|0.99)"), (2.35, "0.42")])
def test_other_units_or_signs_are_refused_with_a_remedy(factor: float, says: str) -> None:
    wrong = Given(sessions(factor), "logs", "logs")
    words = rf"logs: column jaw_pos changes {says}\S* times as fast as jaw_vel says .* Give `unit` or `sign`"
    with pytest.raises(RecordingError, match=words) as error:
        arranged(SCHEMA, Purposes(wrong))
    (found,) = (line for line in findings(SCHEMA, 0.02, look(SCHEMA, wrong.sessions)) if "times as fast" in line)
    assert str(error.value) == f"logs: column {found}"  # `simgap check` says the same
    with pytest.raises(RecordingError, match="logs: column jaw_pos"):
        arranged(SCHEMA, Purposes(Given(sessions(1.0), "now", "now"), baseline=wrong))


@pytest.mark.parametrize(("factor", "noise"), [(1.0, 0.0), (0.8, 0.0), (1.3, 0.0), (3.0, 30.0)])
def test_a_badly_calibrated_or_noisy_velocity_is_not(factor: float, noise: float) -> None:
    found = arranged(SCHEMA, Purposes(Given(sessions(factor, noise), "logs", "logs")))
    assert len(found.training) + len(found.heldout) == 2
