"""A velocity in other units than its position is refused; one that is badly calibrated is left to the diagnosis."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import pytest

from simgap.findings import findings, look
from simgap.formats.purposes import Given, Purposes, arranged
from simgap.types import Field, Parameter, Recording, RecordingError, Schema

SCHEMA = Schema(
    state=(
        Field("jaw_pos", "rad", "position", "jaw", "jaw", "yaw"),
        Field("jaw_vel", "rad/s", "velocity", "jaw", "jaw", "yaw"),
    ),
    command=(),
)


@dataclass(frozen=True)
class Jaw:
    """A jaw that keeps its velocity. Its position may change `factor` times as fast."""

    parameters: tuple[Parameter, ...] = ()
    schema: Schema = SCHEMA
    time_step: float = 0.02

    def step(self, params, state, command):  # noqa: ARG002
        factor = params[0] if self.parameters else 1.0
        return jnp.stack([state[0] + self.time_step * factor * state[1], state[1]])


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
        arranged(Jaw(), Purposes(wrong))
    (found,) = (line for line in findings(SCHEMA, 0.02, look(SCHEMA, wrong.sessions)) if "times as fast" in line)
    # `simgap check` says the same, and what it cannot know, as it is given no simulator.
    same, unknown = f"logs: column {found}".split(" A simulator")
    assert str(error.value) == same
    assert unknown == " that has a parameter for that factor may still be right."
    with pytest.raises(RecordingError, match="logs: column jaw_pos"):
        arranged(Jaw(), Purposes(Given(sessions(1.0), "now", "now"), baseline=wrong))


@pytest.mark.parametrize(("factor", "noise"), [(1.0, 0.0), (0.8, 0.0), (1.3, 0.0), (3.0, 30.0)])
def test_a_badly_calibrated_or_noisy_velocity_is_not(factor: float, noise: float) -> None:
    found = arranged(Jaw(), Purposes(Given(sessions(factor, noise), "logs", "logs")))
    assert len(found.training) + len(found.heldout) == 2


def test_a_factor_that_a_parameter_may_have_is_a_matter_of_the_simulator() -> None:
    """As gamma of SIM-MODEL, from 0.9 to 2.4: a Spot whose base moves 1.6 times as fast as it says is no wrong file."""
    jaw = Jaw((Parameter("factor", "-", 0.9, 2.4),))
    for rate, allowed in ((1.6, True), (2.3, True), (4.0, False), (-1.0, False)):
        given = Purposes(Given(sessions(1 / rate), "logs", "logs"))
        if allowed:
            assert len(arranged(jaw, given).training) == 1
        else:
            with pytest.raises(RecordingError, match="times as fast as jaw_vel says"):
                arranged(jaw, given)
