"""Stage `examine`: every case diagnosed by a process that cannot open a key; resumable case by case."""

import json
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from prefect import task

from simgap.formats.documents import read_json, write_json
from simgap.formats.folders import remove_folder
from simgap.types import Report, SimgapError
from tasks.files.digests import digest_of
from tasks.params_sealed import ExamineParams
from tasks.sealed.workspace import SIMULATOR, SealedWorkspace

Job = Callable[[str, int], AbstractContextManager[Report]]
EXAMINER = "flows.sealed.examiner"
"""The module that diagnoses: reads `{"case", "out", "seed"}` a line, answers a line."""


def chosen(manifest: dict[str, Any], params: ExamineParams) -> list[str]:
    """Names of the cases in the parts that are asked for."""
    parts: Sequence[Sequence[str]] = manifest["parts"]
    unknown = [p for p in params.parts if p >= len(parts)]
    if unknown:
        raise SimgapError(f"examine.parts: the suite has the parts 0 to {len(parts) - 1}, not {unknown}.")
    return [name for p in params.parts or range(len(parts)) for name in parts[p]]


def fingerprint(workspace: SealedWorkspace, case: str, seed: int, code: str) -> str:
    """Identifies what a diagnosis depends on: recordings, model or simulator, the seed and the diagnosing code."""
    files = sorted(path for path in workspace.case(case).rglob("*") if path.is_file())
    if not files:
        raise SimgapError(f"{workspace.case(case)}: there are no recordings of this case. Run the stage `conceal`.")
    named = workspace.case(case) / SIMULATOR
    source = find_spec(named.read_text().partition(":")[0]) if named.exists() else None
    by = digest_of([Path(source.origin)])[:8] if source and source.origin else ""
    recorded = f"{digest_of(files)}{by}"
    return f"{code[:16]}-{recorded}-{seed}"


def code_of(mark: str) -> str:
    """Start of the digest of the code in a case's fingerprint."""
    return mark.partition("-")[0]


def finished(workspace: SealedWorkspace, case: str, mark: str) -> bool:
    """Whether the case was diagnosed with the same code; one that failed or left no whole files is tried again."""
    record = _whole(workspace.record(case)) or {}
    return (
        record.get("fingerprint") == mark
        and record.get("error") is None
        and _whole(workspace.statement(case)) is not None
    )


def _whole(path: Path) -> dict[str, Any] | None:
    """What a record or a statement holds; None where there is none, or a damaged one."""
    try:
        found = read_json(path)
    except SimgapError:
        return None
    return found if isinstance(found, dict) else None


class Examiner:
    """A process that diagnoses one case after the other, so that what it compiles serves all of them."""

    def __init__(self, keys: Path, patience_s: float) -> None:
        self._keys, self._patience = keys, patience_s
        self._process: subprocess.Popen[str] | None = None

    def diagnose(self, case: Path, out: Path, seed: int) -> dict[str, Any]:
        """Seconds, or why it failed: a case that kills its process, or takes too long, loses no other."""
        process = self._process = self._process if self._process and self._process.poll() is None else self._start()
        assert process.stdin is not None
        assert process.stdout is not None
        late = threading.Timer(self._patience, process.kill)
        late.start()
        try:
            process.stdin.write(json.dumps({"case": str(case), "out": str(out), "seed": seed}) + "\n")
            process.stdin.flush()
            # Libraries may write lines of their own.
            answer = next((line for line in process.stdout if line.startswith("{")), "")
        except OSError as error:
            answer = json.dumps({"error": f"the process ended: {error}"})
        finally:
            late.cancel()
        if not answer:
            status = process.wait()
            return {"error": f"the process ended with status {status}, or took more than {self._patience:.0f} s"}
        return json.loads(answer)

    def _start(self) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", EXAMINER, str(self._keys)]
        return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def close(self) -> None:
        if self._process is not None:
            with suppress(OSError):
                assert self._process.stdin is not None
                self._process.stdin.close()
            self._process.wait()


@task(task_run_name="examine-{case}")
def examine_case(
    workspace: SealedWorkspace, case: str, idle: queue.Queue[Examiner], marks: dict[str, str], seed: int, job: Job
) -> str | None:
    """Diagnose one case with the next idle process and keep a record of it; returns why it failed, if it did."""
    remove_folder(workspace.examination(case), workspace.root)
    examiner = idle.get()
    try:
        with job(case, 1):
            answer = examiner.diagnose(workspace.case(case), workspace.statement(case), seed)
    finally:
        idle.put(examiner)
    error = answer.get("error")
    record = {"fingerprint": marks[case], "seconds": answer.get("seconds"), "error": error}
    write_json(workspace.record(case), record)
    return error


def remove_stale(workspace: SealedWorkspace, marks: dict[str, str]) -> list[str]:
    """Forget cases that the suite does not have, or had with other recordings or other code, and those of which a file
    is damaged; returns the names of the damaged ones."""
    damaged = []
    if workspace.examinations.exists():
        for folder in sorted(p for p in workspace.examinations.iterdir() if p.is_dir()):
            if folder.name in marks:
                paths = (workspace.record(folder.name), workspace.statement(folder.name))
                if any(path.exists() and _whole(path) is None for path in paths):
                    damaged.append(folder.name)
                elif (_whole(paths[0]) or {}).get("fingerprint") == marks[folder.name]:
                    continue
            remove_folder(folder, workspace.root)
    return damaged
