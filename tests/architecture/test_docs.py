"""What the docs name exists."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import yaml
from test_commands import PAGES

from flows import deployments, sweep
from simgap.effects import table
from tasks import params_table
from tasks.params import load_params

ROOT = Path(__file__).parents[2]


def test_every_function_in_the_table_of_equations_exists() -> None:
    names = re.findall(r"\| `(simgap\.[\w.]+)` \|", (ROOT / "docs" / "reference" / "equations.md").read_text())
    assert len(names) > 15
    for name in names:
        module, function = name.rsplit(".", 1)
        assert callable(getattr(importlib.import_module(module), function)), name


def test_every_paper_tag_has_one_form() -> None:
    for path in (ROOT / "simgap").rglob("*.py"):
        for tag in re.findall(r"\[[^\]]*Hoffman[^\]]*\]", path.read_text()):
            assert re.fullmatch(r"\[Hoffman et al\. 2025, [^\]]+\]", " ".join(tag.split())), f"{path}: {tag}"


def test_the_vocabulary_in_the_docs_is_the_catalogue() -> None:
    """Print it anew: python -m simgap.effects.table > docs/reference/effects.md"""
    assert (ROOT / "docs" / "reference" / "effects.md").read_text() == table.page()


def test_the_parameters_in_the_docs_are_those_of_the_files() -> None:
    """Print it anew: python -m tasks.params_table > docs/reference/parameters.md"""
    page = (ROOT / "docs" / "reference" / "parameters.md").read_text()
    assert page == params_table.page(ROOT)
    assert "|  |\n" not in page, "a parameter has no meaning: say it in a comment of the file or in its type"


def test_links_of_the_docs_lead_somewhere() -> None:
    """To files, and to headings in them."""
    for path in PAGES:
        for link in re.findall(r"\]\((?!http)([^)]+)\)", path.read_text()):
            name, _, heading = link.partition("#")
            target = path.parent / name if name else path
            assert target.exists(), f"{path.relative_to(ROOT)}: {link}"
            if heading:
                titles = re.findall(r"^#+ (.*)$", target.read_text(), re.MULTILINE)
                anchors = {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}
                assert heading in anchors, f"{path.name}: {link}"


def test_the_source_of_the_docs_is_one_of_params_yaml() -> None:
    (block,) = re.findall(
        r"```yaml\n(recordings:.*?)```", (ROOT / "docs/reference/recordings.md").read_text(), re.DOTALL
    )
    assert load_params(ROOT / "params.yaml", yaml.safe_load(block)).source("mine")


def test_the_flows_of_the_deployments_have_a_description() -> None:
    for flow in (sweep.run, deployments.reproduce, deployments.track, deployments.diagnose_recordings):
        described = flow.parameters.properties
        assert described
        assert all(entry.get("description") or "$ref" in entry for entry in described.values()), flow.name


def test_the_batch_file_for_slurm_is_bash() -> None:
    (script,) = re.findall(
        r"```bash\n(#!/bin/bash\n.*?)```", (ROOT / "docs" / "how_to" / "more_machines.md").read_text(), re.DOTALL
    )
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
