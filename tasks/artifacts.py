"""What a flow run shows in Prefect's pages beside its log: how far it is, a table, links."""

from collections.abc import Sequence
from typing import Any
from uuid import UUID

from prefect.artifacts import (
    create_markdown_artifact,
    create_progress_artifact,
    create_table_artifact,
    update_progress_artifact,
)


class Progress:
    """How many of so many pieces are done, as the flow run's progress."""

    def __init__(self, what: str, total: int) -> None:
        self._what, self._total = what, total
        made = create_progress_artifact(progress=0.0, description=self._told(0))
        self._id = made if isinstance(made, UUID) else None

    def done(self, count: int) -> None:
        """So many are done by now."""
        if self._id:
            update_progress_artifact(self._id, 100.0 * count / self._total, self._told(count))

    def _told(self, count: int) -> str:
        return f"{self._what}: {count} of {self._total}"


def table(key: str, rows: Sequence[dict[str, Any]], description: str) -> None:
    """Rows of the same keys as a table; Markdown in a value, such as a link, is shown as such."""
    create_table_artifact(table=list(rows), key=key, description=description)


def links(key: str, places: dict[str, str], description: str) -> None:
    """Where things are: words and addresses or paths; an empty one is left out."""
    lines = [f"- {what}: {f'[{place}]({place})' if place.startswith('http') else f'`{place}`'}"
             for what, place in places.items() if place]  # fmt: skip
    create_markdown_artifact(markdown="\n".join([description, "", *lines]), key=key)
