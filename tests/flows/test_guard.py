"""The guard before Prefect's and MLflow's servers, before a server of its own; `test_operate` has the real ones."""

import asyncio
from typing import Any

import pytest
from starlette.responses import PlainTextResponse

from flows import guard

HOST = "127.0.0.1:4200"


def asked(origin: bytes) -> int:
    """The status of what is answered to a page of that origin."""
    headers = [(b"host", HOST.encode()), (b"origin", origin)]
    scope = {"type": "http", "method": "GET", "path": "/", "headers": headers}
    statuses = []

    async def receive() -> Any:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: Any) -> None:
        statuses.append(message.get("status"))

    asyncio.run(guard.guarded(PlainTextResponse("hello"), None)(scope, receive, send))
    return statuses[0]


@pytest.mark.parametrize(
    ("origin", "status"),
    [
        (f"http://{HOST}", 200),
        ("http://evil.example", 403),
        ("null", 403),
        ("", 403),
        ("http://[", 403),
        ("http://[::1", 403),
        ("http://\u2100", 403),
    ],
)
def test_an_origin_that_is_no_page_of_the_server_is_refused(
    monkeypatch: pytest.MonkeyPatch, origin: str, status: int
) -> None:
    monkeypatch.setenv(guard.HOSTS, "127.0.0.1")
    assert asked(origin.encode()) == status
