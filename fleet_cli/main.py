"""The command ``fleet``: one module a command, registered here; the work is done in the packages."""

import logging
import sys
import traceback
from enum import StrEnum
from io import StringIO
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from fleet_bus.errors import FleetError, Stopped, UsageError
from fleet_cli import logs, settings
from fleet_cli.commands import scenario
from fleet_cli.commands.agent import agent
from fleet_cli.commands.bench import bench
from fleet_cli.commands.calibrate import calibrate
from fleet_cli.commands.config import config
from fleet_cli.commands.dashboard import dashboard
from fleet_cli.commands.demo import demo
from fleet_cli.commands.evaluate import evaluate
from fleet_cli.commands.events import events
from fleet_cli.commands.foxglove import foxglove
from fleet_cli.commands.incident import incident
from fleet_cli.commands.paper import paper
from fleet_cli.commands.reach import reach
from fleet_cli.commands.record import record
from fleet_cli.commands.replay import replay
from fleet_cli.commands.router import router
from fleet_cli.commands.side_info import side_info
from fleet_cli.commands.top import top
from fleet_cli.commands.watch import watch

app = typer.Typer(
    name="fleet",
    help="Where can every vehicle be next? Agents, side information, reach server and tools on one bus.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
scenario_app = typer.Typer(no_args_is_help=True, help="Look at scenario documents.")
app.add_typer(scenario_app, name="scenario")


def main() -> None:
    """Entry point: errors of the project become one line on stderr and exit code 1 (failed) or 2 (wrong use)."""
    logs.keep_standard_streams()
    try:
        if settings.file() is None:
            app(auto_envvar_prefix=settings.PREFIX)
        else:
            app(auto_envvar_prefix=settings.PREFIX, default_map=settings.read(typer.main.get_command(app)))
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


class LogFormat(StrEnum):
    """How the log is written."""

    TEXT = "text"
    JSON = "json"


def say_version(wanted: bool) -> None:
    """Print the version and those of what it computes and talks with, and end."""
    if wanted:
        from importlib import metadata
        from platform import python_version

        others = [f"{name} {metadata.version(name)}" for name in ("eclipse-zenoh", "numpy")]
        print(f"fleet-reach {metadata.version('fleet-reach')} (Python {python_version()}, {', '.join(others)})")
        raise typer.Exit


@app.callback()
def common(
    verbose: Annotated[int, typer.Option("-v", "--verbose", count=True, help="Say more; twice for details.")] = 0,
    log_format: Annotated[
        LogFormat, typer.Option(help="Of the log: text, or json, an object a line.", case_sensitive=False)
    ] = LogFormat.TEXT,
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=say_version, help="Print the version and end.")
    ] = False,
) -> None:
    """Set up the log, which goes to stderr."""
    level = (logging.WARNING, logging.INFO, logging.DEBUG)[min(verbose, 2)]
    logs.configure(level, as_json=log_format is LogFormat.JSON)


app.command()(router)
app.command()(reach)
app.command("side-info")(side_info)
scenario_app.command("list")(scenario.scenario_list)
scenario_app.command("check")(scenario.scenario_check)
scenario_app.command("show")(scenario.scenario_show)
for command in (
    agent, record, replay, incident, dashboard, watch, top, events, foxglove, evaluate, calibrate, paper, bench, demo,
    config,
):  # fmt: skip
    app.command()(command)
