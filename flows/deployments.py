"""What Prefect's pages can start besides sweeps, with typed forms; they write to MLflow and `sweeps/<name>/` alone."""

from typing import Annotated, Any

from pydantic import Field

from flows import diagnose as diagnose_flow
from flows import policy as policy_flow
from flows import provenance, train, twin
from flows import reproduce as reproduce_flow
from flows import track as track_flow
from flows.flow import flow
from flows.locks import alone
from flows.start import PARAMS
from flows.sweep import prepare
from simgap.formats.documents import read_json
from simgap.types import SimgapError
from tasks import artifacts, diagnose, forms, score, sweep
from tasks import track as track_tasks
from tasks.forms import Models, Noises, Policies, Recordings, RunName, SampleSizes, Seeds
from tasks.params import Params, load_params
from tasks.ranges import Seed
from tasks.tracking import links
from tasks.workspace import Workspace

Overrides = Annotated[dict[str, Any], Field(default_factory=dict)]


@flow(name="reproduce", flow_run_name="{name}")
def reproduce(
    name: RunName,
    recordings: Recordings,
    models: Models,
    noises: Noises,
    sample_sizes: SampleSizes,
    seeds: Seeds,
    overrides: Overrides,
) -> None:
    """Everything that `dvc repro` does: recordings, models, scores, report, policies, a twin, tracking, diagnosis.

    Args:
        name: The run's name, here and in MLflow, and its folder in sweeps/; letters, digits, dashes and underscores. A
            name that exists goes on where it stopped.
        recordings: What to learn from, and what to judge by.
        models: How to learn.
        noises: Families of the learned likelihood.
        sample_sizes: N, transitions to learn from.
        seeds: Each draws other transitions, networks and simulators.
        overrides: Anything else of params.yaml, merged in and checked as the file is; the form's
            own fields win.
    """
    root, grid = forms.folder(name), {"models": models, "noises": noises, "sample_sizes": sample_sizes, "seeds": seeds}
    policies = {"models": models, "noise": noises[-1], "sample_sizes": sample_sizes, "seeds": seeds}
    params = _params(recordings, {"train": grid, "policy": policies}, overrides)
    with alone(root, recordings.source):
        failure = None
        try:
            reproduce_flow.run.fn(recordings.source, params, root)
        except SimgapError as error:
            failure = error
        _show(Workspace(root, recordings.source))
        if failure:
            raise failure


def _show(workspace: Workspace) -> None:
    """Of a reproduction, what there is of it: scores as a table, and where things are."""
    name, own = workspace.root.name, f"tags.workspace = '{workspace.root}'"
    models, policies = provenance.store(), provenance.store(policy_flow.EXPERIMENT)
    if (workspace.scores / score.TABLE).exists():
        rows = sweep.table(sweep.rows(workspace, models), lambda row: f"[MLflow]({links.to_run(models, row.run_id)})")
        artifacts.table("reproduce-results", rows, f"Reproduction {name}, best first")
    written = {"report": workspace.reports / "report.md", "tracking": workspace.tracking / "report.md",
               "diagnosis": workspace.diagnosis / diagnose.PAGE}  # fmt: skip
    pages = {"models in MLflow": links.to_comparison(models, name, own, links.MODEL_RESULTS),
             "policies in MLflow": links.to_comparison(policies, name, own, links.POLICY_RESULTS)}  # fmt: skip
    places = {what: str(path) for what, path in written.items() if path.exists()}
    artifacts.links("reproduce-links", {**pages, **places}, f"Reproduction {name}")


@flow(name="track", flow_run_name="{name}")
def track(
    name: RunName,
    recordings: Recordings,
    policies: Policies,
    overrides: Overrides,
) -> None:
    """Learn models, in each a policy, and run the policies along an ellipse and a helix: on the virtual Spot, or on a
    twin of the recorded one.

    Args:
        name: The run's name, here and in MLflow, and its folder in sweeps/; letters, digits, dashes and underscores. A
            name that exists goes on where it stopped.
        recordings: What to learn from.
        policies: The policies to learn, and the models to learn them in.
        overrides: Anything else of params.yaml, merged in and checked as the file is; the form's
            own fields win.
    """
    root, source = forms.folder(name), recordings.source
    params = _params(recordings, policies.overrides(), overrides)
    with alone(root, source):
        prepare(source, params, root)
        train.run(source, params, root)
        policy_flow.run(source, params, root)
        twin.run(source, params, root)
        workspace, store = Workspace(root, source), provenance.store(policy_flow.EXPERIMENT)
        rows = track_flow.run(source, params, root)
        best = track_tasks.register_best(workspace, rows, policies.noise, root.name, store)
        artifacts.table("tracking-results", rows, f"Tracking {root.name}")
        places = {"the best policy in MLflow": links.to_run(store, best),
                  "compare": links.to_comparison(store, root.name, f"tags.workspace = '{root}'", links.POLICY_RESULTS),
                  "report": f"{workspace.tracking}/report.md"}  # fmt: skip
        artifacts.links("track-links", places, f"Tracking {root.name}")


@flow(name="diagnose", flow_run_name="{name}")
def diagnose_recordings(
    name: RunName,
    recordings: Annotated[str, Field(min_length=1)],
    simulator: str = "spot",
    heldout: str = "",
    baseline: str = "",
    seed: Seed = 0,
) -> None:
    """Say what a simulator leaves out of recordings.

    Args:
        name: The run's name, here and in MLflow, and its folder in sweeps/; letters, digits, dashes and underscores. A
            name that exists goes on where it stopped.
        recordings: Folder of sessions in the project, such as data/virtual/recordings/training.
        simulator: spot, or one's own as package.module:name.
        heldout: Folder of sessions to judge by; empty: some are held out.
        baseline: Folder of sessions from before the machine changed; empty: none.
        seed: Of what is drawn.
    """
    root = forms.folder(name)
    before, judges = (forms.inside(path) if path else None for path in (baseline, heldout))
    run_id = diagnose_flow.diagnose_folder.fn(forms.inside(recordings), simulator, before, judges, root, seed)
    store = provenance.store(diagnose_flow.EXPERIMENT)
    statement = read_json(root / diagnose.STATEMENT)["statement"]
    same = f"params.recordings = '{recordings}'"
    places = {"MLflow": links.to_run(store, run_id), "page": str(root / diagnose.PAGE),
              "diagnoses of these recordings": links.to_comparison(store, root.name, same, links.DIAGNOSIS_RESULTS),
              }  # fmt: skip
    artifacts.links("diagnosis-links", places, statement)


def _params(recordings: Recordings, form: dict[str, Any], overrides: dict[str, Any]) -> Params:
    """params.yaml with the form's values in it; recordings lie in the project."""
    params = load_params(PARAMS, overrides, recordings.overrides(load_params(PARAMS, overrides)), form)
    forms.check_source(params, recordings.source)
    return params
