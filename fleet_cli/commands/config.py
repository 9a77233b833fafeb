"""``fleet config``: what options are without a command line, and where that comes from."""

import json
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table


def config(
    context: typer.Context,
    command: Annotated[str | None, typer.Argument(help="Show the options of this command only.")] = None,
    all_: Annotated[bool, typer.Option("--all", help="Defaults, too.")] = False,
    json_lines: Annotated[bool, typer.Option("--json", help="JSON objects, one a line.")] = False,
) -> None:
    """Show settings from file and environment, and where each comes from."""
    from fleet_bus.errors import UsageError
    from fleet_cli import settings

    group = context.find_root().command
    found = settings.effective(group)
    if command is not None:
        if (wanted := f"fleet {command}") not in {one.command for one in found}:
            raise UsageError(f"there is no command {command} with options")
        found = [one for one in found if one.command == wanted]
    if not (all_ or command is not None):
        found = [one for one in found if one.source != "default"]
    if json_lines:
        for one in found:
            print(json.dumps({**one._asdict(), "value": one.value}))
        return
    path = settings.file()
    console = Console(highlight=False)
    console.print(f"file: {path}" if path else f"no file: {' or '.join(map(str, settings.places()))}", soft_wrap=True)
    if not found:
        console.print("every option has its default: fleet config --all shows them", soft_wrap=True)
        return
    table = Table(box=None, pad_edge=False)
    for column in ("command", "option", "value", "from", "variable"):
        table.add_column(column, overflow="fold")
    for one in found:
        value = "–" if one.value is None else str(one.value)
        table.add_row(*map(escape, (one.command, one.option, value, one.source, one.variable)))
    console.print(table)
