"""What commands that work on a bus have in common."""

import _thread
import os
import signal
import threading
from importlib.util import find_spec
from typing import Annotated

import typer

from fleet_bus.errors import UsageError
from fleet_bus.sessions import DEFAULT_ROUTER

Routers = Annotated[list[str], typer.Option("--router", help="Endpoint of a router; may be given more than once.")]
DEFAULT_ROUTERS = [DEFAULT_ROUTER]


def stop_on_signals() -> threading.Event:
    """An event that SIGINT and SIGTERM set, so that sessions are closed before the process ends."""
    stop = threading.Event()
    numbers = (signal.SIGINT, signal.SIGTERM)

    def tell(*_: object) -> None:
        # Set by another thread: a handler runs in the main thread, wherever that is, and where it is about to wait for
        # the event it holds the event's lock. Not by a ``Thread``, whose start takes locks of its own.
        _thread.start_new_thread(stop.set, ())

    def watch() -> None:
        while os.read(reading, 1)[0] not in numbers:
            pass
        stop.set()

    # A handler runs when the main thread goes on, and if a thread of Zenoh's gets the signal, nothing wakes that one
    # from its wait. What is written to this pipe is written by whichever thread gets it.
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    for number in numbers:
        signal.signal(number, tell)
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    threading.Thread(target=watch, name="signals", daemon=True).start()
    return stop


def need(extra: str, *modules: str) -> None:
    """Raise ``UsageError`` that says what to install where modules of an optional part are missing."""
    missing = [module for module in modules if find_spec(module) is None]
    if missing:
        raise UsageError(f"{', '.join(missing)} is not installed: pip install 'fleet-reach[{extra}]'")
