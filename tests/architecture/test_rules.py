"""Rules of the design that no linter knows."""

import ast
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
PACKAGES = ("simgap", "tasks", "flows")
DOORS = {
    "mlflow": {f"tasks/tracking/{name}.py" for name in ("links", "models", "runs", "store")},
    "matplotlib": {
        "tasks/plots.py",
        "simgap/page/check_figures.py",
        "simgap/page/drawings.py",
        "simgap/page/svg.py",
        "tasks/track_plots.py",
        "tasks/sealed/figures.py",
    },
    "jinja2": {"simgap/page/render.py"},
    "yaml": {"simgap/formats/yaml_files.py"},
    "mcap": {"simgap/formats/bag_messages.py"},
    "rosbags": {"simgap/formats/bag_messages.py"},
    "mujoco": {
        *(f"simgap/simulators/mujoco/{name}.py" for name in ("attributes", "build", "changing", "engine", "machine")),
        *(f"simgap/simulators/mujoco/{name}.py" for name in ("patch", "payloads", "reading", "ready", "servo_errors")),
        *(f"simgap/simulators/mujoco/{name}.py" for name in ("floating", "split", "steps", "terms")),
        "tasks/sealed/sysid.py",  # another method, to compare with
    },
}


DIAGNOSIS = ("simgap/diagnosis", "simgap/effects", "simgap/simulators", "simgap/layout.py")
"""What finds an effect, and must not know what makes the recordings in which effects are concealed."""
MAKERS = ("concealed", "simgap.robots")


def imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module.split(".")[0])
    return found


def modules() -> dict[str, Path]:
    return {str(p.relative_to(ROOT)): p for package in PACKAGES for p in sorted((ROOT / package).rglob("*.py"))}


@pytest.mark.parametrize("tool", DOORS)
def test_one_door_per_tool(tool: str) -> None:
    assert {name for name, path in modules().items() if tool in imports(path)} == DOORS[tool]


def test_only_commands_read_clock_directory_and_environment() -> None:
    for name, path in modules().items():
        if name.startswith(("flows/", "simgap/cli/")):
            continue
        used = imports(path) & {"time", "datetime", "dotenv"}
        assert not used, f"{name} imports {used}"
        assert not re.search(r"os\.environ|os\.getcwd|Path\.cwd", path.read_text()), name


DELETE = re.compile(r"\b(rmtree|unlink|rmdir|removedirs|os\.remove)\(")
"""Of `os`, `shutil` and paths."""
DELETING = {
    "simgap/formats/folders.py",  # asks for the workspace
    "simgap/formats/atomic.py",  # a half-written file of its own
    "tasks/tracking/store.py",  # a half-made database, of one name
    "flows/servers.py",  # files that say what runs, of fixed names
    "flows/serve.py",
}


def test_one_door_deletes() -> None:
    """It refuses what does not lie in a workspace, whoever asks."""
    assert {name for name, path in modules().items() if DELETE.search(path.read_text())} == DELETING


def stage_names(path: Path) -> list[str]:
    return list(yaml.safe_load(path.read_text())["stages"])


def test_a_stage_has_one_name_everywhere() -> None:
    stages = stage_names(ROOT / "pipelines" / "spot" / "dvc.yaml")
    assert [stage for stage in stages if stage != "twin"] == stage_names(ROOT / "dvc.yaml")
    assert list(yaml.safe_load((ROOT / "params.yaml").read_text())) == stages
    for stage in stages:
        assert (ROOT / "flows" / f"{stage}.py").exists()
        assert (ROOT / "tasks" / f"{stage}.py").exists()


def test_a_sealed_stage_has_one_name_everywhere() -> None:
    stages = stage_names(ROOT / "pipelines" / "sealed" / "dvc.yaml")
    assert stages == ["conceal", "examine", "score"]
    assert list(yaml.safe_load((ROOT / "pipelines" / "sealed" / "params.yaml").read_text())) == stages
    for stage in stages:
        assert (ROOT / "flows" / "sealed" / f"{stage}.py").exists()
        assert (ROOT / "tasks" / "sealed" / f"{stage}.py").exists()


def test_no_stage_before_the_score_depends_on_a_key() -> None:
    stages = yaml.safe_load((ROOT / "pipelines" / "sealed" / "dvc.yaml").read_text())["stages"]
    keys = "keys/${suite}"
    assert keys in [next(iter(o)) if isinstance(o, dict) else o for o in stages["conceal"]["outs"]]
    assert keys not in stages["examine"]["deps"]
    assert keys in stages["score"]["deps"]


def test_what_diagnoses_sealed_recordings_does_not_come_to_import_what_conceals() -> None:
    files, known = reached(["flows/sealed/examiner.py"])
    assert ROOT / "simgap/diagnosis/diagnose.py" in files
    assert not {name for name in known if name.split(".")[0] == "concealed"}


def test_what_conceals_imports_nothing_of_the_project() -> None:
    _, known = reached(["concealed"])
    assert not {name for name in known if name.split(".")[0] in PACKAGES}


def test_both_pipelines_are_the_same_but_for_the_source() -> None:
    """pipelines/spot/dvc.yaml is dvc.yaml with another source, run from the project's root: its policies are learnt in
    fewer steps, and run on a twin of the recorded robot."""
    ours, spots = (yaml.safe_load((ROOT / p).read_text()) for p in ("dvc.yaml", "pipelines/spot/dvc.yaml"))
    assert (ours.pop("vars"), spots.pop("vars")) == ([{"source": "virtual"}], [{"source": "spot"}])
    for stage in spots["stages"].values():
        assert stage.pop("wdir") == "../.."
    (ours_plot,), (spots_plot,) = ours.pop("plots"), spots.pop("plots")
    assert str(spots_plot).replace("../../reports/spot", "reports/virtual") == str(ours_plot)
    for pipeline, own_dep, own_param in ((ours, "simgap/robots", "recordings.virtual"),
                                         (spots, "data/external/spot", "recordings.spot")):  # fmt: skip
        pipeline["stages"]["recordings"]["deps"].remove(own_dep)
        pipeline["stages"]["recordings"]["params"].remove(own_param)
    fewer = "pipelines/spot/policies.yaml"
    track, policy, twin = spots["stages"]["track"], spots["stages"]["policy"], spots["stages"].pop("twin")
    for out in twin["outs"]:
        track["deps"].remove(next(iter(out)))
    for stage in (policy, track):
        stage["cmd"] = stage["cmd"].removesuffix(f" --overrides {fewer}")
        stage["params"].remove({fewer: None})
    track["desc"] = ours["stages"]["track"]["desc"]
    assert ours == spots


def is_covered(path: str, deps: Sequence[str]) -> bool:
    """Whether a file is a dependency, alone or by its folder."""
    return any(path == dep or path.startswith(f"{dep}/") for dep in deps)


def assert_covered(deps: Sequence[str], starts: Sequence[str], but: Sequence[str] = ()) -> None:
    """Every module of simgap and tasks that these import for their numbers is a dependency, alone or by its folder."""
    from tasks.fingerprint import modules_of

    for path in modules_of(starts):
        relative = str(path.relative_to(ROOT))
        if relative not in but:
            assert is_covered(relative, deps), relative


@pytest.mark.parametrize(("pipeline", "stage"), [("dvc.yaml", "train"), ("pipelines/diagnosed/dvc.yaml", "sweep")])
def test_a_stage_depends_on_the_code_it_runs(pipeline: str, stage: str) -> None:
    """Training, with a diagnosis."""
    deps = yaml.safe_load((ROOT / pipeline).read_text())["stages"][stage]["deps"]
    from tasks.fingerprint import AUGMENTED, DIAGNOSIS

    assert_covered(deps, (*AUGMENTED, *DIAGNOSIS))


def test_more_seeds_depend_on_the_code_they_run() -> None:
    """Training without a diagnosis, and scores."""
    deps = yaml.safe_load((ROOT / "pipelines" / "seeds" / "dvc.yaml").read_text())["stages"]["sweep"]["do"]["deps"]
    from tasks.fingerprint import TRAINING

    assert_covered(deps, (*TRAINING, "simgap.scores", "simgap.prediction"), ["simgap/simulators/__init__.py"])


def test_the_policies_depend_on_the_code_they_run() -> None:
    """Learning a policy."""
    deps = yaml.safe_load((ROOT / "dvc.yaml").read_text())["stages"]["policy"]["deps"]
    from tasks.fingerprint import POLICY

    assert_covered(deps, POLICY, ["simgap/policies/__init__.py"])


def test_the_twin_depends_on_the_code_it_runs() -> None:
    """Fitting, judging and comparing a twin."""
    deps = yaml.safe_load((ROOT / "pipelines" / "spot" / "dvc.yaml").read_text())["stages"]["twin"]["deps"]
    from tasks.fingerprint import DIAGNOSIS, TWIN

    assert_covered(deps, (*TWIN, *DIAGNOSIS), ["simgap/policies/__init__.py", "simgap/robots/__init__.py"])


def test_no_learner_knows_the_robot_that_its_policy_is_run_on() -> None:
    files, _ = reached(["simgap/policies", "simgap/learn.py"])
    assert ROOT / "simgap/policies/follow.py" in files
    assert not [path for path in files if "robots" in path.parts]


LONG = yaml.safe_load((ROOT / "pipelines" / "long_tests" / "dvc.yaml").read_text())["stages"]
"""Stages of long tests."""


def long_tests(*folders: str) -> list[Path]:
    """Files of tests in these folders that have long ones."""
    files = (path for folder in folders for path in (ROOT / folder).rglob("test_*.py"))
    return [path for path in files if path != Path(__file__) and "pytest.mark.long" in path.read_text()]


def folders_of(stage: str) -> list[str]:
    """Folders of tests that a stage runs."""
    return [word for word in LONG[stage]["cmd"].split() if word.startswith("tests/")]


@pytest.mark.parametrize("stage", LONG)
def test_long_tests_are_run_again_when_what_they_import_changes(stage: str) -> None:
    files, _ = reached([str(path.relative_to(ROOT)) for path in long_tests(*folders_of(stage))])
    assert files
    for path in files:
        assert is_covered(str(path.relative_to(ROOT)), LONG[stage]["deps"]), path


def test_every_long_test_is_of_one_of_the_stages() -> None:
    assert set(long_tests("tests")) == {path for stage in LONG for path in long_tests(*folders_of(stage))}


def imported(path: Path) -> set[str]:
    """Dotted names of all that a module imports, of the packages above it, and of names taken from modules."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            parent = path.relative_to(ROOT).parts[: -node.level] if node.level else ()
            module = ".".join([*parent, *([node.module] if node.module else [])])
            found |= {module, *(f"{module}.{alias.name}" for alias in node.names)}
    return {".".join(name.split(".")[:k]) for name in found for k in range(1, name.count(".") + 2)}


def reached(names: Iterable[str]) -> tuple[set[Path], set[str]]:
    """The project's files that these files or folders come to import, themselves included; and all imported names.

    Not followed is what `simgap` imports when it is asked for a public name: no module of the project asks.
    """
    queue = [p for name in names for p in ([ROOT / name] if name.endswith(".py") else (ROOT / name).rglob("*.py"))]
    files, known = set(), set()
    while queue:
        path = queue.pop()
        if path not in files and path.is_file() and path != ROOT / "simgap/__init__.py":
            files.add(path)
            known |= (new := imported(path))
            queue += [ROOT.joinpath(*n.split(".")).with_suffix(".py") for n in new]
            queue += [ROOT.joinpath(*n.split("."), "__init__.py") for n in new]
    return files, known


def test_the_diagnosis_knows_nothing_of_what_makes_its_recordings() -> None:
    files, known = reached(DIAGNOSIS)
    assert {ROOT / "simgap/simulators/spot.py", ROOT / "simgap/types.py"} <= files
    found = {name for name in known if name in MAKERS or name.startswith(tuple(f"{m}." for m in MAKERS))}
    assert not found
    for path in files:
        assert not re.search(r"importlib|__import__", path.read_text()), f"{path} imports by a name given as text"


def test_the_diagnosis_depends_on_the_numerics_it_runs() -> None:
    """Every module of simgap that it comes to import is a dependency of its DVC stage."""
    deps = yaml.safe_load((ROOT / "dvc.yaml").read_text())["stages"]["diagnose"]["deps"]
    # What things are called is none.
    for path in reached(DIAGNOSIS)[0] - {ROOT / "simgap/types.py"}:
        relative = str(path.relative_to(ROOT))
        assert any(relative == d or relative.startswith(f"{d}/") for d in deps), relative


def test_nothing_committed_names_a_registry_or_a_machine() -> None:
    hosts = re.compile(r"(pypi\.org|pythonhosted\.org|npmjs|/opt/pypi|/work/|/root/)")
    for name in ("requirements.lock", "pyproject.toml", "Makefile", "README.md", ".ci/run", "dvc.yaml", "params.yaml"):
        found = hosts.search((ROOT / name).read_text())
        assert found is None, f"{name} names {found}"
