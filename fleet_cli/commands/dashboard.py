"""``fleet dashboard``: the page."""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fleet_cli import logs
from fleet_cli.commands.shared import DEFAULT_ROUTERS, Routers, stop_on_signals

if TYPE_CHECKING:
    from fleet_dashboard.gateway import Gateway
    from fleet_dashboard.regions import Regions


def dashboard(
    host: Annotated[
        str, typer.Option(help="Address to listen on; with any but this machine's own a token is needed.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port; 0 takes a free one.", min=0, max=65535)] = 8080,
    next_port: Annotated[
        bool, typer.Option("--next-port", help="If the port is taken, take the next free one.")
    ] = False,
    token: Annotated[
        str | None,
        typer.Option(help="Who looks needs this; made and printed if --host is another one.", envvar="FLEET_TOKEN"),
    ] = None,
    root_path: Annotated[str, typer.Option(help="Path under which a reverse proxy has the page, such as /fleet.")] = "",
    recording: Annotated[Path | None, typer.Option("--open", help="Show this recording instead of the bus.")] = None,
    router: Routers = DEFAULT_ROUTERS,
) -> None:
    """The page: map, list, timeline and plots in a browser, until interrupted. It only reads."""
    from fleet_bus.errors import UsageError

    try:
        from fleet_dashboard.serving import application, listen, serve
    except ModuleNotFoundError as error:
        raise UsageError(
            f"the page needs {error.name}, which is not installed: pip install 'fleet-reach[dashboard]'"
        ) from None

    stop = stop_on_signals()
    listening, address = listen(host, port, token, search=next_port)
    with listening, ExitStack() as opened:
        if recording is None:
            gateway, source = opened.enter_context(_looking(router, stop)), " ".join(router)
        else:
            gateway, source = _opened(recording, stop), recording.name
        app = application(gateway, address, source=source, live=recording is None)
        serve(app, listening, stop, root_path=root_path, ready=lambda: logs.say(f"page on {address.url}"))


@contextmanager
def _looking(routers: Sequence[str], stop: threading.Event) -> "Iterator[Gateway]":
    """A gateway that reads the bus until the block is left."""
    from fleet_bus.pubsub import subscribe
    from fleet_bus.sessions import Role
    from fleet_bus.zenoh_bus import open_bus
    from fleet_dashboard.gateway import Gateway

    gateway = Gateway(draw=_drawing())
    with open_bus(Role.VIEWER, routers, stop) as bus:
        session = bus.session
        gateway.connected = lambda: bool(list(session.info.routers_zid()))
        ended = threading.Event()
        with gateway.listen(bus, partial(subscribe, session)):
            thread = threading.Thread(target=gateway.run, args=(ended,), name="gateway", daemon=True)
            thread.start()
            try:
                yield gateway
            finally:
                ended.set()
                thread.join()


def _opened(recording: Path, stop: threading.Event) -> "Gateway":
    """A gateway with the history of a recording."""
    from fleet_bus.errors import UsageError
    from fleet_dashboard.recording import load

    try:
        # By name, so that the page can be had without what reads recordings.
        read = import_module("fleet_recorder.reader").read
    except ModuleNotFoundError as error:
        raise UsageError(
            f"--open needs {error.name}, which is not installed: pip install 'fleet-reach[recorder]'"
        ) from None
    logs.say(f"reads {recording}")
    return load(read(recording), draw=_drawing(), stop=stop)


def _drawing() -> "Callable[[str], Regions] | None":
    """What draws regions; none without the packages that read scenarios."""
    try:
        from fleet_cli.regions import draw_regions
    except ModuleNotFoundError:
        return None
    return draw_regions
