"""What a diagnosis finds in a share of the training sessions: the simulator of the models that are given it."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from prefect import task

from simgap.formats.arrays import load_arrays, save_arrays
from simgap.formats.documents import read_json, write_json
from simgap.formats.effects import augmented_arrays, augmented_spot
from simgap.formats.folders import remove_file
from simgap.formats.recordings import digest, read_recordings
from simgap.recordings import HISTORY, divide
from simgap.simulators.augmented import AugmentedSimulator
from simgap.simulators.spot import SCHEMA, Spot
from simgap.types import ConfigError, Recording, Sessions
from tasks.cells import finished
from tasks.fingerprint import of_diagnosis
from tasks.workspace import Cell, Share, TwinShare, Workspace

FITTED = 0.75
"""Share of the transitions that the effects are fitted to; the others judge, none of the test sessions does."""


class Found(NamedTuple):
    """The simulator with what was found and what identifies the diagnosis.

    All accepted effects are in it, named or not: their constants were fitted together, and without some of them the
    others are wrong. Effects on the scatter and those that act for a while only are not.
    """

    simulator: AugmentedSimulator
    fingerprint: str


def shares(cells: Sequence[Cell]) -> list[Share]:
    """Every share of the recordings that cells have diagnosed, in the order of the cells."""
    return list(dict.fromkeys(cell.share for cell in cells if cell.share is not None))


def sessions(recordings: Sequence[Recording], share: Share) -> Sessions:
    """Sessions in an order drawn from the seed until their transitions number N, the last one cut.

    Raises ConfigError when the recordings have fewer than N transitions.
    """
    available = sum(len(r.time_s) - 1 - HISTORY for r in recordings)
    if share.sample_size > available:
        raise ConfigError(
            f"N = {share.sample_size} transitions are asked for and the training sessions have {available}. "
            "Lower train.sample_sizes, or add sessions."
        )
    order = np.random.default_rng(share.seed).permutation(len(recordings))
    taken, _ = divide([recordings[i] for i in order], share.sample_size)
    return Sessions(*divide(taken, round(FITTED * share.sample_size)))


@task(task_run_name="{share.name}")
def find(
    workspace: Workspace,
    share: Share,
    time_step: float,
    code: str,
    report: Callable[[str], None],
    clock: Callable[[], float],
) -> None:
    """Diagnose the kinematic model with a share of the training sessions, unless that was done before.

    `code` is the digest of the diagnosis' code; `clock` gives seconds.
    """
    recordings, errors = read_recordings(workspace.recordings / "training", SCHEMA, time_step)
    if errors:
        raise errors[0]
    used = sessions(recordings, share)
    keep(workspace, share, used, (time_step, share.seed, code), report, clock)


def keep(
    workspace: Workspace,
    share: Share | TwinShare,
    used: Sessions,
    how: tuple[float, int, str],
    report: Callable[[str], None],
    clock: Callable[[], float],
) -> None:
    """Diagnose the kinematic model with these sessions, unless that was done before, for `load` to read.

    `how`: the time step [s], the seed, the digest of the diagnosis' code.
    """
    time_step, seed, code = how
    mark = of_diagnosis(share, digest([*used.training, *used.heldout]), time_step, code)
    arrays, record = workspace.augmented(share), workspace.effects(share)
    if finished(arrays, record, mark):
        report("diagnosed before")
        return
    # Should this fail, what was found by other code must not pass for its result.
    remove_file(record, workspace.root)
    start, spot = clock(), Spot(time_step=time_step)
    from simgap.diagnosis.inference.explain import explain  # takes most of a second, and few grids need it

    found = explain(spot, used, np.random.default_rng(seed), report)
    simulator = AugmentedSimulator.of(spot, found.acting(found.fit), found.problem.scales)
    save_arrays(arrays, augmented_arrays(simulator))
    write_json(record, {**share._asdict(), "fingerprint": mark, "seconds": clock() - start,
                              "effects": list(simulator.effects),
                              "found": [m.hypothesis.name for m in found.members],
                              "scattered": [s.id for s in found.noise_effects]})  # fmt: skip


def seen(workspace: Workspace, share: Share, time_step: float) -> list[Recording]:
    """The sessions that a share's diagnosis sees, the last one cut; RecordingError where one cannot be used."""
    recordings, errors = read_recordings(workspace.recordings / "training", SCHEMA, time_step)
    if errors:
        raise errors[0]
    used = sessions(recordings, share)
    return [*used.training, *used.heldout]


def load(workspace: Workspace, share: Share | TwinShare) -> Found:
    """What `find` or `keep` found; SimgapError when it has not been run."""
    simulator = augmented_spot(load_arrays(workspace.augmented(share)))
    return Found(simulator, read_json(workspace.effects(share))["fingerprint"])
