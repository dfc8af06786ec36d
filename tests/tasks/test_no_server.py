"""Without a Prefect server no task waits for one."""

import httpx
import pytest
from prefect import task
from prefect.client.orchestration import get_client
from prefect.settings import PREFECT_API_URL, temporary_settings

from tasks.server import NONE, there


@task
def twice(number: int) -> int:
    return 2 * number


def test_the_address_that_stands_for_none_fails_before_anything_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Prefect asks it at the start of every task, and would wait between attempts to connect."""
    monkeypatch.setattr("httpcore._backends.base.NetworkBackend.sleep", lambda *_: pytest.fail("it waits"))
    with temporary_settings({PREFECT_API_URL: NONE["PREFECT_API_URL"]}):
        assert not there()
        assert twice(3) == 6
        with get_client(sync_client=True) as client, pytest.raises(httpx.UnsupportedProtocol):
            client.hello()
