"""Stage `conceal`: recordings with concealed effects, their keys sealed."""

from flows.sealed.start import main

if __name__ == "__main__":
    main("flows.sealed.conceal", __doc__)  # before the imports, which take seconds

import time
from pathlib import Path

from flows.flow import flow
from simgap.cli import progress
from tasks import fingerprint
from tasks.params_sealed import SealedParams
from tasks.sealed import conceal
from tasks.sealed.workspace import SealedWorkspace


@flow(name="conceal", flow_run_name="conceal-{suite}")
def run(suite: str, params: SealedParams, root: Path) -> None:
    """Write a suite; an examination's seeds are fixed by the diagnosing code and the round."""
    workspace = SealedWorkspace(root, suite)
    real = lambda: conceal.read_real(params.conceal.real)  # noqa: E731
    code = fingerprint.diagnosing_code(workspace.has_models)
    with progress.bars(f"conceal {suite}", 1, time.monotonic) as bars, bars.job(suite, 0) as report:
        manifest = conceal.write(workspace, params.conceal, code, real, report)
    progress.say(f"{len(manifest['keys'])} cases in {len(manifest['parts'])} parts: {workspace.cases}\n"
                 f"hashes of their keys: {workspace.published}")  # fmt: skip
