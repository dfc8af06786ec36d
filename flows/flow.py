"""Flows as Prefect's, that need no server: without one, a flow is the call of its function."""

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import prefect
from prefect.events.clients import NullEventsClient
from prefect.events.worker import EventsWorker
from prefect.utilities.callables import get_call_parameters

from tasks import server

P = ParamSpec("P")
R = TypeVar("R")

if not server.there():
    EventsWorker.set_client_override(NullEventsClient)


class Flow(prefect.Flow[P, R]):
    """Where there is no server, its parameters are checked and its function is called, and nothing is recorded."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        if server.there():
            return super().__call__(*args, **kwargs)
        function: Callable[..., Any] = self.fn
        return function(**self.validate_parameters(get_call_parameters(function, args, kwargs)))


def flow(name: str, flow_run_name: str | None = None) -> Callable[[Callable[P, R]], Flow[P, R]]:
    """Makes a function a flow; `flow_run_name` may have the function's parameters in braces."""
    return lambda function: Flow(function, name=name, flow_run_name=flow_run_name)
