"""The systemd units of the project, read as systemd reads them."""

import shlex
from configparser import RawConfigParser
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
DEPLOY = ROOT / "deploy"
#: Where the units expect the command and its configuration.
COMMAND = "/opt/fleet-reach/.venv/bin/fleet"
CONFIGURATION = "/etc/fleet-reach"


@dataclass(frozen=True)
class Unit:
    """A unit file: ``text`` as it is, ``service`` the settings of its section [Service]."""

    path: Path
    text: str
    service: dict[str, str]

    @property
    def arguments_variable(self) -> str:
        """Name of the variable with more arguments of its command."""
        return self.service["ExecStart"].rpartition("$")[2]

    def command(self, arguments: str = "", *, instance: str = "svea1", host: str = "host") -> list[str]:
        """Words of its command line, with ``arguments`` in its variable; systemd leaves out one that is not set."""
        line = self.service["ExecStart"].replace(f"${self.arguments_variable}", arguments)
        return shlex.split(line.replace("%i", instance).replace("%H", host))


def units() -> list[Unit]:
    """All of them, by name."""
    found = []
    for path in sorted((DEPLOY / "systemd").glob("*.service")):
        parser = RawConfigParser(delimiters="=", comment_prefixes="#", strict=True)
        parser.optionxform = str  # type: ignore[assignment,method-assign]
        text = path.read_text(encoding="utf-8")
        parser.read_string(text)
        found.append(Unit(path, text, dict(parser["Service"])))
    return found
