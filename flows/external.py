"""Stage `external`: machines that nobody here made, diagnosed and scored against what their makers say of them."""

from flows.start_external import main

if __name__ == "__main__":
    main()  # before the imports, which take seconds

import time
from pathlib import Path

from flows.flow import flow
from simgap.cli import progress
from simgap.types import SimgapError
from tasks import external, fingerprint
from tasks.params import ExternalParams


@flow(name="external")
def run(params: ExternalParams, root: Path) -> None:
    """Diagnose every machine that this version has not diagnosed; one that fails loses no other."""
    code = fingerprint.diagnosing_code(model_file=True)[:8]
    done = {row["case"] for row in external.earlier(root) if row["code"] == code and row["outcome"] != "failed"}
    left = [case for case in params.cases if case.name not in done]
    progress.say(f"{len(done)} of {len(params.cases)} machines are diagnosed already")
    with progress.bars("external", len(left), time.monotonic) as bars:
        for case in left:
            started = time.monotonic()
            with bars.job(case.name, 1):
                try:
                    row = external.judged(case, external.diagnose(case, params, root))
                except SimgapError as error:
                    row = external.failed(str(error))
            progress.say(f"{case.name}: {row['outcome']}; {row.get('named') or row['verdict']}")
            external.keep(root, {"code": code, "case": case.name, "seconds": time.monotonic() - started, **row})
    rows = [row for row in external.earlier(root) if row["code"] == code]
    progress.say("\n".join(external.summary(rows)))
