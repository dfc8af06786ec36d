"""What the docs name exists."""

import importlib
import importlib.util
import re
import shlex
import subprocess
import sys
from pathlib import Path

import yaml

from flows import deployments, sweep
from simgap.cli.main import parser
from simgap.effects import table
from tasks.params import load_params

ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").glob("*.md")),
    ROOT / "benchmarks/README.md",
]


def test_every_function_in_the_table_of_equations_exists() -> None:
    names = re.findall(r"\| `(simgap\.[\w.]+)` \|", (ROOT / "docs" / "equations.md").read_text())
    assert len(names) > 15
    for name in names:
        module, function = name.rsplit(".", 1)
        assert callable(getattr(importlib.import_module(module), function)), name


def test_every_paper_tag_has_one_form() -> None:
    for path in (ROOT / "simgap").rglob("*.py"):
        for tag in re.findall(r"\[[^\]]*Hoffman[^\]]*\]", path.read_text()):
            assert re.fullmatch(r"\[Hoffman et al\. 2025, [^\]]+\]", " ".join(tag.split())), f"{path}: {tag}"


def test_the_vocabulary_in_the_docs_is_the_catalogue() -> None:
    """Print it anew: python -m simgap.effects.table > docs/effects.md"""
    assert (ROOT / "docs" / "effects.md").read_text() == table.page()


def test_make_targets_of_the_readme_exist() -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = {target for page in PAGES for target in re.findall(r"`make ([a-z]+)", page.read_text())}
    assert named
    assert named <= targets


def test_links_of_the_docs_lead_somewhere() -> None:
    """To files, and to headings in them."""
    for path in PAGES:
        for link in re.findall(r"\]\((?!http)([^)]+)\)", path.read_text()):
            name, _, heading = link.partition("#")
            target = path.parent / name if name else path
            assert target.exists(), f"{path.name}: {link}"
            if heading:
                titles = re.findall(r"^#+ (.*)$", target.read_text(), re.MULTILINE)
                anchors = {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}
                assert heading in anchors, f"{path.name}: {link}"


COVERED = {
    r"make run( SOURCE=spot RECORDINGS=path/to/folder)?": ("flows/test_pipeline.py", '"flows.reproduce", "virtual"'),
    r"make test": ("conftest.py", "PREFECT_HOME"),  # what runs this
    r"make (up|down)": ("flows/test_operate.py", '"flows.servers", "up"'),
    r"dvc repro": ("flows/test_dvc.py", 'run("dvc", "repro")'),
    r"dvc repro spot/dvc\.yaml": ("flows/test_dvc.py", '"dvc", "stage", "list", "spot/dvc.yaml"'),
    r"dvc repro sealed/dvc\.yaml": ("flows/test_dvc.py", '"dvc", "stage", "list", "sealed/dvc.yaml"'),
    r"python -m flows\.sealed\.\w+ examination": ("sealed/test_sealed_suite.py", "conceal.run"),
    r"dvc exp (run|show).*": ("flows/test_dvc.py", '"dvc", "exp", "run"'),
    r"dvc metrics diff": ("flows/test_dvc.py", '"dvc", "metrics", "diff"'),
    r"prefect deployment run sweep/.*": ("flows/test_operate.py", '"prefect", "deployment", "run", "sweep/'),
    r"(SIMGAP_CLUSTER=.* )?python -m flows\.sweep .*": ("flows/test_dvc.py", '"flows.sweep", "--name"'),
    r"simgap diagnose .*": ("simgap/cli/test_diagnose_command.py", '"diagnose", "rail"'),
    r"simgap (import|check) .*": ("simgap/formats/test_importing.py", '["import", "walk.mcap"'),
    r"python -m examples\.record .*": ("examples/test_examples.py", "examples.record"),
    r"python -m examples\.knockouts .*": ("examples/test_examples.py", '"examples.knockouts"'),
    r"python -m flows\.(policy|track) virtual": ("flows/test_dvc.py", 'run("dvc", "repro")'),
    r"pip install simgap": ("simgap/test_wheel.py", '"pip", "install"'),
    r"python -m benchmarks\..*": ("architecture/test_docs.py", "test_the_benchmarks_are_there"),
    r"SIMGAP_CLUSTER=.*": ("flows/test_cluster.py", "SIMGAP_CLUSTER"),
    r"SIMGAP_PICTURES=.*": ("flows/test_operate.py", "SIMGAP_PICTURES"),
    # Of the shell alone, and a batch file that needs a cluster, which says so.
    r"\. \.venv/bin/activate|mkdir .*|export .*|srun .*|until .*|cd .*": ("", ""),
}
"""Commands of the docs, and where a test runs each: a file of tests, and what in it does."""


def commands() -> list[tuple[str, str]]:
    """(page, command) of every block without a language or in a shell's."""
    found = []
    for path in PAGES:
        for language, block in re.findall(r"^```(\w*)\n(.*?)^```$", path.read_text(), re.MULTILINE | re.DOTALL):
            lines = re.sub(r"\\\n\s*", "", block).splitlines()
            for line in lines if language in ("", "bash") else []:
                command = re.split(r"\s{2,}#|^#", line)[0].strip()
                if command:
                    found.append((path.name, command))
    return found


def test_every_command_of_the_docs_is_run_by_a_test() -> None:
    assert len(commands()) > 30
    for page, command in commands():
        where = [place for pattern, place in COVERED.items() if re.fullmatch(pattern, command)]
        assert where, f"{page}: {command}"
        file, text = where[0]
        assert not file or text in (ROOT / "tests" / file).read_text(), f"{page}: {command}"


def test_every_simgap_command_of_the_docs_is_understood() -> None:
    for page, command in commands():
        for part in re.findall(r"(?:^|\s)simgap (.*)", command):
            try:
                parser().parse_args(shlex.split(part, comments=True))
            except SystemExit:
                raise AssertionError(f"{page}: {command}") from None


def test_the_source_of_the_docs_is_one_of_params_yaml() -> None:
    (block,) = re.findall(r"```yaml\n(recordings:.*?)```", (ROOT / "docs/recordings.md").read_text(), re.DOTALL)
    assert load_params(ROOT / "params.yaml", yaml.safe_load(block)).source("mine")


def test_the_benchmarks_are_there() -> None:
    for _, command in commands():
        for module in re.findall(r"python -m (benchmarks\.\w+)", command):
            assert importlib.util.find_spec(module)


def test_the_flows_of_the_deployments_have_a_description() -> None:
    for flow in (sweep.run, deployments.reproduce, deployments.track, deployments.diagnose_recordings):
        described = flow.parameters.properties
        assert described
        assert all(entry.get("description") or "$ref" in entry for entry in described.values()), flow.name


def test_the_batch_file_for_slurm_is_bash() -> None:
    (script,) = re.findall(r"```bash\n(#!/bin/bash\n.*?)```", (ROOT / "docs" / "scaling.md").read_text(), re.DOTALL)
    done = subprocess.run(["bash", "-n"], input=script, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_parts_for_kubernetes_fit_together() -> None:
    """No cluster has run them: they are read, and what refers to another part finds it."""
    parts = list(yaml.safe_load_all((ROOT / "examples" / "kubernetes.yaml").read_text()))
    named = {(part["kind"], part["metadata"]["name"]): part for part in parts}
    assert len(named) == len(parts)
    pods = [part["spec"]["template"] for part in parts if "template" in part.get("spec", {})]
    labels = [pod["metadata"]["labels"] for pod in pods if "metadata" in pod]
    for part in parts:
        if part["kind"] == "Deployment":
            assert part["spec"]["selector"]["matchLabels"] == part["spec"]["template"]["metadata"]["labels"]
        if part["kind"] == "Service":
            assert part["spec"]["selector"] in labels
            assert part["metadata"]["name"] == part["spec"]["selector"]["app"]
    for pod in pods:
        claims = {v["name"]: v["persistentVolumeClaim"]["claimName"] for v in pod["spec"]["volumes"]}
        assert all(("PersistentVolumeClaim", claim) in named for claim in claims.values())
        for container in pod["spec"]["containers"]:
            assert {mount["name"] for mount in container["volumeMounts"]} <= set(claims)
            assert all(("ConfigMap", e["configMapRef"]["name"]) in named for e in container.get("envFrom", []))
            assert all(isinstance(word, str) for word in container["command"])
            program = container["command"][0].removeprefix(".venv/bin/")
            assert (Path(sys.executable).parent / program).exists(), program
    served = {part["metadata"]["name"]: part["spec"]["ports"][0]["port"] for part in parts if part["kind"] == "Service"}
    addresses = re.findall(r"\w+://([a-z-]+):(\d+)", " ".join(named["ConfigMap", "simgap"]["data"].values()))
    assert {name: int(port) for name, port in addresses} == served
