"""``fleet reach``: a reach server."""

from typing import Annotated

import typer

from fleet_cli import logs
from fleet_cli.commands.shared import DEFAULT_ROUTERS, Routers, stop_on_signals


def reach(
    id: Annotated[str, typer.Option(help="Id of this server.")] = "reach-1",
    router: Routers = DEFAULT_ROUTERS,
) -> None:
    """Run a reach server until interrupted."""
    from reach_server.service.server import ReachServer

    stop = stop_on_signals()
    with ReachServer(id, router, stop=stop) as server:
        logs.say(f"reach server {id} ready")
        server.run(stop)
