"""Every command and every piece of Python in the docs is run by a test that is named here: a new one fails without."""

import importlib.util
import re
import shlex
from pathlib import Path

from simgap.cli.main import parser

ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    ROOT / "benchmarks/README.md",
]
SHELL = r"\. \.venv/bin/activate|mkdir .*|export .*|srun .*|until .*|cd .*"
"""Of the shell alone, and a batch file that needs a cluster, which says so."""
REPRO = "flows/test_dvc.py::test_repro_makes_everything_once"
README = "examples/test_readme.py::test_the_readmes_diagnosis"
COVERED = {
    r"make run( SOURCE=spot RECORDINGS=path/to/folder)?": ("flows/test_pipeline.py::test_a_run_ends", '"flows.rep'),
    r"make (test|setup)": ("conftest.py::prefect_server", "PREFECT_HOME"),  # what runs this
    r"make docs": ("architecture/test_site.py::test_the_site", '"build", "--strict"'),
    r"make (up|down)": ("flows/test_operate.py::test_down_stops_all", '"flows.servers", "up"'),
    r"dvc repro": (REPRO, 'run("dvc", "repro")'),
    r"python -m flows\.(policy|track) virtual": (REPRO, 'run("dvc", "repro")'),  # its stages
    r"python -m flows\.twin spot": ("flows/test_twin_stage.py::test_a_twin_is_scored", 'stage.run("mine"'),
    r"dvc repro pipelines/spot/dvc\.yaml.*": (
        "flows/test_dvc.py::test_the_real_spots_pipeline", '"list", "pipelines/spot/dvc.yaml"'),
    r"dvc repro pipelines/sealed/dvc\.yaml": (
        "flows/test_dvc.py::test_the_proofs_pipeline", '"list", "pipelines/sealed/dvc.yaml"'),
    r"dvc repro pipelines/external/dvc\.yaml": (
        "flows/test_dvc.py::test_pipelines_beside_them", '"list", "pipelines/external/dvc.yaml"'),
    r"dvc repro pipelines/ground/dvc\.yaml": (
        "flows/test_dvc.py::test_pipelines_beside_them", '"list", "pipelines/ground/dvc.yaml"'),
    r"dvc (metrics|plots) show": ("flows/test_dvc.py::test_the_metrics_of_the_repository", '"metrics", "show"'),
    r"dvc metrics diff": (REPRO, '"dvc", "metrics", "diff"'),
    r"dvc exp (run|show).*": ("flows/test_dvc.py::test_an_experiment", '"dvc", "exp", "run"'),
    r"dvc (remote add|push|pull).*": ("flows/test_dvc.py::test_a_remote", '"dvc", "remote", "add"'),
    r"python -m flows\.sealed\.\w+ examination": (
        "sealed/test_sealed_suite.py::test_an_examinations", 'score.run.fn("examination"'),
    r"python -m flows\.sealed\.\w+ arm.*": (
        "sealed/test_sealed_arms.py::test_a_case_is_diagnosed", 'examine.run("arm"'),
    r"python -m flows\.sealed\.\w+ kinds": (
        "sealed/test_sealed_kinds.py::test_a_machine_is_diagnosed", 'examine.run.fn("kinds"'),
    r"python -m flows\.sealed\.\w+ ties.*": (
        "sealed/test_sealed_ties.py::test_a_tie_is_diagnosed", 'examine.run("ties"'),
    r"prefect deployment run sweep/.*": (
        "flows/test_operate.py::test_cancelling", '"prefect", "deployment", "run", "sweep/'),
    r"(SIMGAP_CLUSTER=.* )?python -m flows\.sweep .*": (REPRO, '"flows.sweep", "--name"'),
    r"SIMGAP_CLUSTER=.* dvc repro": ("flows/test_cluster.py::test_a_killed_worker", '"SIMGAP_CLUSTER"'),
    r"SIMGAP_PICTURES=.*": ("examples/test_readme.py::test_the_readmes_picture", "SIMGAP_PICTURES"),
    r"python -m examples\.record drive sweeps/drive": (README, "commands"),
    r"simgap diagnose sweeps/drive .*": (README, "commands"),
    r"python -m examples\.record car .*": ("examples/test_examples.py::test_the_command", '"examples.record"'),
    r"python -m examples\.knockouts .*": ("examples/test_examples.py::test_the_command_line_w", '"examples.knock'),
    r"(python -m examples\.record arm|simgap diagnose) sweeps/arm( --simulator .*)?": (
        "simgap/cli/test_diagnose_model.py::test_the_commands_write", "run(folder, "),
    r"python -m examples\.record (arm|drone) .*": (
        "examples/test_recorded_models.py::test_the_command", "examples.record"),
    r"simgap diagnose .*": ("simgap/cli/test_diagnose_command.py::test_the_statement", '"diagnose", "rail"'),
    r"simgap (import|check) .*": (
        "simgap/formats/test_importing.py::test_the_commands_are_there", '["import", "walk.mcap"'),
    r"python -m simgap\.effects\.table > docs/reference/effects\.md": (
        "architecture/test_docs.py::test_the_vocabulary", "table.page()"),
    r"python -m tasks\.params_table > docs/reference/parameters\.md": (
        "architecture/test_docs.py::test_the_parameters", "params_table.page("),
    r"pip install simgap": ("simgap/test_wheel.py::test_a_diagnosis_runs", '"pip", "install"'),
    r"python -m benchmarks\..*": ("architecture/test_commands.py::test_the_benchmarks", "find_spec("),
    # Python, by the first line of a block
    r">>> (import simgap|robot = simgap\.load.*)": ("simgap/test_api.py::test_the_pages_about_it_work", "exec(block"),
    r">>> import mlflow": ("flows/test_operate.py::test_the_best_model", "exec(lines"),
    r">>> from (pathlib import Path|scipy.spatial.transform import Rotation)": (
        "simgap/simulators/mujoco/test_mujoco_docs.py::test_the_code", "exec(compile"),
    r">>> import jax\.numpy as jnp": ("examples/test_examples.py::test_the_pages_example", "exec(printed()"),
    r">>> policy = mlflow\.pyfunc\.load_model.*": ("flows/test_pipeline.py::test_policies_are_learnt", "load_model"),
}  # fmt: skip
"""Commands of the docs, and where a test runs each: a file of tests, how the test's name begins, and what in the file
does it."""


def commands() -> list[tuple[str, str]]:
    """(page, command) of every block without a language or in a shell's; of Python `>>>` and the first line."""
    found = []
    block = re.compile(r"^( *)```(\w*)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)
    for path in PAGES:
        for _, language, text in block.findall(path.read_text()):
            lines = re.sub(r"\\\n\s*", "", text).splitlines()
            if language == "python":
                found.append((path.name, f">>> {lines[0].split('  #')[0]}"))
            for line in lines if language in ("", "bash") else []:
                command = re.split(r"\s{2,}#|^#", line)[0].strip()
                if command and not re.fullmatch(SHELL, command):
                    found.append((path.name, command))
    return found


def test_every_command_of_the_docs_is_run_by_a_test() -> None:
    assert len(commands()) > 40
    for page, command in commands():
        where = [place for pattern, place in COVERED.items() if re.fullmatch(pattern, command)]
        assert where, f"{page}: name the test that runs {command}"
        (test, does), source = where[0], ""
        file, name = test.split("::")
        source = (ROOT / "tests" / file).read_text()
        assert f"\ndef {name}" in source, f"{page}: {command}: {test} is gone"
        assert does in source, f"{page}: {command}: {test} does not run it"


def test_no_command_is_listed_that_the_docs_have_not() -> None:
    for pattern in COVERED:
        assert any(re.fullmatch(pattern, command) for _, command in commands()), pattern


def test_every_simgap_command_of_the_docs_is_understood() -> None:
    for page, command in commands():
        for part in re.findall(r"(?:^|\s)simgap (.*)", command):
            try:
                parser().parse_args(shlex.split(part, comments=True))
            except SystemExit:
                raise AssertionError(f"{page}: {command}") from None


def test_the_benchmarks_are_there() -> None:
    for _, command in commands():
        for module in re.findall(r"python -m (benchmarks\.\w+)", command):
            assert importlib.util.find_spec(module)


def test_make_targets_of_the_docs_exist() -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = {target for page in PAGES for target in re.findall(r"`make ([a-z]+)", page.read_text())}
    assert named
    assert named <= targets
