"""Stage `twin`: a robot that stands in for the recorded one, and how well it does on sessions that it was not given."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray
from prefect import task

from simgap import learn, scores
from simgap.formats.documents import read_json, write_json
from simgap.formats.folders import remove_file
from simgap.formats.recordings import digest, read_recordings
from simgap.prediction import Model
from simgap.recordings import HISTORY, split, to_transitions
from simgap.robots.twin import score
from simgap.robots.twin.fit import NOISE, fit
from simgap.robots.twin.model import Twin
from simgap.simulators.augmented import AugmentedSimulator
from simgap.simulators.spot import SCHEMA, Spot
from simgap.types import Recording, RecordingError, Report, Sessions
from tasks import diagnosed
from tasks.cells import finished
from tasks.files.twins import save_twin
from tasks.fingerprint import of_twin
from tasks.params import Params
from tasks.recordings import FURTHER
from tasks.workspace import SPLITS, TwinShare, Workspace

Row = dict[str, Any]
KNOWN, UNKNOWN, SIM_MODEL, BLACK_BOX = "twin, durations as recorded", "twin", "sim_model", "fsvgd"
POINTS = 8
"""Number of horizons on the curve of the figure."""
STALL = 2.0
"""A row that lasts longer than this many times the median counts as a stall."""


class Recorded(NamedTuple):
    """Sessions of the robot: those that policies are like, in folds; further ones, which no fold holds out."""

    sessions: list[Recording]
    further: list[Recording]

    def without(self, share: TwinShare, folds: int) -> "Recorded":
        """But for those of the fold that is held out."""
        kept = [r for i, r in enumerate(self.sessions) if i % folds != share.held_out]
        return Recorded(kept, self.further)

    def held_out(self, share: TwinShare, folds: int) -> list[Recording]:
        """Those of the fold."""
        return [r for i, r in enumerate(self.sessions) if i % folds == share.held_out]

    @property
    def every(self) -> list[Recording]:
        """All of them."""
        return [*self.sessions, *self.further]


class Context(NamedTuple):
    """What all fits of a stage share: parameters, digests of the code of twins and of the diagnosis, seconds, where
    lines go."""

    params: Params
    code: str
    diagnosis: str
    clock: Callable[[], float]
    say: Callable[[str], None]

    @property
    def time_step(self) -> float:
        """Of the simulator [s]."""
        return 1 / self.params.transitions.nominal_rate_hz

    @property
    def folds(self) -> int:
        """Of the cross-validation."""
        return self.params.twin.fit.folds

    def key(self, share: TwinShare) -> PRNGKeyArray:
        """Of the fits and draws for these sessions."""
        number = 0 if share.held_out is None else share.held_out + 1
        return jax.random.fold_in(jax.random.key(self.params.twin.seed), number)


def shares(folds: int) -> list[TwinShare]:
    """All sessions; all but those of each fold."""
    return [TwinShare(None), *map(TwinShare, range(folds))]


@task(task_run_name="load-sessions-{workspace.source}")
def load(workspace: Workspace, time_step: float) -> Recorded:
    """Every session of the source; RecordingError where one cannot be used."""
    found: list[list[Recording]] = []
    for part in (*SPLITS, FURTHER):
        folder = workspace.recordings / part
        recordings, errors = read_recordings(folder, SCHEMA, time_step) if folder.exists() else ([], [])
        if errors:
            raise errors[0]
        found.append(recordings)
    *split_up, further = found
    return Recorded([r for part in split_up for r in part], further)


@task(task_run_name="twin-diagnosis-{share.name}")
def diagnose(workspace: Workspace, share: TwinShare, recorded: Recorded, context: Context) -> None:
    """What the kinematic model leaves out of these sessions, unless that was found before."""
    used = Sessions(*split(recorded.without(share, context.folds).every))
    how = (context.time_step, context.params.twin.seed, context.diagnosis)
    diagnosed.keep(workspace, share, used, how, context.say, context.clock)


@task(task_run_name="twin-{share.name}")
def fold_scores(
    workspace: Workspace, share: TwinShare, recorded: Recorded, context: Context, report: Report
) -> list[Row]:
    """Scores of a twin, SIM-MODEL and a black box that were learnt without a fold of the sessions, on these.

    A row for every way to predict; kept, and reused where data, parameters and code are the same.
    """
    params, found = context.params, diagnosed.load(workspace, share)
    path = workspace.twin_fold(share)
    mark = of_twin(digest(recorded.every), params, context.code, found.fingerprint)
    if path.exists() and (known := read_json(path))["fingerprint"] == mark:
        return known["rows"]
    kept, held = recorded.without(share, context.folds), recorded.held_out(share, context.folds)
    if all(len(r.state) <= params.twin.fit.horizon + HISTORY for r in held):
        raise RecordingError(
            f"no session of fold {share.held_out} ({', '.join(r.name for r in held) or 'which has none'}) has more "
            f"than {params.twin.fit.horizon + HISTORY} rows, so nothing can be predicted there. Lower twin.fit.folds "
            "or twin.fit.horizon, or give longer sessions."
        )
    key, black_key, replay_key = jax.random.split(context.key(share), 3)
    twin = _fit(key, kept, found.simulator, context, report)
    stride, horizons, own = params.score.stride, _horizons(params), params.twin.fit
    measured = {
        KNOWN: score.multi_step(twin, held, horizons, stride, known=True),
        UNKNOWN: score.multi_step(twin, held, horizons, stride, known=False)
        | score.coverage(replay_key, twin, held, own.horizon, own.horizon // 2, own.replays),
        **{name: scores.multi_step(model, SCHEMA, held, horizons, stride)
           for name, model in _others(black_key, kept.every, context).items()},
    }  # fmt: skip
    effects = {name: ", ".join(found.simulator.effects) for name in (KNOWN, UNKNOWN)}
    rows: list[Row] = [{"fold": share.held_out, "model": name, "effects": effects.get(name, ""), **numbers}
                       for name, numbers in measured.items()]  # fmt: skip
    write_json(path, {"fingerprint": mark, "rows": rows})
    return rows


@task(task_run_name="twin-{workspace.source}")
def fit_all(workspace: Workspace, recorded: Recorded, context: Context, report: Report) -> None:
    """The twin of all sessions, unless it was fitted before."""
    share = TwinShare(None)
    found = diagnosed.load(workspace, share)
    mark = of_twin(digest(recorded.every), context.params, context.code, found.fingerprint)
    path, record = workspace.twin, workspace.twin_record
    if finished(path, record, mark):
        return
    remove_file(record, workspace.root)
    start = context.clock()
    twin = _fit(context.key(share), recorded, found.simulator, context, report)
    save_twin(path, twin)
    write_json(record, {
        "fingerprint": mark, "seconds": context.clock() - start, "sessions": len(recorded.every),
        "effects": list(found.simulator.effects), "ages_s": np.asarray(twin.ages), "row_s": float(twin.row_s),
        "stalls": float((twin.durations > STALL * jnp.median(twin.durations)).mean()),
    })  # fmt: skip


def _fit(
    key: PRNGKeyArray, recorded: Recorded, simulator: AugmentedSimulator, context: Context, report: Report
) -> Twin:
    """Fitted to all of these sessions; what is missed in further ones is not replayed."""
    configs = (context.params.twin.fit, context.params.train.residual)
    return fit(key, recorded.every, recorded.sessions, simulator, configs, report)


def _others(key: PRNGKeyArray, sessions: Sequence[Recording], context: Context) -> dict[str, Model]:
    """What a twin is compared with: the kinematic model, and networks without a simulator."""
    data, params, spot = to_transitions(SCHEMA, sessions), context.params.train, Spot(time_step=context.time_step)
    order = jax.random.permutation(key, len(data.x))
    rows = (jnp.asarray(data.x)[order], jnp.asarray(data.y)[order])
    quiet: Report = lambda *_: None  # noqa: E731
    return {
        SIM_MODEL: learn.sim_model(rows, spot, params.sim_model, NOISE, quiet),
        BLACK_BOX: learn.fsvgd_model(key, rows, spot, params.fsvgd, params.bnn, NOISE, quiet),
    }


def _horizons(params: Params) -> tuple[int, ...]:
    """Horizons of the scores: those of the report, and `POINTS` for the curve, none beyond the twin's own."""
    longest = params.twin.fit.horizon
    curve = np.unique(np.linspace(1, longest, POINTS).round().astype(int)).tolist()
    return tuple(sorted({*curve, *(h for h in params.score.horizons if h <= longest)}))
