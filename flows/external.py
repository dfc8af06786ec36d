"""Stage `external`: machines that nobody here made, diagnosed and scored against what their makers say of them."""

from flows.start_table import main

if __name__ == "__main__":
    main("external", __doc__)  # before the imports, which take seconds

import time
from pathlib import Path

from flows.flow import flow
from simgap.cli import progress
from simgap.types import SimgapError
from tasks import external, fingerprint, verdicts
from tasks.params_machines import ExternalParams
from tasks.params_machines import load_external as load

__all__ = ["load", "run"]


@flow(name="external")
def run(params: ExternalParams, root: Path) -> None:
    """Diagnose every machine that this version has not diagnosed; one that fails loses no other."""
    runs = verdicts.Runs(root / external.RUNS, fingerprint.diagnosing_code(model_file=True)[:8])
    done = runs.done
    left = [case for case in params.cases if case.name not in done]
    progress.say(f"{len(params.cases) - len(left)} of {len(params.cases)} machines are diagnosed already")
    with progress.bars("external", len(left), time.monotonic) as bars:
        for case in left:
            started = time.monotonic()
            with bars.job(case.name, 1):
                try:
                    row = external.row_of(case, external.diagnose(case, params, root))
                except SimgapError as error:
                    row = verdicts.failed(str(error))
            progress.say(f"{case.name}: {row['outcome']}; {row.get('named') or row['verdict']}")
            runs.keep({"case": case.name, "seconds": time.monotonic() - started, **row})
    progress.say("\n".join(verdicts.summary(runs.own)))
