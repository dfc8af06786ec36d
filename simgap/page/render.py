"""The page as one HTML document that needs no other file and runs no script."""

from collections.abc import Mapping
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from simgap.page.figures import Figures
from simgap.page.view import view

_ENVIRONMENT = Environment(
    loader=PackageLoader("simgap.page", ""),
    autoescape=True,  # names and statements come from recordings and simulators
    undefined=StrictUndefined,
    lstrip_blocks=True,
)


def page(statement: Mapping[str, Any], figures: Figures) -> str:
    """The HTML page of a diagnosis; equal content makes an equal page.

    statement: what diagnosis.json holds, of which only `verdict` is required. Raises KeyError without it.
    """
    return _ENVIRONMENT.get_template("page.html.jinja").render(view(statement, figures))
