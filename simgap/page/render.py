"""Pages as HTML documents that need no other file and run no script."""

from collections.abc import Mapping
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from simgap.page.figures import Figures
from simgap.page.marks import COLOURS, FONTS
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
    return fill("page.html.jinja", view(statement, figures))


def fill(template: str, values: Mapping[str, Any]) -> str:
    """A template of this package with its values, in the project's fonts and colours."""
    return _ENVIRONMENT.get_template(template).render(fonts=FONTS, accent=COLOURS["augmented"], **values)
