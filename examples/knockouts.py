"""Spot with a known part taken out of what is known of it: from recordings of a robot, a diagnosis must name that part.

The velocity that turning induces at the hand is taken out of the simulator:

    simgap diagnose RECORDINGS --simulator examples.knockouts:WITHOUT_INDUCED_VELOCITY

The paper's simulator follows commands at once, so there is no delay to take out of it. The recordings are given one
more instead: what was sent stands in them some rows before the row in which it was.

    python -m examples.knockouts RECORDINGS LATE --rows 2
    simgap diagnose LATE --baseline RECORDINGS
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

from jaxtyping import Array, Float

from flows.errors import guarded
from simgap.formats.recordings import read_recordings, write_recording
from simgap.simulators.spot import SCHEMA, Spot, induced_velocity
from simgap.types import Recording


@dataclass(frozen=True)
class WithoutInducedVelocity(Spot):
    """The kinematic model with v^ind = 0: turning the base does not carry the hand along."""

    def step(
        self, params: Float[Array, " 24"], state: Float[Array, " 12"], command: Float[Array, " 6"]
    ) -> Float[Array, " 12"]:
        """The next state, less what turning adds to the hand's velocity and so to its position."""
        then = super().step(params, state, command)
        arm = state[6:9].at[:2].add(-state[:2])
        v_ind = induced_velocity(then[5], arm)
        return then.at[9:].add(-v_ind).at[6:9].add(-self.time_step * params[21:] * v_ind)


WITHOUT_INDUCED_VELOCITY = WithoutInducedVelocity()


def late(recording: Recording, rows: int) -> Recording:
    """The session as it would be had every command acted `rows` rows later than it did."""
    end = len(recording.time_s) - rows
    return Recording(recording.name, recording.time_s[:end], recording.state[:end], recording.command[rows:])


def main() -> None:
    """Write a recording set whose commands act later."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("recordings", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--rows", type=int, default=2)
    arguments = parser.parse_args()

    def work() -> None:
        sessions, errors = read_recordings(arguments.recordings, SCHEMA, Spot().time_step)
        if errors:
            raise errors[0]
        for session in sessions:
            write_recording(arguments.out, late(session, arguments.rows), SCHEMA)

    guarded(work)


if __name__ == "__main__":
    main()
