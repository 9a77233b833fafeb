"""``fleet replay``: recordings as live vehicles."""

from pathlib import Path
from typing import Annotated

import typer

from fleet_cli import completion
from fleet_cli.commands.shared import DEFAULT_ROUTERS, Routers, check_speed, stop_on_signals


def replay(
    files: Annotated[list[Path], typer.Argument(help="Recordings (NPZ).")],
    profile: Annotated[str, typer.Option(help="Shipped profile or profile file.", autocompletion=completion.profiles)],
    speed: Annotated[float, typer.Option(help="How many times faster than recorded.")] = 1.0,
    as_: Annotated[str | None, typer.Option("--as", help="Vehicle id; several files count on from it.")] = None,
    linger: Annotated[float, typer.Option(help="Seconds to stay on the bus after the last sample.", min=0)] = 0.0,
    router: Routers = DEFAULT_ROUTERS,
) -> None:
    """Publish recordings as live vehicles."""
    from fleet_cli.agents import recorded, vehicle_names, work
    from fleet_lab.profile_files import find_profile

    check_speed(speed)
    stop = stop_on_signals()
    chosen = find_profile(profile)
    names = vehicle_names(files, as_)
    agents = [recorded(name, chosen, path) for name, path in zip(names, files, strict=True)]
    reports = work(agents, router, stop, speed=speed, linger=linger)
    for report in reports.values():
        skipped = ", ".join(f"{count} skipped: {reason}" for reason, count in report.skipped.items())
        print(f"{report.vehicle}: {report.published} samples published" + (f", {skipped}" if skipped else ""))
