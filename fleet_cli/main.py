"""The command ``fleet``: options and arguments; the work is done in the packages."""

import logging
import signal
import sys
import threading
import traceback
from io import StringIO
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from fleet_bus.errors import FleetError, ScenarioError, Stopped, UsageError
from fleet_bus.sessions import DEFAULT_ROUTER
from fleet_cli import logs, offline
from fleet_cli.bench import bench
from fleet_cli.paper import paper
from fleet_lab.files import check_writable, write_json

app = typer.Typer(
    name="fleet",
    help="Where can every vehicle be next? Agents, side information, reach server and tools on one bus.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
scenario_app = typer.Typer(no_args_is_help=True, help="Look at scenario documents.")
app.add_typer(scenario_app, name="scenario")

Routers = Annotated[list[str], typer.Option("--router", help="Endpoint of a router; may be given more than once.")]
_DEFAULT_ROUTERS = [DEFAULT_ROUTER]


def main() -> None:
    """Entry point: errors of the project become one line on stderr and exit code 1 (failed) or 2 (wrong use)."""
    logs.keep_standard_streams()
    try:
        app()
    except Stopped:
        # Told to end before there was anything to do.
        sys.exit(0)
    except FleetError as error:
        # Rich itself would fail, or wait, where stderr takes nothing.
        line = StringIO()
        console = Console(file=line, force_terminal=sys.stderr is not None and sys.stderr.isatty())
        console.print(f"[bold red]error[/]: {escape(str(error))}", highlight=False, soft_wrap=True, end="")
        logs.tell(line.getvalue())
        sys.exit(2 if isinstance(error, UsageError) else 1)
    except Exception:
        logs.tell(traceback.format_exc().rstrip())
        sys.exit(1)


@app.callback()
def common(
    verbose: Annotated[int, typer.Option("-v", "--verbose", count=True, help="Say more; twice for details.")] = 0,
) -> None:
    """Set up the log, which goes to stderr."""
    logs.configure((logging.WARNING, logging.INFO, logging.DEBUG)[min(verbose, 2)])


def stop_on_signals() -> threading.Event:
    """An event that SIGINT and SIGTERM set, so that sessions are closed before the process ends."""
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    return stop


@app.command()
def router(
    port: Annotated[int, typer.Option(help="Port on 127.0.0.1; 0 takes a free one.")] = 7447,
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


@app.command()
def reach(
    id: Annotated[str, typer.Option(help="Id of this server.")] = "reach-1",
    router: Routers = _DEFAULT_ROUTERS,
) -> None:
    """Run a reach server until interrupted."""
    from reach_server.service.server import ReachServer

    stop = stop_on_signals()
    with ReachServer(id, router, stop=stop) as server:
        logs.say(f"reach server {id} ready")
        server.run(stop)


@app.command("side-info")
def side_info(
    scenarios: Annotated[list[str] | None, typer.Argument(help="Shipped scenarios or scenario files.")] = None,
    assign: Annotated[
        list[str] | None, typer.Option(help="VEHICLE=SCENARIO; '*' stands for every vehicle that is seen.")
    ] = None,
    id: Annotated[str, typer.Option(help="Id of this service.")] = "side-info-1",
    clock_offset: Annotated[float, typer.Option(help="Bound on the difference of clocks, s.", min=0, max=3600)] = 0.0,
    router: Routers = _DEFAULT_ROUTERS,
) -> None:
    """Publish scenarios and assign vehicles to them. Without --assign every vehicle gets the first scenario.

    Scenario files are watched: a changed one is published once its version is raised and it checks. Without a scenario
    nothing is published but that the service is there.
    """
    from fleet_bus import Role, open_session
    from side_info.documents.scenario import Scenario
    from side_info.service import watching
    from side_info.service.service import EVERY_VEHICLE, SideInfoService

    stop = stop_on_signals()
    names = scenarios or []
    loaded = [Scenario.load(name) for name in names]
    pairs = _pairs(assign or []) if assign or not loaded else {EVERY_VEHICLE: loaded[0].name}
    files = watching.files(names, loaded)
    if not loaded:
        logs.warn("no scenario is named, so none is published")
    with open_session(Role.SERVICE, router, stop=stop) as session:
        service = SideInfoService(session, loaded, pairs, id, files=files, clock_offset=clock_offset)
        logs.say(f"side-info publishes {', '.join(s.name for s in loaded) or 'no scenario'}")
        service.run(stop)


def _pairs(texts: list[str]) -> dict[str, str]:
    pairs: dict[str, str] = {}
    for vehicle, scenario in map(_pair, texts):
        if pairs.setdefault(vehicle, scenario) != scenario:
            raise UsageError(
                f"--assign: {vehicle} is assigned twice ({pairs[vehicle]}, {scenario}); one service gives a vehicle "
                "one scenario, start a second fleet side-info --id …"
            )
    return pairs


def _pair(text: str) -> tuple[str, str]:
    vehicle, separator, scenario = text.partition("=")
    if not (vehicle and separator and scenario):
        raise UsageError(f"--assign {text!r}: write VEHICLE=SCENARIO, such as svea1=parking-lot or '*=parking-lot'")
    return vehicle, scenario


SampleTime = Annotated[
    float | None, typer.Option("--sample-time", help="Of the vehicles' samples, s.", min=1e-4, max=60.0)
]


@scenario_app.command("list")
def scenario_list(
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the list here; '-' for stdout.")] = None,
) -> None:
    """Name the scenarios that ship with the project, and what each is about."""
    from fleet_cli.scenario_files import describe
    from side_info.documents.scenario import Scenario, shipped

    found = {name: describe(Scenario.load(name)) for name in shipped()}
    if str(json_file) != "-":
        width = max(map(len, found), default=0)
        for name, text in found.items():
            print(f"{name:<{width}}  {text}")
    write_json([{"scenario": name, "description": text} for name, text in found.items()], json_file)


@scenario_app.command("check")
def scenario_check(
    scenarios: Annotated[list[str], typer.Argument(help="Shipped scenarios or scenario files.")],
    profile: Annotated[str | None, typer.Option(help="Profile whose states the scenario must fit.")] = None,
    sample_time: SampleTime = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write what was found here; '-' for stdout.")] = None,
) -> None:
    """Check scenario documents; exit code 2 names the errors with their places, warnings do not change it."""
    from fleet_cli import scenario_files
    from fleet_lab.profile_files import find_profile

    chosen = find_profile(profile) if profile is not None else None
    checked, errors = scenario_files.check(scenarios, chosen, sample_time)
    if str(json_file) != "-":
        for one in checked:
            print(f"{one.scenario.name} v{one.scenario.version}: {scenario_files.summarize(one.scenario)}")
            for finding in one.findings:
                print(f"  {scenario_files.place(one, finding)}: warning: {finding.message}")
    write_json(scenario_files.as_json(checked, errors), json_file)
    if errors:
        raise ScenarioError("\n".join(map(str, errors)))


@scenario_app.command("show")
def scenario_show(
    scenario: Annotated[str, typer.Argument(help="Shipped scenario or scenario file.")],
    sample_time: Annotated[float, typer.Option(help="Of the vehicles' samples, s.", min=1e-4, max=60.0)] = 0.05,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Draw it here (PNG, SVG or PDF).")] = None,
) -> None:
    """Say what a scenario asks for and when; draw its regions, and when it asks for which predicate."""
    from fleet_cli import scenario_files
    from fleet_cli.scenario_activity import activity
    from fleet_cli.scenario_report import print_scenario

    checked, errors = scenario_files.check([scenario], None, sample_time)
    if errors:
        raise errors[0]
    found = activity(checked[0].scenario, sample_time)
    print_scenario(checked[0], found)
    if output is not None:
        from fleet_cli.scenario_picture import draw_scenario

        draw_scenario(checked[0].scenario, found, output)
        print(f"picture: {output}")


@app.command()
def agent(
    vehicle: Annotated[list[str], typer.Option(help="Vehicle id; more than one run in one process.")],
    source: Annotated[str, typer.Option(help="sim or recording.")] = "sim",
    profile: Annotated[str, typer.Option(help="Shipped profile or profile file.")] = "svea",
    recording: Annotated[Path | None, typer.Option(help="Recording (NPZ) of --source recording.")] = None,
    route: Annotated[str, typer.Option(help="Route that simulated vehicles drive.")] = "parking-lot",
    seed: Annotated[int, typer.Option(help="Seed of the first simulated vehicle; the next ones count on.")] = 1,
    history: Annotated[int, typer.Option(help="Samples of free driving that a simulated vehicle brings along.")] = 1024,
    speed: Annotated[float, typer.Option(help="How many times faster than real time.")] = 1.0,
    duration: Annotated[float | None, typer.Option(help="Stop after this many seconds.")] = None,
    router: Routers = _DEFAULT_ROUTERS,
) -> None:
    """Run vehicle agents until interrupted, or until their recording ends."""
    from fleet_cli.agents import recorded, simulated, work
    from fleet_lab.profile_files import find_profile

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
    work(agents, router, stop, speed=speed, duration=duration)


@app.command()
def replay(
    files: Annotated[list[Path], typer.Argument(help="Recordings (NPZ).")],
    profile: Annotated[str, typer.Option(help="Shipped profile or profile file.")],
    speed: Annotated[float, typer.Option(help="How many times faster than recorded.")] = 1.0,
    as_: Annotated[str | None, typer.Option("--as", help="Vehicle id; several files count on from it.")] = None,
    linger: Annotated[float, typer.Option(help="Seconds to stay on the bus after the last sample.")] = 0.0,
    router: Routers = _DEFAULT_ROUTERS,
) -> None:
    """Publish recordings as live vehicles."""
    from fleet_cli.agents import recorded, vehicle_names, work
    from fleet_lab.profile_files import find_profile

    stop = stop_on_signals()
    chosen = find_profile(profile)
    names = vehicle_names(files, as_)
    agents = [recorded(name, chosen, path) for name, path in zip(names, files, strict=True)]
    reports = work(agents, router, stop, speed=speed, linger=linger)
    for report in reports.values():
        skipped = ", ".join(f"{count} skipped: {reason}" for reason, count in report.skipped.items())
        print(f"{report.vehicle}: {report.published} samples published" + (f", {skipped}" if skipped else ""))


app.command()(offline.evaluate)
app.command()(offline.calibrate)
app.command()(paper)
app.command()(bench)


@app.command()
def demo(
    scenario: Annotated[str, typer.Option(help="parking-lot, parking-lot-motion or roundabout.")] = "parking-lot",
    vehicles: Annotated[int, typer.Option(help="Simulated vehicles.", min=1, max=200)] = 4,
    stray: Annotated[int, typer.Option(help="How many of them leave the scenario.", min=0)] = 0,
    duration: Annotated[float, typer.Option(help="Seconds; the scenario is played within this time.", min=2.0)] = 40.0,
    headless: Annotated[bool, typer.Option(help="Print lines instead of a live table.")] = False,
    port: Annotated[int, typer.Option(help="Port of the router; 0 takes a free one.")] = 0,
    seed: Annotated[int, typer.Option(help="Seed of the first vehicle.")] = 1,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the summary here; '-' for stdout.")] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw the drive and its tubes here (PNG, SVG or PDF).")] = None,
) -> None:
    """Everything at once on this machine: router, side information, reach server and simulated vehicles."""
    from fleet_cli.demo import Demo
    from fleet_cli.reports import print_summary

    check_writable("--json", json_file)
    check_writable("--picture", picture)
    stop = stop_on_signals()
    to_stdout = json_file is not None and str(json_file) == "-"
    run = Demo(scenario, vehicles, duration, stray=stray, port=port, seed=seed)
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
