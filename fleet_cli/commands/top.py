"""``fleet top``: what each vehicle costs."""

from typing import Annotated

import typer

from fleet_cli import completion
from fleet_cli.commands.shared import DEFAULT_ROUTERS, Routers, stop_on_signals


def top(
    sort: Annotated[
        str,
        typer.Option(
            help="bytes, rate, time or age: the largest first; or name.", autocompletion=completion.top_orders
        ),
    ] = "bytes",
    vehicle: Annotated[str | None, typer.Option(help="Only vehicles whose name this pattern fits, as 'svea*'.")] = None,
    once: Annotated[bool, typer.Option("--once", help="One table after the first second.")] = False,
    json_lines: Annotated[bool, typer.Option("--json", help="JSON objects, one a line, once a second.")] = False,
    router: Routers = DEFAULT_ROUTERS,
) -> None:
    """Messages, bytes and computing time of each vehicle, and of the bus in all. Live; q leaves."""
    from fleet_cli.live import follow
    from fleet_cli.top import TopScreen
    from fleet_view import FleetView

    stop = stop_on_signals()
    view = FleetView()
    follow(view, TopScreen(view, sort=sort, only=vehicle), router, stop, once=once, json=json_lines)
