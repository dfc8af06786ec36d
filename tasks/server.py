"""Whether there is a Prefect server that records flows and tasks. Without one, tasks keep their names and retries."""

NONE = {
    "PREFECT_API_URL": "none://none.invalid/api",
    "PREFECT_CLIENT_SERVER_VERSION_CHECK_ENABLED": "false",
    "PREFECT_LOGGING_TO_API_ENABLED": "false",
}
"""Environment without a server. To run a task, Prefect needs an address, and asks it twice where results are kept. One
that no transport can reach fails at once; any other is tried again and again, for six seconds a task."""


def there() -> bool:
    """Whether Prefect's settings name a server."""
    from prefect.settings import PREFECT_API_URL  # seconds of imports, for those that have Prefect anyway

    return PREFECT_API_URL.value() != NONE["PREFECT_API_URL"]
