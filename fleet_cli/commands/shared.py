"""What commands that work on a bus have in common."""

import _thread
import math
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Annotated, Any

import typer

from fleet_bus.errors import UsageError
from fleet_bus.sessions import DEFAULT_ROUTER
from fleet_cli import logs

Metrics = Annotated[
    str | None,
    typer.Option(
        "--metrics", metavar="[HOST:]PORT",
        help="Answer Prometheus here, on this machine alone unless a host is named; 0 takes a free port.",
    ),
]  # fmt: skip
Routers = Annotated[list[str], typer.Option("--router", help="Endpoint of a router; may be given more than once.")]
DEFAULT_ROUTERS = [DEFAULT_ROUTER]
#: Variable by which a process that starts others has them end when their standard input does.
ENDS_WITH_STDIN = "FLEET_ENDS_WITH_STDIN"


def check_speed(speed: float) -> None:
    """Raise ``UsageError`` for a speed at which no time can pass."""
    if not (speed > 0 and math.isfinite(speed)):
        raise UsageError(f"--speed {speed} must be positive: 1 is real time")


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
    if os.environ.pop(ENDS_WITH_STDIN, ""):
        threading.Thread(target=_stop_at_the_end_of_stdin, args=(stop,), name="parent", daemon=True).start()
    return stop


def _stop_at_the_end_of_stdin(stop: threading.Event) -> None:
    while os.read(0, 4096):
        pass
    stop.set()


@contextmanager
def prometheus_endpoint(address: str | None, kind: str, instance: str, module: str, source: Any) -> Iterator[None]:
    """Answer Prometheus until the end of the block, and say where; without an address nothing is loaded for it.

    What is answered is what ``metrics`` of ``module`` makes of ``source``. Raises ``UsageError`` for an address that is
    none, ``SessionError`` for one at which nothing can listen.
    """
    if address is None:
        yield
        return
    from fleet_bus import metrics

    read = partial(import_module(module).metrics, source)
    with metrics.serve(metrics.registry(kind, instance, read), address) as url:
        logs.say(f"metrics on {url}")
        yield


def need(extra: str, *modules: str) -> None:
    """Raise ``UsageError`` that says what to install where modules of an optional part are missing."""
    missing = [module for module in modules if find_spec(module) is None]
    if missing:
        raise UsageError(f"{', '.join(missing)} is not installed: pip install 'fleet-reach[{extra}]'")
