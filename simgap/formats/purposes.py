"""Recordings by their purpose in a diagnosis: read from folders or given, and checked against each other."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from simgap import survey
from simgap.derived import derived, sentence
from simgap.engines import Engine
from simgap.formats.rates import in_other_units
from simgap.formats.recordings import digest, read_recordings
from simgap.recordings import split
from simgap.types import Recording, RecordingError, Schema, Sessions, StepModel


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


class Purposes(NamedTuple):
    """What is given for a diagnosis: sessions to diagnose, and held-out ones and a baseline if there are any."""

    recordings: Given
    heldout: Given | None = None
    baseline: Given | None = None

    @property
    def every(self) -> list[Given]:
        """What is given for each purpose."""
        return [given for given in self if given]

    def narrowed(self, old: Schema, new: Schema) -> "Purposes":
        """The same sessions, of the columns of `old`, with those of `new` alone, which are some of them."""
        states, commands = ([f.name for f in part] for part in (old.outputs, old.command))
        state, command = [states.index(f.name) for f in new.outputs], [commands.index(f.name) for f in new.command]

        def narrow(given: Given) -> Given:
            return given._replace(
                sessions=[r._replace(state=r.state[:, state], command=r.command[:, command]) for r in given.sessions]
            )

        return Purposes(narrow(self.recordings), *(given and narrow(given) for given in self[1:]))


def read(folders: Folders, simulator: StepModel | Engine) -> tuple[Purposes, list[str]]:
    """The usable sessions by purpose, and why others are left out; RecordingError where a folder has none."""
    errors: list[str] = []
    recordings = together([in_folder(folder, simulator, errors) for folder in (folders.recordings, *folders.further)])
    others = (folder and in_folder(folder, simulator, errors) for folder in (folders.heldout, folders.baseline))
    return Purposes(recordings, *others), errors


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


def arranged(simulator: StepModel | Engine, given: Purposes) -> Sessions:
    """Sessions that serve one purpose each. Without `heldout`, some of `recordings` are held out.

    Raises RecordingError where a velocity is a difference of its position or has other units, or a session serves two
    purposes.
    """
    for part in given.every:
        if wrong := [
            *map(sentence, derived(simulator.schema.measured, part.sessions)),
            *(survey.sentence(*found) for found in in_other_units(simulator, part.sessions).items()),
        ]:
            raise RecordingError("\n".join(f"{part.place}: column {why}" for why in wrong))
    recordings, heldout, baseline = given
    if heldout:
        training, held_out = list(recordings.sessions), _apart(heldout, recordings.sessions)
    else:
        training, held_out = split(recordings.sessions)
    before = _apart(baseline, [*training, *held_out]) if baseline else []
    return Sessions(training, held_out, before, exchangeable=not heldout and len(recordings.sessions) > 1)


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
