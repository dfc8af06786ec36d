"""Prefect's and MLflow's servers behind a guard: only their own pages and programs, no web page, reach them.

Both servers can start processes, and a browser sends what any web page asks it to. So a request is refused when its
`Host` is no name of the server (a page can give its own name this machine's address: DNS rebinding), and when its
`Origin` is another page than the server's own.
"""

import os
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

HOSTS = "SIMGAP_HOSTS"
"""Environment variable: the names that a server is reached by, separated by commas."""


def prefect() -> ASGIApp:
    """What `prefect server start` serves, guarded."""
    from prefect.server.api.server import create_app

    return _guarded(create_app(final=True))


def mlflow() -> ASGIApp:
    """What `mlflow server` serves, guarded."""
    from tasks import tracking

    return _guarded(tracking.pages())


def _guarded(app: ASGIApp) -> ASGIApp:
    return TrustedHostMiddleware(_SameOrigin(app), os.environ[HOSTS].split(","), www_redirect=False)


class _SameOrigin:
    """Refuses with 403 what a page of another origin asks for, be it a preflight, a plain request or a websocket."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        app: ASGIApp = self._app
        if scope["type"] in ("http", "websocket"):
            headers = Headers(scope=scope)
            origin = headers.get("origin")
            if origin is not None and urlsplit(origin).netloc != headers.get("host"):
                app = PlainTextResponse("Refused: the request comes from another web page.", status_code=403)
        await app(scope, receive, send)
