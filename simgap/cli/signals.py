"""Ctrl-C while compiled code runs, during which Python handles no signal."""

import os
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_HEARD_S = 3.0
"""Time for work to end on Ctrl-C before it is said that it does not [s]."""


@contextmanager
def interruptible() -> Iterator[None]:
    """A second Ctrl-C ends the process at once: Python does not hear of the first before compiled code returns."""
    receiver, sender = socket.socketpair()
    sender.setblocking(False)
    before = signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)
    threading.Thread(target=_count, args=(receiver,), daemon=True).start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        sender.close()


def _count(receiver: socket.socket) -> None:
    """End the process on the second Ctrl-C; until the other end is closed."""
    asked = 0
    with receiver:
        while number := _next(receiver):
            asked += number[0] == signal.SIGINT
            if asked == 1:
                receiver.settimeout(_HEARD_S)
            if asked == 2:
                os.write(1, b"stopped\n")
                os._exit(130)


def _next(receiver: socket.socket) -> bytes:
    """The number of the next signal; it is said once if that takes long after a Ctrl-C."""
    try:
        return receiver.recv(1)
    except TimeoutError:
        os.write(1, b"Still stopping. Ctrl-C again ends it at once.\n")
        receiver.settimeout(None)
        return receiver.recv(1)
