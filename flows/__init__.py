"""Prefect flows: compose tasks, nothing else. The only place that reads the environment, the clock and the directory.

Importing this package settles what libraries read from the environment at their import, before any of them is.
"""

import os

from flows import running
from simgap.cli import environment
from tasks import server

_DEFAULTS = {
    **environment.numerics(),
    "JAX_COMPILATION_CACHE_DIR": os.path.abspath(".jax"),
    # On a cluster a flow without a server starts one; on two cores that takes longer than the default 20 s.
    "PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS": "180",
    "PREFECT_LOGGING_LEVEL": "WARNING",
    # A warning says that its server is gone; this would repeat it for every event, with all that is in it.
    "PREFECT_LOGGING_INTERNAL_LEVEL": "CRITICAL",
    # DVC says what is stale; Prefect caches nothing.
    "PREFECT_TASKS_DEFAULT_NO_CACHE": "true",
    # No telemetry.
    "DO_NOT_TRACK": "true",
    "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
    "MLFLOW_DISABLE_TELEMETRY": "true",
    # MLflow sets the level of its log when it is first imported, which is late.
    "MLFLOW_LOGGING_LEVEL": "WARNING",
    # Flows say themselves where a run is found.
    "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",
    # A server that is gone is reported after half a minute, not after four.
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "4",
    "DVC_NO_ANALYTICS": "1",
}
environment.collect_seldom()
environment.settle(_DEFAULTS)
os.environ[running.OWNER] = str(os.getpid())
if "PREFECT_API_URL" not in os.environ:
    _server = None if "PREFECT_HOME" in os.environ else running.find("prefect")  # `make up`: a flow is seen there
    os.environ |= running.client(_server.address, _server.login) if _server else server.NONE
    os.environ.setdefault("PREFECT_HOME", os.path.abspath(".prefect"))
