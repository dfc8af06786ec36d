"""The deployments, served: what Prefect's pages start runs here, a process each."""

import argparse
import asyncio
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import httpx
from prefect import Flow
from prefect.deployments.runner import RunnerDeployment
from prefect.runner import Runner
from prefect.types.entrypoint import EntrypointType

from flows import deployments, sweep
from flows.errors import guarded
from flows.running import LOGS
from flows.start import PARAMS
from simgap.formats.documents import write_text
from simgap.formats.yaml_files import read_yaml
from tasks import forms
from tasks.params import load_params

READY = LOGS / "deployments.ready"
"""There while the deployments are served."""
SOURCE = "virtual"
_ASK_S = 3.0


def main() -> None:
    """Serve until the process is asked to end."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--runs", type=int, default=2, help="runs at a time; others wait")
    given = parser.parse_args()
    guarded(lambda: asyncio.run(_serve(made(), given.runs)))


class _Runner(Runner):
    """Told to end, it cancels its runs, where Prefect's own (3.8.8) leaves them to be killed; and it goes on asking
    which are to be cancelled, where that one gives up once its server was gone for half a minute."""

    def handle_sigterm(self, *_: Any, **__: Any) -> None:
        asyncio.run_coroutine_threadsafe(self.astop(), asyncio.get_running_loop())

    async def __aenter__(self) -> Self:
        await super().__aenter__()
        self._runs_task_group.start_soon(self._ask)
        return self

    async def _ask(self) -> None:
        assert self._cancelling_observer is not None
        while not self.stopping:
            with suppress(httpx.HTTPError):  # the server is gone
                await self._cancelling_observer._check_for_cancelled_flow_runs()
            await asyncio.sleep(_ASK_S)


async def _serve(deployments: list[RunnerDeployment], runs: int) -> None:
    runner = _Runner(name="simgap", limit=runs, pause_on_shutdown=False)
    for deployment in deployments:
        await runner.aadd_deployment(deployment)
    write_text(READY, "")
    try:
        await runner.start()
    finally:
        READY.unlink(missing_ok=True)


def made() -> list[RunnerDeployment]:
    """Every deployment, its form filled in from params.yaml; those called small, from pipelines/small.yaml too."""
    found = []
    for size, overrides in (("full", []), ("small", [read_yaml(Path("pipelines/small.yaml"))])):
        params, rest = load_params(PARAMS, *overrides), forms.besides(overrides[0] if overrides else {})
        grid = forms.defaults(params, SOURCE)
        tracking = {"recordings": grid["recordings"], "policies": forms.policies(params)}
        whole = {name: value for name, value in grid.items() if name != "hyperparameters"}
        for flow, values in (
            (sweep.run, grid),
            (deployments.reproduce, {**whole, "overrides": rest}),
            (deployments.track, {**tracking, "overrides": rest}),
        ):
            made = _deployment(flow, f"{flow.name}-{size}", values)
            # Prefect has no other way to a schema that depends on a file.
            forms.with_sources(made._parameter_openapi_schema.definitions, list(params.recordings))
            found.append(made)
    asked = {"recordings": f"data/{SOURCE}/recordings/training", "seed": params.diagnose.seed}
    found.append(_deployment(deployments.diagnose_recordings, "diagnose-folder", asked))
    return found


def _deployment(flow: Flow[..., None], name: str, parameters: dict[str, Any]) -> RunnerDeployment:
    made = flow.to_deployment(name, parameters=parameters, entrypoint_type=EntrypointType.MODULE_PATH)
    assert isinstance(made, RunnerDeployment)  # not a coroutine: nothing runs here
    return made


if __name__ == "__main__":
    main()
