"""``fleet events``: what is told of vehicles and services."""

import time
from typing import Annotated

import typer

from fleet_cli import completion
from fleet_cli.commands.shared import DEFAULT_ROUTERS, Routers, stop_on_signals


def events(
    vehicle: Annotated[str | None, typer.Option(help="Only of vehicles whose name this pattern fits.")] = None,
    kind: Annotated[
        list[str] | None,
        typer.Option(help="Only of this kind; may be given more than once.", autocompletion=completion.event_kinds),
    ] = None,
    since: Annotated[
        str | None, typer.Option(help="Of the cached events those since then: 90, 10min, 2h, or a time in ISO 8601.")
    ] = None,
    count: Annotated[int | None, typer.Option(help="End after this many events.", min=1)] = None,
    duration: Annotated[float | None, typer.Option(help="End after this many seconds.", min=0)] = None,
    json_lines: Annotated[bool, typer.Option("--json", help="JSON objects, one a line.")] = False,
    router: Routers = DEFAULT_ROUTERS,
) -> None:
    """Follow events: those that are cached, by their time, then each as it comes, until interrupted."""
    from fleet_cli.event_stream import Filter, follow_events, kinds_of, since_of

    stop = stop_on_signals()
    wanted = Filter(vehicle, kinds_of(kind or []), 0 if since is None else since_of(since, time.time_ns()))
    follow_events(router, stop, wanted, count=count, duration=duration, json=json_lines)
