"""Links to runs in MLflow's pages, and the pages themselves."""

import base64
import json
import shlex
import zlib
from collections.abc import Sequence
from typing import Any

from mlflow.utils.mlflow_tags import MLFLOW_PARENT_RUN_ID

from tasks.tracking.store import Store, without_password

# The pages open in a mode for language models otherwise.
_TRAINING = "?workflowType=machine_learning"
MODEL_RESULTS = (
    "metrics.`nll`", "metrics.`validation_nll`", "metrics.`calibration_error`", "metrics.`training_seconds`",
)  # fmt: skip
POLICY_RESULTS = (
    "metrics.`helix/mean_error`", "metrics.`ellipse/mean_error`", "metrics.`return`", "metrics.`lost`",
    "metrics.`training_seconds`",
)  # fmt: skip
DIAGNOSIS_RESULTS = (
    "metrics.`augmented/nll_1`", "metrics.`refitted/nll_1`", "metrics.`black_box/nll_1`", "tags.`verdict`",
    "tags.`effects`",
)  # fmt: skip
"""Results shown where runs stand side by side, sorted by the first; see `to_comparison`."""


def to_run(store: Store, run_id: str) -> str:
    """How a person finds the run: its address, or the command that serves it and the address then."""
    page = f"#/experiments/{store.experiment_id}/runs/{run_id}{_TRAINING}"
    if store.pages or store.uri.startswith("http"):
        return f"{without_password(store.pages or store.uri).rstrip('/')}/{page}"
    served = f"mlflow ui --backend-store-uri {shlex.quote(without_password(store.uri))}"
    name = store.client.get_run(run_id).info.run_name
    return f"{name}: {served}, then http://127.0.0.1:5000/{page}"


def to_comparison(store: Store, view: str, query: str, results: Sequence[str]) -> str:
    """Where the runs that a query finds stand side by side in the pages, as the view of this name: the parameters that
    differ and these results, the least value of the first on top; empty where no pages are served."""
    if not store.pages:
        return ""
    columns = [*differing(store, query), *results]
    state = {"searchFilter": query, "selectedColumns": columns, "orderByKey": results[0], "orderByAsc": True}
    # As the pages' own button for sharing a view writes it.
    packed = "deflate;" + base64.b64encode(zlib.compress(json.dumps(state).encode())).decode()
    store.client.set_experiment_tag(store.experiment_id, f"mlflow.sharedViewState.{view}", packed)
    return f"{store.pages}/#/experiments/{store.experiment_id}/runs{_TRAINING}&viewStateShareKey={view}"


def differing(store: Store, query: str) -> list[str]:
    """Columns of the parameters that have several values among the runs that a query finds, parents of runs apart."""
    found = store.client.search_runs([store.experiment_id], query)
    parents = {run.data.tags.get(MLFLOW_PARENT_RUN_ID) for run in found}
    values: dict[str, set[str]] = {}
    for run in found:
        if run.info.run_id not in parents:
            for name, value in run.data.params.items():
                values.setdefault(name, set()).add(value)
    return [f"params.`{name}`" for name, several in values.items() if len(several) > 1]


def settings(store: str, artifacts: str) -> dict[str, str]:
    """Environment in which `application` serves a store and the folder of what runs have logged, as `mlflow server`
    sets it for its own."""
    from mlflow.server import constants

    return {
        constants.BACKEND_STORE_URI_ENV_VAR: store,
        constants.REGISTRY_STORE_URI_ENV_VAR: store,
        constants.SERVE_ARTIFACTS_ENV_VAR: "true",
        constants.ARTIFACTS_DESTINATION_ENV_VAR: artifacts,
        constants.ARTIFACT_ROOT_ENV_VAR: "mlflow-artifacts:/",
    }


def application() -> Any:
    """MLflow's pages and interface, as an ASGI application."""
    from mlflow.server.fastapi_app import app  # seconds, and a store in the environment

    return app
