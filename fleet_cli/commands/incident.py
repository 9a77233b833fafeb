"""``fleet incident``: a stretch of a recording, in a file of its own."""

from pathlib import Path
from typing import Annotated

import typer

from fleet_bus.errors import UsageError
from fleet_cli import logs
from fleet_cli.commands.shared import need


def incident(
    files: Annotated[list[Path], typer.Argument(help="Recordings of fleet record (MCAP), or their folder.")],
    at: Annotated[
        str | None,
        typer.Option(help="Instant: an ISO time (UTC if it says no offset), ns since 1970, or s from the beginning."),
    ] = None,
    event: Annotated[
        str | None, typer.Option(help="The first event of this kind, or the event of this number, counted from 1.")
    ] = None,
    before: Annotated[float, typer.Option(help="Seconds before the instant.", min=0.0, max=1e9)] = 30.0,
    after: Annotated[float, typer.Option(help="Seconds after it.", min=0.0, max=1e9)] = 30.0,
    from_checkpoint: Annotated[
        bool,
        typer.Option("--from-checkpoint", help="Begin earlier, at the newest checkpoint, so that --verify has all."),
    ] = False,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="File to write; named after the instant.")
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write what was cut here; '-' for stdout.")] = None,
) -> None:
    """Cut the stretch around an instant or an event out of a recording, into a file that stands alone.

    It begins with what was in force: profiles, documents, assignments, statuses, who was alive, and the newest
    checkpoint of each server.
    """
    need("recorder", "mcap", "zstandard")
    from dataclasses import asdict

    from fleet_lab.files import check_writable, write_json
    from fleet_recorder import incident as cutting
    from fleet_recorder.reader import expand

    if (at is None) == (event is None):
        raise UsageError("give the instant with --at, or the event with --event")
    check_writable("--json", json_file)
    paths = expand(files)
    if event is not None:
        at_ns, found = cutting.find_event(paths, event)
        if str(json_file) != "-":
            logs.say(f"{found.kind} of {found.vehicle or found.source}: {found.message}")
    else:
        at_ns = cutting.find_instant(paths, at or "")
    out = output or Path(f"incident-{at_ns}.mcap")
    check_writable("-o", out)
    done = cutting.cut(paths, out, at_ns, before=before, after=after, from_checkpoint=from_checkpoint, warn=logs.warn)
    if str(json_file) != "-":
        with_it = "with" if done.checkpoint else "without"
        logs.say(f"{out}: {done.messages} messages and {done.carried} that were in force, {with_it} a checkpoint")
    write_json({**asdict(done), "path": str(out)}, json_file)
