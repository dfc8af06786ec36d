"""Checks what a person wrote against a typed form; names every wrong value."""

import reprlib
from typing import Any, TypeVar

from pydantic import BaseModel, BeforeValidator, ValidationError

from simgap.types import ConfigError

Form = TypeVar("Form", bound=BaseModel)


def _refuse_bool(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("Input should be a number")
    return value


NUMBER = BeforeValidator(_refuse_bool)
"""Annotates a number, after its range: pydantic alone accepts true as 1."""


def check(form: type[Form], values: Any) -> Form:
    """The values as that form; ConfigError names every wrong value."""
    try:
        return form.model_validate(values)
    except ValidationError as error:
        raise ConfigError(explained(error)) from None


def explained(error: ValidationError) -> str:
    """A line for every wrong value: its key, what it must be, what it is."""
    lines = []
    for wrong in error.errors(include_url=False):
        came = f"; it is {reprlib.repr(wrong['input'])}" if isinstance(wrong["input"], str | int | float) else ""
        message = wrong["msg"].removeprefix("Value error, ")
        lines.append(f"  {'.'.join(map(str, wrong['loc']))}: {message}{came}")
    return f"{len(lines)} values are wrong:\n" + "\n".join(lines)
