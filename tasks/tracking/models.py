"""Models of a run, which `mlflow.pyfunc.load_model` loads by the URI `models:/<id>` or `runs:/<run id>/model`."""

import tempfile
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import mlflow.pyfunc
import numpy as np
import pandas as pd
from mlflow.entities import LoggedModelOutput
from mlflow.models import Model, ModelSignature
from mlflow.types import ColSpec, Schema

from simgap.simulators.spot import SCHEMA
from simgap.types import Schema as RobotSchema
from tasks import augmented_pyfunc, history, policy_pyfunc, pyfunc
from tasks.tracking.runs import Run

MODEL = "model"
"""Name of a run's model: `mlflow.pyfunc.load_model("runs:/<run id>/model")`."""
# The project itself is left out: it is on no index, and the name may come to be another's there.
_REQUIREMENTS = [f"{name}=={version(name)}" for name in ("mlflow", "jax", "jaxtyping", "numpy", "scipy", "pandas")]


class _Pyfunc(NamedTuple):
    """A file and the module that loads it, with its configuration; a table that may go in, and what comes out."""

    loader: str
    data: Path
    config: Mapping[str, Any]
    example: pd.DataFrame
    outputs: Sequence[str]


def log_model(run: Run, model_path: Path) -> str:
    """Log a file of `save_model`; returns its URI.

    A session's table goes in, one of `mean_<output>` and `std_<output>` comes out; see `tasks.pyfunc`.
    """
    return _log(run, _Pyfunc(pyfunc.__name__, model_path, {}, history.example(SCHEMA), pyfunc.output_columns()))


def log_policy(run: Run, policy_path: Path, columns_in: Sequence[str], columns_out: Sequence[str]) -> str:
    """Log a file of `save_policy`, a model from `columns_in` to `columns_out`; returns its URI.

    See `tasks.policy_pyfunc`.
    """
    config = policy_pyfunc.Columns(inputs=[*columns_in], outputs=[*columns_out])
    example = pd.DataFrame(np.zeros((1, len(columns_in))), columns=list(columns_in))
    return _log(run, _Pyfunc(policy_pyfunc.__name__, policy_path, config, example, columns_out))


def log_simulator(run: Run, path: Path, name: str, schema: RobotSchema) -> str:
    """Log the constants of a diagnosed simulator called `name`; returns its URI. See `tasks.augmented_pyfunc`."""
    config, outputs = augmented_pyfunc.Origin(simulator=name), augmented_pyfunc.output_columns(schema)
    return _log(run, _Pyfunc(augmented_pyfunc.__name__, path, config, history.example(schema), outputs))


def _log(run: Run, of: _Pyfunc) -> str:
    # MLflow's own `log_model` writes to the global tracking URI; these are its steps, with the store named.
    client = run.store.client
    logged = client.create_logged_model(
        run.store.experiment_id, MODEL, run.run_id, params=client.get_run(run.run_id).data.params
    )
    with tempfile.TemporaryDirectory() as scratch:
        mlflow.pyfunc.save_model(
            Path(scratch) / MODEL,
            loader_module=of.loader,
            data_path=of.data,
            model_config=dict(of.config) or None,
            mlflow_model=Model(logged.artifact_location, run.run_id, model_id=logged.model_id),
            signature=ModelSignature(_numbers(list(of.example)), _numbers(of.outputs)),
            input_example=of.example,
            pip_requirements=_REQUIREMENTS,
        )
        client.log_model_artifacts(logged.model_id, str(Path(scratch) / MODEL))
    client.finalize_logged_model(logged.model_id, "READY")
    client.log_outputs(run.run_id, [LoggedModelOutput(logged.model_id, step=0)])
    return f"models:/{logged.model_id}"


def _numbers(columns: Sequence[str]) -> Schema:
    return Schema([ColSpec("double", name) for name in columns])
