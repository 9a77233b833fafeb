"""What commands that work on a bus have in common."""

import signal
import threading
from typing import Annotated

import typer

from fleet_bus.sessions import DEFAULT_ROUTER

Routers = Annotated[list[str], typer.Option("--router", help="Endpoint of a router; may be given more than once.")]
DEFAULT_ROUTERS = [DEFAULT_ROUTER]


def stop_on_signals() -> threading.Event:
    """An event that SIGINT and SIGTERM set, so that sessions are closed before the process ends."""
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    return stop
