"""Recordings by their purpose in a diagnosis: read from folders or given, and checked against each other."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from simgap.derived import derived, sentence
from simgap.diagnosis.inference.explain import split
from simgap.engines import Engine
from simgap.formats.recordings import digest, read_recordings
from simgap.survey import kinematics
from simgap.types import Recording, RecordingError, Schema, Sessions, StepModel

ALIKE, OFF = 0.9, 1.5
"""From this correlation on, a velocity has the form of its position's rate of change; a factor beyond this between the
two is then one of units or signs, and not a sensor that is badly calibrated."""


class Folders(NamedTuple):
    """Folders of recordings: those to diagnose; held-out sessions and a baseline from when all was well, if in folders
    of their own; further recordings to diagnose, of other experiments with the same machine."""

    recordings: Path
    heldout: Path | None = None
    baseline: Path | None = None
    further: tuple[Path, ...] = ()

    @property
    def every(self) -> list[Path]:
        """All given folders."""
        return [self.recordings, *self.further, *filter(None, (self.heldout, self.baseline))]


class Given(NamedTuple):
    """Sessions from one place; `place` names it in messages, `label` is the prefix of names that coincide."""

    sessions: Sequence[Recording]
    place: str
    label: str


def read(folders: Folders, simulator: StepModel | Engine) -> tuple[Sessions, list[str]]:
    """The sessions by purpose, and why others are left out. Without a held-out folder, some sessions are held out.

    Raises RecordingError as `arranged` does, and where a folder has no usable session.
    """
    errors: list[str] = []
    recordings = together([in_folder(folder, simulator, errors) for folder in (folders.recordings, *folders.further)])
    others = (folder and in_folder(folder, simulator, errors) for folder in (folders.heldout, folders.baseline))
    return arranged(simulator.schema, recordings, *others), errors


def in_folder(folder: Path, simulator: StepModel | Engine, errors: list[str]) -> Given:
    """The usable sessions of a folder; reasons against others go to `errors`. RecordingError where none is usable."""
    recordings, bad = read_recordings(folder, simulator.schema, simulator.time_step)
    errors.extend(str(error) for error in bad)
    return Given(recordings, str(folder), folder.resolve().name)


def together(several: Sequence[Given]) -> Given:
    """The sessions of several places as those of one place; RecordingError where a session is in two of them."""
    first, *others = several
    sessions = list(first.sessions)
    for given in others:
        sessions += _apart(given, sessions)
    return Given(sessions, ", ".join(given.place for given in several), first.label)


def arranged(schema: Schema, recordings: Given, heldout: Given | None, baseline: Given | None) -> Sessions:
    """Sessions by purpose. Without `heldout`, some of `recordings` are held out.

    Raises RecordingError where a velocity is a difference of its position or has other units, or a session serves two
    purposes.
    """
    for given in filter(None, (recordings, heldout, baseline)):
        if wrong := [
            *map(sentence, derived(schema.measured, given.sessions)),
            *_in_other_units(schema, given.sessions),
        ]:
            raise RecordingError("\n".join(f"{given.place}: column {why}" for why in wrong))
    if heldout:
        training, held_out = list(recordings.sessions), _apart(heldout, recordings.sessions)
    else:
        training, held_out = split(recordings.sessions)
    return Sessions(training, held_out, _apart(baseline, [*training, *held_out]) if baseline else [])


def _in_other_units(schema: Schema, sessions: Sequence[Recording]) -> list[str]:
    """Why velocities cannot be the rates of their positions: a sentence for each."""
    return [
        f"{k.position} changes {k.slope:.3g} times as fast as {velocity} says (correlation {k.correlation:.2f}): one "
        "of the two has other units or another sign, which the diagnosis would find instead of the physics. Give "
        "`unit` or `sign` in the mapping (`simgap import`). Of a model file you may also remove both columns: the "
        "diagnosis then leaves this joint out."
        for velocity, k in kinematics(schema.measured, sessions).items()
        if abs(k.correlation) > ALIKE and not 1 / OFF < k.slope < OFF
    ]  # fmt: skip


def _apart(given: Given, others: Sequence[Recording]) -> list[Recording]:
    """The given sessions; RecordingError if one is among the others. Where names coincide, theirs get their label as
    a prefix."""
    seen = {digest([r]): r.name for r in others}
    for r in given.sessions:
        if same := seen.get(digest([r])):
            raise RecordingError(
                f"{given.place}: the session {r.name} is the session {same} of another folder; a session must serve "
                "one purpose: to be diagnosed, to judge by, or as baseline. Give it in one of the folders only."
            )
    if {r.name for r in given.sessions} & {r.name for r in others}:
        return [r._replace(name=f"{given.label}/{r.name}") for r in given.sessions]
    return list(given.sessions)
