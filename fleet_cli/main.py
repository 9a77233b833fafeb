"""The command ``fleet``: one module a command, registered here; the work is done in the packages."""

import logging
import sys
import traceback
from io import StringIO
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from fleet_bus.errors import FleetError, Stopped, UsageError
from fleet_cli import logs
from fleet_cli.commands import scenario
from fleet_cli.commands.agent import agent
from fleet_cli.commands.bench import bench
from fleet_cli.commands.calibrate import calibrate
from fleet_cli.commands.dashboard import dashboard
from fleet_cli.commands.demo import demo
from fleet_cli.commands.evaluate import evaluate
from fleet_cli.commands.paper import paper
from fleet_cli.commands.reach import reach
from fleet_cli.commands.replay import replay
from fleet_cli.commands.router import router
from fleet_cli.commands.side_info import side_info

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


app.command()(router)
app.command()(reach)
app.command("side-info")(side_info)
scenario_app.command("list")(scenario.scenario_list)
scenario_app.command("check")(scenario.scenario_check)
scenario_app.command("show")(scenario.scenario_show)
for command in (agent, replay, evaluate, calibrate, paper, bench, demo, dashboard):
    app.command()(command)
