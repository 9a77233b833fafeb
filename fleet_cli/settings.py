"""Options of commands from a file and from the environment: what the command line says counts first.

Typer does the work: an option takes its value from the command line, else from the variable
``FLEET_<COMMAND>_<OPTION>``, else from the file, else it has its default. The file is TOML: a table for each command,
and one, ``all``, for every command that has such an option.
"""

import os
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import typer

from fleet_bus.errors import UsageError

#: Names the file; without it the first of ``places`` that is there counts.
VARIABLE: Final = "FLEET_CONFIG"
PREFIX: Final = "FLEET"
#: The table of what holds for every command.
ALL: Final = "all"
#: Options that say how to look at a command, not what it does.
_NOT_SET: Final = {"help", "version", "install-completion", "show-completion"}

#: Words of a command, and the command as Typer has it, whose classes are its own.
Command = tuple[tuple[str, ...], Any]


class Setting(NamedTuple):
    """An option of a command with the value that it has without a command line, where that comes from, and the
    environment variable that would change it."""

    command: str
    option: str
    value: Any
    source: str
    variable: str


def places() -> list[Path]:
    """Where the file may lie, the first one first."""
    home = os.environ.get("XDG_CONFIG_HOME") or "~/.config"
    return [Path(home).expanduser() / "fleet-reach" / "config.toml", Path("/etc/fleet-reach/config.toml")]


def file() -> Path | None:
    """The file that counts; raise ``UsageError`` if one is named and not there."""
    named = os.environ.get(VARIABLE, "")
    if named:
        if not Path(named).is_file():
            raise UsageError(f"{VARIABLE} names {named}, which is no file")
        return Path(named)
    return next((path for path in places() if path.is_file()), None)


def read(group: Any) -> dict[str, Any]:
    """What the file says, by command and parameter, as Typer takes it; empty without a file.

    Raises ``UsageError`` for a file that cannot be read, and for a command or an option that does not exist.
    """
    path = file()
    if path is None:
        return {}
    try:
        stated = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise UsageError(f"{path}: {error}") from None
    general = stated.pop(ALL, {})
    _check_tables({ALL: general}, None, path)
    _check_tables(stated, group, path)
    found: dict[str, Any] = {}
    known: set[str] = set()
    for words, command in commands(group):
        own, table = stated, found
        for word in words:
            own, table = own.get(word, {}), table.setdefault(word, {})
        options = dict(_options(command))
        known |= options.keys()
        values = {**general, **{name: value for name, value in own.items() if not isinstance(value, Mapping)}}
        below = getattr(command, "commands", {})
        if words and (unknown := own.keys() - options.keys() - below.keys()):
            there = ", ".join(sorted(options)) or "none"
            raise UsageError(f"{path}: `fleet {' '.join(words)}` has no option {min(unknown)}; it has {there}")
        table |= {options[name].name: _as_text(value) for name, value in values.items() if name in options}
    if unknown := general.keys() - known:
        raise UsageError(f"{path}: {min(unknown)} in [{ALL}] is an option of no command")
    return found


def _check_tables(stated: Mapping[str, Any], group: Any, path: Path) -> None:
    for name, value in stated.items():
        if not isinstance(value, Mapping):
            raise UsageError(f"{path}: {name} must stand in a table: [{ALL}], or that of a command such as [demo]")
        if group is None:
            continue
        if name not in group.commands:
            raise UsageError(f"{path}: there is no command {name}; there are {', '.join(sorted(group.commands))}")
        if hasattr(group.commands[name], "commands"):
            _check_tables(value, group.commands[name], path)


def _as_text(value: Any) -> Any:
    """A value as a command line would have it: what is wrong with it, its option says."""
    if isinstance(value, list):
        return [_as_text(one) for one in value]
    return value if isinstance(value, bool) else str(value)


def commands(group: Any, words: tuple[str, ...] = ()) -> Iterator[Command]:
    """The command itself, and all below it."""
    yield words, group
    for word, command in getattr(group, "commands", {}).items():
        yield from commands(command, (*words, word))


def _options(command: Any) -> Iterator[tuple[str, Any]]:
    for parameter in command.params:
        name = max(parameter.opts, key=len).removeprefix("--")
        if parameter.param_type_name == "option" and name not in _NOT_SET:
            yield name, parameter


def effective(group: Any) -> list[Setting]:
    """The options of all commands, as they are without a command line."""
    stated, path = read(group), file()
    found = []
    for words, command in commands(group):
        own = stated
        for word in words:
            own = own.get(word, {})
        prefix = "_".join([PREFIX, *(word.upper().replace("-", "_") for word in words)])
        context = typer.Context(command, default_map=own, auto_envvar_prefix=prefix)
        for name, option in _options(command):
            value, source = option.consume_value(context, {})
            where = {"ENVIRONMENT": "environment", "DEFAULT_MAP": str(path)}.get(source.name, "default")
            shown = value if isinstance(value, bool | int | float | str | list | tuple) else None
            found.append(Setting(" ".join(["fleet", *words]), name, shown, where, f"{prefix}_{option.name.upper()}"))
    return found
