"""``fleet demo``: everything at once."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from fleet_cli import completion
from fleet_cli.commands.shared import stop_on_signals
from fleet_lab.files import check_picture, check_writable, write_json


def demo(
    scenario: Annotated[
        str,
        typer.Option(
            help="convoy, intersection, parking-lot, parking-lot-motion or roundabout.",
            autocompletion=completion.demo_scenarios,
        ),
    ] = "parking-lot",
    vehicles: Annotated[int, typer.Option(help="Simulated vehicles.", min=1, max=200)] = 4,
    stray: Annotated[int, typer.Option(help="How many of them leave the scenario.", min=0)] = 0,
    duration: Annotated[
        float, typer.Option(help="Seconds; the scenario is played within this time.", min=2.0, max=86_400.0)
    ] = 40.0,
    headless: Annotated[bool, typer.Option(help="Print lines instead of a live table; no page.")] = False,
    page: Annotated[bool, typer.Option(help="Serve the page meanwhile, and print its address.")] = True,
    page_port: Annotated[
        int, typer.Option(help="Port of the page, or the next one that is free.", min=0, max=65535)
    ] = 8080,
    port: Annotated[int, typer.Option(help="Port of the router; 0 takes a free one.", min=0, max=65535)] = 0,
    seed: Annotated[int, typer.Option(help="Seed of the first vehicle.", min=0)] = 1,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the summary here; '-' for stdout.")] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw the drive and its tubes here (PNG, SVG or PDF).")] = None,
) -> None:
    """Everything at once on this machine: router, side information, reach server and simulated vehicles."""
    from fleet_cli.demo import Demo
    from fleet_cli.reports import print_summary

    check_writable("--json", json_file)
    check_picture("--picture", picture)
    stop = stop_on_signals()
    to_stdout = json_file is not None and str(json_file) == "-"
    served = page_port if page and not headless else None
    run = Demo(scenario, vehicles, duration, stray=stray, port=port, seed=seed, page_port=served)
    summary = run.run(stop, live=not headless, quiet=to_stdout)
    if not to_stdout:
        print_summary(summary)
    write_json(summary, json_file)
    if picture is not None:
        run.draw(picture)
        if not to_stdout:
            print(f"picture: {picture}")
    if stop.is_set():
        print("interrupted: what came until then; it may have failed for want of time", file=sys.stderr)
        sys.exit(130)
    if summary["failures"]:
        sys.exit(1)
