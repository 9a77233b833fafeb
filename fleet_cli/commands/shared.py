"""What commands that work on a bus have in common."""

import _thread
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

    def tell(*_: object) -> None:
        # Set by another thread: a handler runs in the main thread, wherever that is, and where it is about to wait for
        # the event it holds the event's lock. Not by a ``Thread``, whose start takes locks of its own.
        _thread.start_new_thread(stop.set, ())

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, tell)
    return stop


def need(extra: str, *modules: str) -> None:
    """Raise ``UsageError`` that says what to install where modules of an optional part are missing."""
    missing = [module for module in modules if find_spec(module) is None]
    if missing:
        raise UsageError(f"{', '.join(missing)} is not installed: pip install 'fleet-reach[{extra}]'")
