"""``fleet foxglove``: the fleet in Foxglove."""

from typing import Annotated

import typer

from fleet_bus.errors import UsageError
from fleet_bus.sessions import Role
from fleet_cli import logs
from fleet_cli.commands.shared import DEFAULT_ROUTERS, Routers, stop_on_signals


def foxglove(
    port: Annotated[int, typer.Option(help="Port to listen on; 0 takes a free one.", min=0, max=65535)] = 8765,
    host: Annotated[str, typer.Option(help="Address to listen on; any but a loopback lets others look on.")] = (
        "127.0.0.1"
    ),
    rate: Annotated[float, typer.Option(help="Times a second that what is new is shown.", min=1, max=100)] = 10.0,
    router: Routers = DEFAULT_ROUTERS,
) -> None:
    """Show tubes, vehicles, regions, numbers and events to Foxglove, until interrupted."""
    try:
        from fleet_foxglove.bridge import Bridge
    except ModuleNotFoundError as error:
        if error.name != "foxglove":
            raise
        raise UsageError("fleet foxglove needs foxglove-sdk: install fleet-reach with the extra `foxglove`") from None
    from fleet_bus.zenoh_bus import open_bus

    try:
        from fleet_cli.scenario_outlines import outlines
    except ModuleNotFoundError as error:
        logs.warn(f"regions are not drawn, {error.name} is missing: install the extras `server` and `pictures`, too")
        draw_regions = None
    else:
        draw_regions = outlines
    stop = stop_on_signals()
    with (
        open_bus(Role.VIEWER, router, stop=stop) as bus,
        Bridge(bus, host=host, port=port, rate=rate, draw_regions=draw_regions) as bridge,
    ):
        shown = f"[{host}]" if ":" in host else host
        logs.say(f"foxglove connects to ws://{shown}:{bridge.port}")
        bridge.run(stop)
    refused = bridge.rejections.snapshot()
    if refused:
        logs.warn("refused: " + ", ".join(f"{count} {reason}" for reason, count in sorted(refused.items())))
