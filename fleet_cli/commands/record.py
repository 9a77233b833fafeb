"""``fleet record``: everything on the bus, into files."""

import time
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from fleet_cli import logs
from fleet_cli.commands.shared import DEFAULT_ROUTERS, Routers, need, stop_on_signals


def record(
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder to write to; made if it is not there.")],
    id: Annotated[str, typer.Option(help="Id of this recorder.")] = "recorder-1",
    rotate_mb: Annotated[float, typer.Option(help="Begin a new file after this many MB.", min=1.0, max=1e6)] = 256.0,
    rotate_minutes: Annotated[
        float, typer.Option(help="Begin a new file after this many minutes.", min=0.01, max=1e6)
    ] = 10.0,
    limit_gb: Annotated[
        float | None,
        typer.Option(
            help="Remove the oldest recordings of the folder, so that all take at most this many GB.", min=0.0
        ),
    ] = None,
    keep_free_mb: Annotated[
        float,
        typer.Option(help="Leave this many MB of the disk to others; recording waits until there are more.", min=0.0),
    ] = 64.0,
    fsync: Annotated[
        bool, typer.Option("--fsync", help="Wait for the disk at every chunk: what is counted survives a power cut.")
    ] = False,
    scene: Annotated[
        bool | None,
        typer.Option("--scene/--no-scene", help="Beside the messages what Foxglove draws of them; if it is installed."),
    ] = None,
    duration: Annotated[float | None, typer.Option(help="Stop after this many seconds.", min=0.0)] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Write a summary here at the end; '-' for stdout.")
    ] = None,
    router: Routers = DEFAULT_ROUTERS,
) -> None:
    """Record everything on the bus to MCAP files until interrupted.

    A chunk is written at least once a second: after a power cut or a kill all but the last one is there. A full disk
    does not end it: it says so, and goes on when there is room.
    """
    need("recorder", "mcap", "zstandard")
    if scene:
        need("foxglove", "foxglove")
    elif scene is None:
        scene = find_spec("foxglove") is not None
    from fleet_cli.recording import record as work
    from fleet_lab.files import check_writable, write_json
    from fleet_recorder.parts import Rules

    check_writable("--json", json_file)
    rules = Rules(
        part_bytes=round(rotate_mb * 1e6),
        part_seconds=60 * rotate_minutes,
        keep_free=round(keep_free_mb * 1e6),
        sync=fsync,
    )
    stop = stop_on_signals()
    limit = None if limit_gb is None else round(limit_gb * 1e9)
    began = time.monotonic()
    summary = work(output, rules, limit, id, router, stop, duration, scene=scene)
    seconds = time.monotonic() - began
    if str(json_file) != "-":
        logs.say(
            f"{summary['recorded']} messages in {len(summary['files'])} files, {summary['bytes'] / 1e6:.1f} MB, "
            f"{seconds:.0f} s, {summary['lost']} messages lost"
        )
    write_json({**summary, "seconds": round(seconds, 3)}, json_file)
