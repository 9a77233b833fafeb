"""``fleet reach``: a reach server."""

from typing import Annotated

import typer

from fleet_bus import keys
from fleet_bus.sessions import check_endpoint
from fleet_cli import logs
from fleet_cli.commands.shared import DEFAULT_ROUTERS, Metrics, Routers, prometheus_endpoint, stop_on_signals


def reach(
    id: Annotated[str, typer.Option(help="Id of this server.")] = "reach-1",
    router: Routers = DEFAULT_ROUTERS,
    metrics: Metrics = None,
) -> None:
    """Run a reach server until interrupted."""
    # What is wrong is said before the server's packages are loaded, which takes seconds.
    keys.check_id(id, "server")
    for endpoint in router:
        check_endpoint(endpoint)
    from reach_server.service.server import ReachServer

    stop = stop_on_signals()
    server = ReachServer(id, router, stop=stop)
    with prometheus_endpoint(metrics, "reach", id, "reach_server.service.metrics", server.counters), server:
        logs.say(f"reach server {id} ready")
        server.run(stop)
