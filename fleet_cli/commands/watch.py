"""``fleet watch``: the fleet at a glance."""

from typing import Annotated

import typer

from fleet_cli import completion
from fleet_cli.commands.shared import DEFAULT_ROUTERS, Routers, stop_on_signals


def watch(
    sort: Annotated[
        str,
        typer.Option(
            help="label, age, area, coverage or name: the worst first.", autocompletion=completion.watch_orders
        ),
    ] = "label",
    vehicle: Annotated[str | None, typer.Option(help="Only vehicles whose name this pattern fits, as 'svea*'.")] = None,
    once: Annotated[bool, typer.Option("--once", help="One table after the first second.")] = False,
    json_lines: Annotated[bool, typer.Option("--json", help="JSON objects, one a line, once a second.")] = False,
    router: Routers = DEFAULT_ROUTERS,
) -> None:
    """Vehicles with label, age, area, coverage and what is wrong; services; events. Live; q leaves."""
    from fleet_cli.live import follow
    from fleet_cli.watch import WatchScreen
    from fleet_view import FleetView

    stop = stop_on_signals()
    view = FleetView()
    follow(view, WatchScreen(view, sort=sort, only=vehicle), router, stop, once=once, json=json_lines)
