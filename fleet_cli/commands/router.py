"""``fleet router``: the embedded router."""

from pathlib import Path
from typing import Annotated

import typer

from fleet_cli import logs
from fleet_cli.commands.shared import stop_on_signals


def router(
    port: Annotated[int, typer.Option(help="Port on 127.0.0.1; 0 takes a free one.", min=0, max=65535)] = 7447,
    listen: Annotated[list[str] | None, typer.Option(help="Endpoints to listen on, instead of --port.")] = None,
    config: Annotated[Path | None, typer.Option(help="Zenoh configuration file (JSON5).")] = None,
) -> None:
    """Run the embedded router until interrupted; prints the endpoints it listens on."""
    from fleet_bus.router import Router

    stop = stop_on_signals()
    endpoints = listen or ([f"tcp/127.0.0.1:{port}"] if config is None else None)
    with Router(endpoints, config_file=config, warn=logs.warn) as running:
        logs.say(f"router listens on {' '.join(running.endpoints)}")
        stop.wait()
