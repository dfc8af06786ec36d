"""Keeps what became of every test: a plugin for those that are too long for `make test` to repeat each time."""

import csv
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

COLUMNS = ("test", "outcome", "processor_s")


def processor_seconds() -> float:
    """Of this process and of those that it started and that have ended."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--record", type=Path, required=True, help="table of tests, outcomes and processor seconds")


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):  # reports of all workers come together in the process that started them
        config.pluginmanager.register(Record(config.getoption("record")))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    item.user_properties.append(("began_s", processor_seconds()))
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item) -> Iterator[None]:
    began = dict(item.user_properties)["began_s"]
    item.user_properties.append(("processor_s", processor_seconds() - float(str(began))))
    return (yield)


class Record:
    """Rows of tests, in the order of their names, written when all have ended."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.outcomes: dict[str, str] = {}
        self.seconds: dict[str, float] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call" or report.outcome != "passed":  # a fixture may fail or skip before, or fail after it
            self.outcomes[report.nodeid] = report.outcome
        if report.when == "teardown":
            self.seconds[report.nodeid] = float(str(dict(report.user_properties)["processor_s"]))

    def pytest_sessionfinish(self) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("w", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(COLUMNS)
            for test, outcome in sorted(self.outcomes.items()):
                table.writerow([test, outcome, round(self.seconds.get(test, 0.0))])
