"""Processes that work for a flow."""

import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context, parent_process
from threading import Thread


def one_process() -> ProcessPoolExecutor:
    """A process that does one piece of work after the other, so that what it compiles serves all of them."""
    return ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_end_with_parent)


def _end_with_parent() -> None:
    """End this process as soon as the one that started it has ended: if that was killed, it would wait for ever."""

    def wait() -> None:
        parent = parent_process()
        assert parent is not None  # this process was started by another one
        parent.join()
        os._exit(1)

    Thread(target=wait, daemon=True).start()
