"""A sealed suite from end to end, at its smallest: concealed, examined without keys, scored; resumed, not fooled."""

import copy
import json
import math
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest
import yaml
from killing import Work, worker

from concealed import seal
from flows.sealed import conceal, examine, score
from simgap.formats.atomic import remove_unfinished
from simgap.formats.documents import read_json, write_json, write_text
from simgap.types import SimgapError
from tasks.params_sealed import SealedParams, load_sealed
from tasks.sealed import baselines, metrics
from tasks.sealed.conceal import seed_of
from tasks.sealed.examine import fingerprint, remove_stale
from tasks.sealed.examine import finished as examined_before
from tasks.sealed.workspace import SealedWorkspace

ROOT = Path(__file__).parents[2]
TINY = {"conceal": {"nulls": 1, "effects": ["saturation"]}, "examine": {"workers": 1}}


@pytest.fixture(scope="module")
def params() -> SealedParams:
    small = yaml.safe_load((ROOT / "pipelines" / "sealed" / "small.yaml").read_text())
    return load_sealed(ROOT / "pipelines" / "sealed" / "params.yaml", small, TINY)


@pytest.fixture(scope="module")
def work() -> Iterator[Work]:
    with worker(os.environ, ["sealed.conceal", "sealed.examine", "sealed.score"]) as work:
        yield work


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory, params: SealedParams) -> SealedWorkspace:
    """After `conceal`, in a folder from which stages can be started as from the command line."""
    workspace = SealedWorkspace(tmp_path_factory.mktemp("sealed"), "development")
    write_text(workspace.root / "pipelines" / "sealed" / "params.yaml", yaml.safe_dump(params.model_dump(mode="json")))
    conceal.run.fn("development", params, workspace.root)
    return workspace


@pytest.fixture(scope="module")
def examined(workspace: SealedWorkspace, params: SealedParams, work: Work) -> SealedWorkspace:
    """After `examine`, twice, where the last of the two cases cannot be read: it fails, and loses no other, even where
    the first time was killed before the last record, which is damaged besides."""
    other, damaged = read_json(workspace.manifest)["parts"][0]
    session = workspace.cases / damaged / "a.csv"
    session.write_text(session.read_text().replace("cmd_ee_vz", "nothing"))
    assert work(workspace.root, "sealed.examine development", writes=2) == -9
    assert not workspace.record(damaged).exists()
    diagnosed = workspace.record(other).stat().st_mtime_ns
    write_text(workspace.record(damaged), '{"fingerpr')
    with pytest.raises(SimgapError, match=f"1 of 2 cases failed(.|\n)*{damaged}.*cmd_ee_vz is missing"):
        examine.run("development", params, workspace.root)
    assert read_json(workspace.record(other))["error"] is None
    assert workspace.record(other).stat().st_mtime_ns == diagnosed  # it is not done again
    session.write_text(session.read_text().replace("nothing", "cmd_ee_vz"))
    return workspace


def test_a_suite_whose_making_was_killed_passes_for_none(
    workspace: SealedWorkspace, work: Work, tmp_path: Path
) -> None:
    """Killed before the manifest, over a whole suite: it is refused, and made anew the same."""
    killed = SealedWorkspace(tmp_path / "killed", workspace.suite)
    shutil.copytree(workspace.root, killed.root)
    assert work(killed.root, "sealed.conceal development", writes=3) == -9
    assert len(list(killed.cases.iterdir())) == 2
    assert not killed.manifest.exists()
    assert work(killed.root, "sealed.examine development") == 1
    assert work(killed.root, "sealed.conceal development") == 0
    assert killed.manifest.read_bytes() == workspace.manifest.read_bytes()
    assert not list(killed.root.rglob(".*.tmp"))


@pytest.mark.parametrize("name", ["record.json", "diagnosis.json"])
@pytest.mark.parametrize("damage", ['{"fing', "[1]", ""])
def test_a_damaged_examination_is_done_again(tmp_path: Path, name: str, damage: str) -> None:
    workspace, marks = SealedWorkspace(tmp_path, "development"), {"a": "mark", "b": "mark", "c": "mark"}
    for case in ("a", "b", "gone"):
        write_json(workspace.record(case), {"fingerprint": "mark", "seconds": 1.0, "error": None})
        write_json(workspace.statement(case), {})
    (workspace.examinations / "b" / name).write_text(damage)
    assert not examined_before(workspace, "b", "mark")
    assert remove_stale(workspace, marks) == ["b"]
    assert [case for case in marks if examined_before(workspace, case, "mark")] == ["a"]
    assert [folder.name for folder in workspace.examinations.iterdir()] == ["a"]


def test_a_case_without_recordings_is_told_of(tmp_path: Path) -> None:
    with pytest.raises(SimgapError, match="a: there are no recordings of this case"):
        fingerprint(SealedWorkspace(tmp_path, "development"), "a", 0, "code")


def test_baselines_without_a_share_have_none(recwarn: pytest.WarningsRecorder) -> None:
    null = {"kind": "null", "strength": 0.0, "right_verdict": True, "sindy_claims": False, "share": math.nan}
    ours, *_ = baselines.table([null])
    assert math.isnan(ours["share of improvement, 50 steps"])
    assert not recwarn.list


def test_names_and_hashes_are_published_and_nothing_else(workspace: SealedWorkspace) -> None:
    manifest = read_json(workspace.published)
    names = sorted(c.name for c in workspace.cases.iterdir())
    assert sorted(manifest["keys"]) == names == sorted(n for part in manifest["parts"] for n in part)
    assert all(len(digest) == 64 for digest in manifest["keys"].values())
    assert "saturation" not in json.dumps(manifest) + workspace.sealed.read_bytes().decode("latin1")
    assert workspace.secret.stat().st_mode & 0o077 == 0


@pytest.mark.long
def test_every_case_is_scored_and_the_report_is_whole(
    examined: SealedWorkspace,
    params: SealedParams,
    work: Work,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(examined.root)
    version = read_json(examined.manifest)
    earlier = examined.reports / "00000000-round-0"
    write_text(earlier / "report.md", "of another version")
    score.run("development", params, examined.root)
    score.run("development", params, examined.root)
    report = examined.report(version["code"], version["round"])
    assert list(examined.reports.iterdir()) == [report]
    assert not (report / "failures").exists()
    text = (report / "report.md").read_text()
    assert "saturation" in text
    assert {"manifest.json", "power.png", "confusion.png", "reliability.png", "cases.csv", "report.md"} <= {
        p.name for p in report.iterdir()
    }
    assert read_json(examined.metrics).keys() <= set(metrics.HEADLINE.values())
    assert "broke off: 1" in text
    history = pd.read_csv(examined.history, dtype={"code": str}).set_index("score")
    assert history.index.is_unique  # though it was scored twice
    assert (history.loc["cases that failed", "value"], history.loc["cases that failed", "n"]) == (0.5, 2)
    assert set(history["code"]) == {report.name[:8]}

    written = {path: path.read_bytes() for path in report.parent.rglob("*") if path.is_file()}
    assert work(examined.root, "sealed.score development", writes=2) == -9
    assert list(report.parent.glob(".*.tmp"))
    remove_unfinished(report.parent)
    assert {path: path.read_bytes() for path in report.parent.rglob("*") if path.is_file()} == written


@pytest.mark.long
def test_an_examinations_failures_are_drawn(
    examined: SealedWorkspace, params: SealedParams, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And its scores join those of the other suites in one table."""
    examination = SealedWorkspace(tmp_path, "examination")
    shutil.copytree(examined.root / "data", tmp_path / "data")
    for ours, theirs in (
        (examined.data, examination.data), (examined.keys, examination.keys),
        (examined.examinations, examination.examinations),
    ):  # fmt: skip
        shutil.copytree(ours, theirs)
    examination.published.parent.mkdir(parents=True)
    shutil.copy(examined.manifest, examination.published)
    shutil.copy(examined.history, examination.history)
    monkeypatch.chdir(tmp_path)
    score.run.fn("examination", params, tmp_path)
    (report,) = examination.reports.iterdir()
    pictures = [line for line in (report / "report.md").read_text().splitlines() if line.startswith("![")]
    assert sum("failures/" in line for line in pictures) >= 1
    for line in pictures:
        assert (report / line.split("](")[1][:-1]).exists(), line
    assert set(pd.read_csv(examination.history)["suite"]) == {"development", "examination"}


@pytest.mark.long
def test_cases_of_two_versions_of_the_code_are_not_scored_as_one(
    examined: SealedWorkspace, params: SealedParams
) -> None:
    path = next(p for p in map(examined.record, sorted(read_json(examined.manifest)["keys"])) if p.exists())
    record = read_json(path)
    # The message lists versions in order; no other comes before this one.
    write_json(path, {**record, "fingerprint": f"0000000000000000-{record['fingerprint'].split('-', 1)[1]}"})
    try:
        with pytest.raises(SimgapError, match=r"different versions of the code, 0000000000000000, .*Run the stage"):
            score.run.fn("development", params, examined.root)
    finally:
        write_json(path, record)


@pytest.mark.long
def test_another_key_than_the_published_one_is_refused(examined: SealedWorkspace, params: SealedParams) -> None:
    closed, published = examined.sealed.read_bytes(), read_json(examined.manifest)["keys"]
    secret = examined.secret.read_bytes()
    keys = copy.deepcopy(seal.unseal(closed, secret, published))
    for key in keys.values():
        key["kind"] = "null"
    examined.sealed.write_bytes(seal.seal(keys, dict.fromkeys(keys, "00"), secret))
    try:
        with pytest.raises(SimgapError, match="not those whose hashes were published"):
            score.run.fn("development", params, examined.root)
    finally:
        examined.sealed.write_bytes(closed)


@pytest.mark.long
def test_seeds_of_an_examination_are_fixed_by_code_and_round(params: SealedParams) -> None:
    asked = params.conceal
    later = asked.model_copy(update={"round": 1})
    of = lambda suite, params, code: tuple(seed_of(suite, params, code))  # noqa: E731
    assert of("development", asked, "a") == of("development", asked, "b")
    seeds = {of("examination", asked, "a"), of("examination", asked, "b"), of("examination", later, "a")}
    assert len(seeds) == 3
    assert of("examination", asked, "a") == of("examination", asked.model_copy(update={"seed": 9}), "a")
