"""The page as a server: the application, its socket, and its threads."""

import errno
import secrets
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass

import uvicorn
from fastapi import FastAPI
from nicegui import ui

from fleet_bus import keys
from fleet_bus.errors import FleetError, KeyIdError, UsageError
from fleet_dashboard.gateway import Gateway
from fleet_dashboard.live import add_live
from fleet_dashboard.page import FleetPage
from fleet_dashboard.security import Guard, is_loopback
from fleet_dashboard.vehicle_page import VehiclePage
from fleet_dashboard.view import Views


@dataclass(frozen=True, slots=True)
class Address:
    """Where the page is to be found. ``token`` is what one needs to look, none for this machine only."""

    host: str
    port: int
    token: str | None

    @property
    def url(self) -> str:
        """What to open."""
        host = {"0.0.0.0": socket.gethostname(), "::": socket.gethostname()}.get(self.host, self.host)
        shown = f"[{host}]" if ":" in host else host
        return f"http://{shown}:{self.port}/" + (f"?token={self.token}" if self.token else "")


def listen(host: str, port: int, token: str | None, *, search: bool = False) -> tuple[socket.socket, Address]:
    """A socket that listens, and its address; with ``search`` on the next free port if that one is taken.

    Where others can come, a token is made unless one is given. Raises ``UsageError`` for a token that is too short or
    cannot be part of an address, ``FleetError`` if the port is taken.
    """
    if token is not None and (
        len(token) < 8 or not token.isascii() or not all(c.isalnum() or c in "-_.~" for c in token)
    ):
        raise UsageError("--token: give at least 8 letters, digits, '-', '_', '.' or '~'")
    if token is None and not is_loopback(host):
        token = secrets.token_urlsafe(24)
    last = min(port + 50, 65535) if search and port else port
    for candidate in range(port, last + 1):
        try:
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            listening = socket.create_server((host, candidate), family=family)
        except OSError as error:
            if error.errno == errno.EADDRINUSE and candidate < last:
                continue
            if error.errno == errno.EADDRINUSE:
                raise FleetError(
                    f"port {candidate} of {host} is taken: choose another with --port, or 0 for a free one"
                ) from None
            raise FleetError(f"cannot listen on {host}, port {candidate}: {error.strerror or error}") from None
        return listening, Address(host, listening.getsockname()[1], token)
    raise AssertionError("a port was found, or an error raised")


def application(gateway: Gateway, address: Address, *, source: str, live: bool = True) -> FastAPI:
    """The page over a gateway. ``source`` says in words what is looked at. One of them in a process, since NiceGUI has
    one."""
    views = Views()
    outer = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    add_live(outer, gateway, views)

    @ui.page("/")
    def fleet() -> None:
        FleetPage(gateway, views, source=source, live=live)

    @ui.page("/vehicle/{vehicle}")
    def of_vehicle(vehicle: str) -> None:
        try:
            VehiclePage(gateway, views, keys.check_id(vehicle))
        except KeyIdError as error:
            ui.label(str(error))

    ui.run_with(outer, title="fleet", dark=None, show_welcome_message=False, reconnect_timeout=30.0)
    outer.add_middleware(Guard, token=address.token)
    return outer


def serve(
    app: FastAPI,
    listening: socket.socket,
    stop: threading.Event,
    *,
    root_path: str = "",
    ready: Callable[[], object] = bool,
) -> None:
    """Serve until told to stop; calls ``ready`` once requests are answered. Browsers get a moment to be told."""
    config = uvicorn.Config(
        app, log_config=None, access_log=False, root_path=root_path, ws_per_message_deflate=False,
        timeout_graceful_shutdown=1,
    )  # fmt: skip
    server = uvicorn.Server(config)
    # Signals belong to the command, which sets the event.
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, name="page", daemon=True)
    thread.start()
    told = False
    while thread.is_alive() and not stop.wait(0.1):
        if server.started and not told:
            told = True
            ready()
    server.should_exit = True
    thread.join(5.0)
    if not told and not stop.is_set():
        raise FleetError("the page could not be started: run it again with fleet -v")
