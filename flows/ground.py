"""Stage `ground`: machines drawn at random, whose missing physics is known, diagnosed and scored."""

from flows.start_table import main

if __name__ == "__main__":
    main("ground", __doc__)  # before the imports, which take seconds

import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from queue import Queue

from prefect.task_runners import ThreadPoolTaskRunner

from flows.flow import flow
from simgap.cli import progress
from tasks import calibration, fingerprint, ground, verdicts
from tasks.params_machines import GroundParams
from tasks.params_machines import load_ground as load
from tasks.processes import one_process

__all__ = ["load", "run"]


@flow(name="ground")
def run(params: GroundParams, root: Path) -> None:
    """Diagnose every case that this version has not diagnosed; one that fails loses no other."""
    runs = verdicts.Runs(root / ground.RUNS, fingerprint.diagnosing_code(model_file=True)[:8])
    wanted, done = range(params.first, params.first + params.cases), runs.done
    left = [number for number in wanted if str(number) not in done]
    progress.say(f"{len(wanted) - len(left)} of {len(wanted)} cases are diagnosed already")
    idle: Queue[ProcessPoolExecutor] = Queue()
    for _ in range(params.workers):
        idle.put(one_process())
    runner = ThreadPoolTaskRunner(max_workers=params.workers)
    with progress.bars("ground", len(left), time.monotonic) as bars, runner:
        common = {"seed": params.seed, "idle": idle, "job": bars.job, "keep": runs.keep}
        futures = {number: runner.submit(ground.diagnose_case, {"number": number, **common}) for number in left}
        for number, future in futures.items():
            future.wait()
            if not future.state.is_completed():
                runs.keep({"case": number} | verdicts.failed(str(future.state.message)))
    while not idle.empty():
        idle.get().shutdown()
    progress.say("\n".join(verdicts.summary(runs.own)))
    progress.say(calibration.calibrate(runs.every, root))
