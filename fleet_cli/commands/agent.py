"""``fleet agent``: vehicle agents."""

from pathlib import Path
from typing import Annotated

import typer

from fleet_bus.errors import UsageError
from fleet_cli import completion
from fleet_cli.commands.shared import DEFAULT_ROUTERS, Metrics, Routers, check_speed, stop_on_signals


def agent(
    vehicle: Annotated[list[str], typer.Option(help="Vehicle id; more than one run in one process.")],
    source: Annotated[str, typer.Option(help="sim or recording.")] = "sim",
    profile: Annotated[
        str, typer.Option(help="Shipped profile or profile file.", autocompletion=completion.profiles)
    ] = "svea",
    recording: Annotated[Path | None, typer.Option(help="Recording (NPZ) of --source recording.")] = None,
    route: Annotated[
        str, typer.Option(help="Route that simulated vehicles drive.", autocompletion=completion.routes)
    ] = "parking-lot",
    seed: Annotated[int, typer.Option(help="Seed of the first simulated vehicle; the next ones count on.", min=0)] = 1,
    history: Annotated[
        int, typer.Option(help="Samples of free driving that a simulated vehicle brings along.", min=0, max=1_000_000)
    ] = 1024,
    speed: Annotated[float, typer.Option(help="How many times faster than real time.")] = 1.0,
    duration: Annotated[float | None, typer.Option(help="Stop after this many seconds.", min=0)] = None,
    router: Routers = DEFAULT_ROUTERS,
    metrics: Metrics = None,
) -> None:
    """Run vehicle agents until interrupted, or until their recording ends."""
    from fleet_cli.agents import recorded, simulated, work
    from fleet_lab.profile_files import find_profile

    check_speed(speed)
    if len(set(vehicle)) < len(vehicle):
        raise UsageError(f"--vehicle {', '.join(sorted(vehicle))}: an id may occur once")
    stop = stop_on_signals()
    chosen = find_profile(profile)
    if source == "sim":
        agents = [simulated(v, chosen, route, seed + i, history) for i, v in enumerate(vehicle)]
    elif source == "recording":
        if recording is None or len(vehicle) != 1:
            raise UsageError("--source recording needs --recording FILE and exactly one --vehicle")
        agents = [recorded(vehicle[0], chosen, recording)]
    else:
        raise UsageError(f"--source {source!r} is unknown: choose sim or recording")
    work(agents, router, stop, speed=speed, duration=duration, metrics=metrics)
