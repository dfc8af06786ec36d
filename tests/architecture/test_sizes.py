"""Limits on the size of files and functions, and on the number of arguments."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDERS = ("concealed", "simgap", "tasks", "flows", "benchmarks", "examples")
FILE_LINES = 250
FUNCTION_LINES = 60
ARGUMENTS = 6
"""Of a function, but for `self`, `cls` and a form's name of the run. A config object or a NamedTuple takes the rest."""

# Functions of the numerics with seven to nine arguments, the symbols of their equations. To be bundled.
BEING_REBUILT = ("simgap/effects/step.py",)
# Trained models and policies carry a digest of these files: an edit would discard hours of training.
TRAINED_WITH = (
    "simgap/fsvgd.py",
    "simgap/identify.py",
    "simgap/learn.py",
    "simgap/policies/learn.py",
)


def offences(name: str, text: str) -> Iterator[str]:
    """What in a file exceeds a limit: file, line, what, how much, limit."""
    lines = len(text.splitlines())
    if lines > FILE_LINES:
        yield f"{name}:1: the file has {lines} lines; the limit is {FILE_LINES}"
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        where = f"{name}:{node.lineno}: {node.name} has"
        lines = (node.end_lineno or node.lineno) - node.lineno + 1
        if lines > FUNCTION_LINES:
            yield f"{where} {lines} lines; the limit is {FUNCTION_LINES}"
        arguments = count_arguments(node.args)
        if arguments > ARGUMENTS:
            yield f"{where} {arguments} arguments; the limit is {ARGUMENTS}"


def count_arguments(arguments: ast.arguments) -> int:
    """Arguments of a function: `*args` and `**kwargs` count as one each, `self`, `cls` and a run's name as none."""
    positional = [*arguments.posonlyargs, *arguments.args]
    if positional and (positional[0].arg in ("self", "cls") or is_run_name(positional[0])):
        del positional[0]
    return len(positional) + len(arguments.kwonlyargs) + sum(a is not None for a in (arguments.vararg, arguments.kwarg))


def is_run_name(argument: ast.arg) -> bool:
    """Whether it is the field of a form that names the run: a bundle with it would nest every other field."""
    return isinstance(argument.annotation, ast.Name) and argument.annotation.id == "RunName"


def found() -> dict[str, list[str]]:
    """The offences of every file that has any."""
    paths = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]
    assert len(paths) > 100
    names = {path.relative_to(ROOT).as_posix(): path for path in paths}
    every = {name: list(offences(name, path.read_text())) for name, path in names.items()}
    return {name: those for name, those in every.items() if those}


def is_exempt(name: str) -> bool:
    return any(name == exempt or name.startswith(f"{exempt}/") for exempt in (*BEING_REBUILT, *TRAINED_WITH))


def test_files_functions_and_argument_lists_are_short() -> None:
    too_big = [line for name, lines in found().items() if not is_exempt(name) for line in lines]
    assert not too_big, "\n".join(["split what is too big:", *too_big])


def test_no_file_is_exempt_that_need_not_be() -> None:
    """Of those whose digest forbids an edit; a file that was split since keeps to the limits."""
    assert set(TRAINED_WITH) <= found().keys()


def test_the_check_sees_what_is_too_big() -> None:
    body = "    pass\n" * 60
    text = f"class C:\n    def ok(self, a, b, c, d, e, f):\n        pass\nasync def long(a, *, b):\n{body}"
    wide = "def wide(a, b, /, c, *d, e, f, **g):\n    pass\n"
    assert list(offences("m.py", text)) == ["m.py:4: long has 61 lines; the limit is 60"]
    assert list(offences("m.py", wide)) == ["m.py:1: wide has 7 arguments; the limit is 6"]
    assert list(offences("m.py", "\n" * 251)) == ["m.py:1: the file has 251 lines; the limit is 250"]
