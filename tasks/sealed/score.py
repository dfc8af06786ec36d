"""Stage `score`: what was said of every case against its key, opened here for the first time."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from prefect import task

from concealed import sessions
from concealed.case import features, noise_of
from concealed.plain import STATE, observer, refit, robot, whitened
from concealed.strength import UNLIKE, UNSURE
from simgap.formats import statements
from simgap.formats.atomic import replacing_folder
from simgap.formats.documents import read_json, write_json, write_table, write_text
from simgap.formats.folders import remove_folder
from simgap.types import SimgapError
from tasks.params_sealed import SealedScoreParams
from tasks.sealed import baselines, figures, history, metrics, report
from tasks.sealed.examine import code_of
from tasks.sealed.judge import Row, invented_friction, judge, moved, overlap, rows_of
from tasks.sealed.keys import opened
from tasks.sealed.workspace import EXAMINATION, MODEL, SealedWorkspace
from tasks.tracking.runs import Run

SYSID = "sysid.json"
"""File in the folder of an arm's diagnosis: the results of MuJoCo's toolbox on the same case."""
FRICTION = "coulomb_friction"


class Opened(NamedTuple):
    """The manifest and the keys of a suite, checked against the hashes that were published before.

    code: start of the digest of the code that diagnosed the cases, which may be later than the one they were made with.
    """

    manifest: dict[str, Any]
    keys: dict[str, dict[str, Any]]
    code: str


@task(task_run_name="open-{workspace.suite}")
def open_keys(workspace: SealedWorkspace) -> Opened:
    """The keys; SimgapError where they are not those whose hashes were published."""
    manifest, keys = opened(workspace)
    return Opened(manifest, keys, _diagnosing(workspace, sorted(keys)))


def _diagnosing(workspace: SealedWorkspace, cases: Sequence[str]) -> str:
    """Start of the digest of the code by which all cases were examined."""
    records = [read_json(workspace.record(c)) for c in cases if workspace.record(c).exists()]
    codes = sorted({code_of(record["fingerprint"]) for record in records})
    if not codes:
        raise SimgapError(f"{workspace.examinations}: no case was examined. Run the stage `examine`.")
    if len(codes) > 1:
        raise SimgapError(
            f"{workspace.examinations}: cases were examined by different versions of the code, {', '.join(codes)}; a "
            "score is of one. Run the stage `examine` again."
        )
    return codes[0]


@task(task_run_name="judge-{workspace.suite}")
def rows(workspace: SealedWorkspace, opened: Opened, report: Callable[[int, dict[str, float]], None]) -> list[Row]:
    """A row for every case that was examined."""
    found = []
    for case in sorted(opened.keys):
        if not workspace.record(case).exists():
            continue
        record, key = read_json(workspace.record(case)), opened.keys[case]
        statement = statements.read(workspace.statement(case)) if workspace.statement(case).exists() else None
        row = {"case": case, **judge(key, statement, record["seconds"], record["error"])}
        row["fault"] = metrics.fault(row)
        if workspace.has_models:
            row |= _of_arm(workspace, case, key, statement)
        elif workspace.has_spots:
            row |= _of_spot(workspace, case, key, statement)
        found.append(row)
        report(len(found), {})
    return found


def _of_spot(workspace: SealedWorkspace, case: str, key: dict[str, Any], statement: dict[str, Any] | None) -> Row:
    """What only the Spot's states can be asked: where a regime lies, and what another method says."""
    state, command = sessions.read(workspace.recordings(case))
    row = baselines.sparse(state, command, key)
    if key["kind"] == "regime" and statement is not None:
        rules = [r["regime"] for r in statement["located"]["regimes"]]
        row["regime_overlap"] = overlap(key["when"]["regime"], rules, features(state, command))
    return row


def _of_arm(workspace: SealedWorkspace, case: str, key: dict[str, Any], statement: dict[str, Any] | None) -> Row:
    """What only a model can be asked: which right parameters were moved and where friction is invented, by the
    diagnosis and by MuJoCo's toolbox."""
    if statement is None:
        return {}
    parameters = statement["parameters"]
    joints = (c.removeprefix("cmd_") for e in statement["effects"] if e["id"] == FRICTION for c in e["channels"])
    return {
        "moved": moved(parameters["nominal"], parameters["fitted"], key),
        "friction": invented_friction(joints, key),
        **_by_toolbox(workspace, case, key, statement["fit"]["heldout_sessions"]),
    }


def _by_toolbox(workspace: SealedWorkspace, case: str, key: dict[str, Any], heldout: Sequence[str]) -> Row:
    """The toolbox's results. Its fit takes minutes, so they are kept with the diagnosis whose sessions they share."""
    from tasks.sealed.sysid import identified  # needs development dependencies

    path, mark = workspace.examination(case) / SYSID, read_json(workspace.record(case))["fingerprint"]
    kept: dict[str, Any] = read_json(path) if path.exists() else {}
    if kept.get("fingerprint") != mark:
        folder = workspace.case(case)
        kept = {"fingerprint": mark, "row": identified(folder / MODEL, folder, heldout, key)}
        write_json(path, kept)
    return kept["row"]


@task(task_run_name="report-{workspace.suite}")
def write(
    workspace: SealedWorkspace, opened: Opened, found: list[Row], params: SealedScoreParams, commit: str
) -> list[metrics.Score]:
    """Report, figures, every case, the manifest, the metrics and the history; returns the table.

    An earlier report stays until this one is whole. Of an examination's failures there are pictures.
    """
    table, dpi = metrics.table(found, np.random.default_rng(params.seed)), params.figure_dpi
    failed = metrics.failures(found)
    about = {
        "suite": workspace.suite, "diagnosing code": opened.code, "made with the code": opened.manifest["code"][:16],
        "round": opened.manifest["round"], "commit": commit or "unknown",
        "cases": f"{len(found)} of {len(opened.keys)}",
    }  # fmt: skip
    drawn = params.pictures if workspace.suite == EXAMINATION else 0
    with replacing_folder(_folder(workspace, opened)) as folder:
        figures.power(folder / "power.png", metrics.power(found), dpi)
        figures.confusion(folder / "confusion.png", found, 6.0, dpi)
        figures.reliability(folder / "reliability.png", metrics.reliability(found), dpi)
        pictures = {}
        for row in failed[:drawn]:
            pictures[row["case"]] = f"failures/{row['case']}.png"
            _picture(workspace, row, opened.keys[row["case"]], folder / pictures[row["case"]], dpi)
        others = baselines.of_arms(found) if workspace.has_models else baselines.table(found)
        text = report.markdown(about, found, table, others, failed, pictures)
        write_text(folder / "report.md", text)
        columns = list(dict.fromkeys(name for row in found for name in row))
        write_table(folder / "cases.csv", [{c: row.get(c) for c in columns} for row in found])
        write_json(folder / "manifest.json", opened.manifest)
    for earlier in set(workspace.reports.glob("*-round-*")) - {_folder(workspace, opened)}:
        remove_folder(earlier, workspace.reports)
    write_json(workspace.metrics, metrics.headline(table))
    version = {"suite": workspace.suite, "code": opened.code[:8], "round": opened.manifest["round"]}
    history.add(workspace, {**version, "cases": len(found), "of": len(opened.keys)}, table)
    return table


def _folder(workspace: SealedWorkspace, opened: Opened) -> Path:
    return workspace.report(opened.code, opened.manifest["round"])


def _picture(workspace: SealedWorkspace, row: Row, key: dict[str, Any], path: Path, dpi: int) -> None:
    state, command = sessions.read(workspace.recordings(row["case"]))
    of = robot(np.array(key["parameters"])[None]) if "parameters" in key else UNLIKE
    by = observer(of, noise_of(key["recipe"]["level"]) if "parameters" in key else UNSURE)
    _, e = refit(of, by, state[None], command[None])
    white = whitened(by, e[0])
    order = np.concatenate([white[..., :3, 0], white[..., :3, 1], white[..., 3:, 0], white[..., 3:, 1]], axis=-1)
    when, where = key["when"] or {}, None
    if "regime" in when:
        where = rows_of(when["regime"], features(state, command))
    truth = row["truth"] or "nothing"
    said = row["answer"] or row["verdict"].replace("_", " ")
    probability = "" if np.isnan(row["probability"]) else f" ({row['probability']:.2f})"
    title = f"{row['case']}: {row['fault']}. Truth: {truth}, {row['strength']:.0f} nats. Answer: {said}{probability}"
    figures.failure(path, title, STATE, order, None if where is None else where[:, 1:], dpi)


@task(task_run_name="log-{workspace.suite}", retries=1)
def log(run: Run, workspace: SealedWorkspace, opened: Opened, table: Sequence[metrics.Score]) -> None:
    """Scores and report of the suite, so that versions of the diagnosis are compared over time."""
    run.params({"suite": workspace.suite, "round": opened.manifest["round"], "code": opened.code})
    run.scores({_metric(s.name): s.value for s in table})
    for path in sorted(_folder(workspace, opened).glob("*.*")):
        run.artifact(path)


def _metric(name: str) -> str:
    """MLflow's names admit no brackets and few other signs."""
    return "".join(c if c.isalnum() or c in "_-. " else "_" for c in name)
