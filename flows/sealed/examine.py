"""Stage `examine`: every case diagnosed, by processes that cannot open a key."""

from flows.sealed.start import main

if __name__ == "__main__":
    main("flows.sealed.examine", __doc__)  # before the imports, which take seconds

import queue
import time
from pathlib import Path

from prefect.task_runners import ThreadPoolTaskRunner

from flows.flow import flow
from simgap.cli import progress
from simgap.formats.documents import read_json
from simgap.types import SimgapError
from tasks import fingerprint
from tasks.params_sealed import SealedParams
from tasks.sealed import examine
from tasks.sealed.workspace import SealedWorkspace


@flow(name="examine", flow_run_name="examine-{suite}")
def run(suite: str, params: SealedParams, root: Path) -> None:
    """Diagnose what is not diagnosed yet; cases that failed are reported at the end and lose no other."""
    workspace, wanted = SealedWorkspace(root, suite), params.examine
    manifest = read_json(workspace.manifest)
    code = fingerprint.diagnosing_code(workspace.has_models)
    cases = examine.chosen(manifest, wanted)
    marks = {case: examine.fingerprint(workspace, case, wanted.seed, code) for case in manifest["keys"]}
    for case in examine.remove_stale(workspace, marks):
        progress.say(f"warning: {workspace.examination(case)}: a file of it is damaged. The case is examined again.")
    left = [case for case in cases if not examine.finished(workspace, case, marks[case])]
    progress.say(f"{len(cases) - len(left)} of {len(cases)} cases are diagnosed already")
    failed = _fan_out(workspace, left, marks, params)
    if failed:
        raise SimgapError(f"{len(failed)} of {len(cases)} cases failed; the others are kept:\n"
                          + "\n".join(f"  {case}: {why}" for case, why in failed.items()))  # fmt: skip


def _fan_out(
    workspace: SealedWorkspace, cases: list[str], marks: dict[str, str], params: SealedParams
) -> dict[str, str]:
    """A task a case, on as many processes as are asked for; returns what went wrong, by case."""
    workers, seed = params.examine.workers, params.examine.seed
    idle: queue.Queue[examine.Examiner] = queue.Queue()
    examiners = [examine.Examiner(workspace.keys, params.examine.patience_s) for _ in range(workers)]
    for examiner in examiners:
        idle.put(examiner)
    failed: dict[str, str] = {}
    runner = ThreadPoolTaskRunner(max_workers=workers)
    try:
        with progress.bars(f"examine {workspace.suite}", len(cases), time.monotonic) as bars, runner:
            common = {"workspace": workspace, "idle": idle, "marks": marks, "seed": seed, "job": bars.job}
            futures = {c: runner.submit(examine.examine_case, {"case": c, **common}) for c in cases}
            for case, future in futures.items():
                future.wait()
                if not future.state.is_completed():
                    failed[case] = str(future.state.message)
                elif (why := future.result()) is not None:
                    failed[case] = why
    finally:
        for examiner in examiners:
            examiner.close()
    return failed
