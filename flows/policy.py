"""Stage `policy`: soft actor-critic in every model of the grid."""

import time
from pathlib import Path

from prefect import flow
from prefect.task_runners import ThreadPoolTaskRunner

from flows import provenance
from flows.start import main
from simgap.types import SimgapError
from tasks import fingerprint, policy, progress, tracking
from tasks.params import Params
from tasks.workspace import Cell, Workspace

EXPERIMENT = "policies"


@flow(name="policy", flow_run_name="policy-{source}")
def run(source: str, params: Params, root: Path) -> None:
    """Learn every policy that is not finished; one that failed is reported at the end and loses no other."""
    workspace, cells = Workspace(root, source), policy.grid(params.policy)
    policy.remove_stale(workspace, cells)
    tags, store = provenance.tags(workspace, workspace.models), provenance.store(EXPERIMENT)
    with tracking.grid_run(store, f"policies-{source}", params.policy.model_dump(), tags) as parent:
        progress.say(f"MLflow: {tracking.link(store, parent.run_id)}")
        grid = policy.Grid(parent, tags, fingerprint.code_digest(fingerprint.POLICY))
        failed = _fan_out(workspace, cells, params, grid)
        if failed:
            raise SimgapError(
                f"{len(failed)} of {len(cells)} policies failed; the others are kept:\n"
                + "\n".join(f"  {name}: {why}" for name, why in failed.items())
                + "\nMend the cause and start again: finished policies are not repeated."
            )


def _fan_out(workspace: Workspace, cells: list[Cell], params: Params, grid: policy.Grid) -> dict[str, str]:
    """A task a policy, `params.policy.workers` at a time; returns what went wrong, by cell."""
    runner = ThreadPoolTaskRunner(max_workers=params.policy.workers)
    with progress.bars(f"policy on {workspace.source}", len(cells), time.monotonic) as bars, runner:
        common = {"workspace": workspace, "params": params.policy, "grid": grid, "job": bars.job,
                  "clock": time.perf_counter}  # fmt: skip
        futures = {cell.name: runner.submit(policy.learn_policy, {"cell": cell, **common}) for cell in cells}
        for future in futures.values():
            future.wait()
    return {name: str(f.state.message) for name, f in futures.items() if not f.state.is_completed()}


if __name__ == "__main__":
    main(run)
