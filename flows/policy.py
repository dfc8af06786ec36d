"""Stage `policy`: soft actor-critic in every model of the grid."""

from flows.start import main

if __name__ == "__main__":
    main("flows.policy", __doc__)  # before the imports, which take seconds

from pathlib import Path

from flows import provenance
from flows.fan_out import fan_out
from flows.flow import flow
from simgap.cli import progress
from simgap.types import SimgapError
from tasks import fingerprint, policy
from tasks.params import Params
from tasks.tracking import links
from tasks.tracking.runs import grid_run
from tasks.workspace import Workspace

EXPERIMENT = "policies"


@flow(name="policy", flow_run_name="policy-{source}")
def run(source: str, params: Params, root: Path) -> None:
    """Learn every policy that is not finished; one that failed is reported at the end and loses no other."""
    workspace, cells = Workspace(root, source), policy.grid(params.policy)
    policy.remove_stale(workspace, cells)
    tags, store = provenance.tags(workspace, workspace.models), provenance.store(EXPERIMENT)
    with grid_run(store, f"policies-{source}", params.policy.model_dump(), tags) as parent:
        progress.say(f"MLflow: {links.to_run(store, parent.run_id)}")
        grid = policy.Grid(
            parent, tags, *map(fingerprint.code_digest, (fingerprint.POLICY, fingerprint.POLICY_RESIDUAL))
        )
        work = {(workspace, cell): {"params": params, "grid": grid} for cell in cells}
        failed = fan_out(f"policy on {source}", policy.learn_policy, work, params.policy.workers)
        if failed:
            raise SimgapError(
                f"{len(failed)} of {len(cells)} policies failed; the others are kept:\n"
                + "\n".join(f"  {cell.name}: {why}" for (_, cell), why in failed.items())
                + "\nMend the cause and start again: finished policies are not repeated."
            )
