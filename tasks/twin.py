"""Stage `twin`: a robot that stands in for the recorded one, and how well it does on sessions that it was not given."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray
from prefect import task

from simgap import learn, scores
from simgap.diagnosis.inference.explain import split
from simgap.formats.documents import read_json, write_json
from simgap.formats.folders import remove_file
from simgap.formats.recordings import digest, read_recordings
from simgap.prediction import Model
from simgap.recordings import to_transitions
from simgap.robots.twin import score
from simgap.robots.twin.fit import NOISE, fit
from simgap.robots.twin.model import Twin
from simgap.simulators.spot import SCHEMA, Spot
from simgap.types import Recording, Report, Sessions
from tasks import diagnosed
from tasks.cells import finished
from tasks.files.twins import save_twin
from tasks.fingerprint import of_twin
from tasks.params import Params
from tasks.recordings import FURTHER
from tasks.train import Job
from tasks.workspace import SPLITS, Workspace

Row = dict[str, Any]
KNOWN, UNKNOWN, SIM_MODEL, BLACK_BOX = "twin, durations as recorded", "twin", "sim_model", "fsvgd"
POINTS = 8
"""Of the error against the number of rows, in the figure."""
STALL = 2.0
"""From so many times the median duration on, a row counts as a stall."""


class Recorded(NamedTuple):
    """Sessions of the robot: those that policies are like, in folds; further ones, which no fold holds out."""

    sessions: list[Recording]
    further: list[Recording]

    @property
    def every(self) -> list[Recording]:
        """All of them."""
        return [*self.sessions, *self.further]


class Context(NamedTuple):
    """What all fits of a stage share: parameters, digest of the code, seconds, where lines go."""

    params: Params
    code: str
    clock: Callable[[], float]
    say: Callable[[str], None]

    @property
    def time_step(self) -> float:
        """Of the simulator [s]."""
        return 1 / self.params.transitions.nominal_rate_hz


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


@task(task_run_name="twin-fold-{fold}")
def fold_scores(workspace: Workspace, recorded: Recorded, fold: int, context: Context, job: Job) -> list[Row]:
    """Scores of a twin, SIM-MODEL and a black box that were learnt without every so many-th session, on these.

    A row for every way to predict; kept, and reused where data, parameters and code are the same.
    """
    params = context.params.twin
    count = params.fit.folds
    held = [r for i, r in enumerate(recorded.sessions) if i % count == fold]
    kept = [r for i, r in enumerate(recorded.sessions) if i % count != fold]
    path = workspace.twin_fold(fold)
    mark = of_twin(digest(recorded.every), context.params, f"{context.code} fold {fold}")
    if path.exists() and (known := read_json(path))["fingerprint"] == mark:
        return known["rows"]
    key, black_key, replay_key = jax.random.split(jax.random.key(params.seed + fold + 1), 3)
    with job(f"fold {fold + 1} of {count}", params.fit.training_steps) as report:
        twin = _fit(key, kept, recorded.further, context, report)
        others = _others(black_key, [*kept, *recorded.further], context)
    stride, horizons = context.params.score.stride, _horizons(context.params)
    measured = {
        KNOWN: score.multi_step(twin, held, horizons, stride, known=True),
        UNKNOWN: score.multi_step(twin, held, horizons, stride, known=False)
        | score.coverage(replay_key, twin, held, params.fit.horizon, params.fit.horizon // 2, params.fit.replays),
        **{name: scores.multi_step(model, SCHEMA, held, horizons, stride) for name, model in others.items()},
    }
    effects = ", ".join(twin.model.simulator.effects)  # type: ignore[attr-defined]  # it is augmented
    rows: list[Row] = [{"fold": fold, "model": name, "effects": effects if name in (KNOWN, UNKNOWN) else "", **found}
                       for name, found in measured.items()]  # fmt: skip
    write_json(path, {"fingerprint": mark, "rows": rows})
    return rows


@task(task_run_name="twin-{workspace.source}")
def fit_all(workspace: Workspace, recorded: Recorded, context: Context, job: Job) -> None:
    """The twin of all sessions, unless it was fitted before."""
    mark = of_twin(digest(recorded.every), context.params, context.code)
    path, record = workspace.twin, workspace.twin_record
    with job("all sessions", context.params.twin.fit.training_steps) as report:
        if finished(path, record, mark):
            return
        remove_file(record, workspace.root)
        start = context.clock()
        twin = _fit(jax.random.key(context.params.twin.seed), recorded.sessions, recorded.further, context, report)
        save_twin(path, twin)
        write_json(record, {
            "fingerprint": mark, "seconds": context.clock() - start, "sessions": len(recorded.every),
            "effects": list(twin.model.simulator.effects),  # type: ignore[attr-defined]  # it is augmented
            "ages_s": np.asarray(twin.ages), "row_s": float(twin.row_s),
            "stalls": float((twin.durations > STALL * jnp.median(twin.durations)).mean()),
        })  # fmt: skip


def _fit(
    key: PRNGKeyArray, sessions: Sequence[Recording], further: Sequence[Recording], context: Context, report: Report
) -> Twin:
    """Diagnosed from all of these sessions, fitted to them; departures of `further` are not replayed."""
    every, params = [*sessions, *further], context.params
    used = Sessions(*split(every))
    simulator, _ = diagnosed.diagnose(Spot(time_step=context.time_step), used, params.twin.seed, context.say)
    return fit(key, every, sessions, simulator, (params.twin.fit, params.train.residual), report)


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
    """Of the report, and so many that a curve can be drawn, up to the twin's own."""
    longest = params.twin.fit.horizon
    curve = np.unique(np.linspace(1, longest, POINTS).round().astype(int)).tolist()
    return tuple(sorted({*curve, *(h for h in params.score.horizons if h <= longest)}))
