"""What a flow run shows in Prefect's pages beside its log: how far it is, a table, links.

A server that is gone, or none, costs the pages these, and the run nothing.
"""

from collections.abc import Callable, Sequence
from typing import Any
from uuid import UUID

import httpx
from prefect.artifacts import (
    create_markdown_artifact,
    create_progress_artifact,
    create_table_artifact,
    update_progress_artifact,
)

from simgap.cli import progress
from tasks import server


class Progress:
    """How many of so many pieces are done, as the flow run's progress."""

    def __init__(self, what: str, total: int) -> None:
        self._what, self._total = what, total
        made = _tell(lambda: create_progress_artifact(progress=0.0, description=self._told(0)))
        self._id = made if isinstance(made, UUID) else None

    def done(self, count: int) -> None:
        """So many are done by now."""
        percent, made = 100.0 * count / self._total, self._id
        if made:
            _tell(lambda: update_progress_artifact(made, percent, self._told(count)))

    def _told(self, count: int) -> str:
        return f"{self._what}: {count} of {self._total}"


def table(key: str, rows: Sequence[dict[str, Any]], description: str) -> None:
    """Rows of the same keys as a table; Markdown in a value, such as a link, is shown as such."""
    _tell(lambda: create_table_artifact(table=list(rows), key=key, description=description))


def links(key: str, places: dict[str, str], description: str) -> None:
    """Where things are: words and addresses or paths; an empty one is left out."""
    lines = [f"- {what}: {f'[{place}]({place})' if place.startswith('http') else f'`{place}`'}"
             for what, place in places.items() if place]  # fmt: skip
    _tell(lambda: create_markdown_artifact(markdown="\n".join([description, "", *lines]), key=key))


def _tell(call: Callable[[], Any]) -> Any:
    """What telling Prefect's server gives; None where there is none, or where it is gone, which is said."""
    if not server.there():
        return None
    try:
        return call()
    except httpx.HTTPError as error:
        progress.say(f"warning: Prefect's pages are not updated ({error or type(error).__name__}); the work goes on.")
        return None
