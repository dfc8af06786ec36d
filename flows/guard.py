"""Prefect's and MLflow's servers behind a guard: only their own pages and programs, no web page, reach them.

Both servers can start processes, and a browser sends what any web page asks it to. So a request is refused when its
`Host` is no name of the server (a page can give its own name this machine's address: DNS rebinding), and when its
`Origin` is another page than the server's own.
"""

import base64
import hmac
import os
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

HOSTS = "SIMGAP_HOSTS"
"""Environment variable: the names that a server is reached by, separated by commas."""
STORE, ARTIFACTS = "SIMGAP_MLFLOW_STORE", "SIMGAP_MLFLOW_ARTIFACTS"
"""Environment variables: the address of MLflow's database, and the folder of what runs have logged."""
LOGIN = "SIMGAP_LOGIN"
"""Environment variable: `user:password` that MLflow's server asks for, which has no login of its own."""


def prefect() -> ASGIApp:
    """What `prefect server start` serves, guarded; it asks for a login by itself, PREFECT_SERVER_API_AUTH_STRING."""
    from prefect.server.api.server import create_app

    return guarded(create_app(final=True), None)


def mlflow() -> ASGIApp:
    """What `mlflow server` serves, guarded."""
    from tasks.tracking import links

    os.environ |= links.settings(os.environ[STORE], os.environ[ARTIFACTS])
    return guarded(links.application(), os.environ.get(LOGIN))


def guarded(app: ASGIApp, login: str | None) -> ASGIApp:
    """An application that answers only those whom the environment names as `HOSTS`, and who know the login if any."""
    return TrustedHostMiddleware(_Guard(app, login), os.environ[HOSTS].split(","), www_redirect=False)


class _Guard:
    """Refuses preflights, plain requests and websockets: with 403 those of other pages, with 401 those without login.

    Whether the server is up, `/health` says to anyone.
    """

    def __init__(self, app: ASGIApp, login: str | None) -> None:
        self._app = app
        self._expected = b"Basic " + base64.b64encode(login.encode()) if login else None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        app = self._app if scope["type"] == "lifespan" else self._refusal(scope) or self._app
        await app(scope, receive, send)

    def _refusal(self, scope: Scope) -> PlainTextResponse | None:
        headers = Headers(scope=scope)
        origin, given = headers.get("origin"), headers.get("authorization", "").encode()
        if origin is not None and not _is_of(origin, headers.get("host")):
            return PlainTextResponse("Refused: the request comes from another web page.", 403)
        if self._expected and scope["path"] != "/health" and not hmac.compare_digest(given, self._expected):
            return PlainTextResponse("A login is needed.", 401, {"WWW-Authenticate": 'Basic realm="simgap"'})
        return None


def _is_of(origin: str, host: str | None) -> bool:
    """Whether an `Origin` is a page of the server that the request's `Host` names; one that is no address is not."""
    try:
        return urlsplit(origin).netloc == host
    except ValueError:
        return False
