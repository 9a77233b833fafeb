"""The Zenoh router of a fleet, inside this process."""

import json
import re
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final, Self

import zenoh

from fleet_bus.errors import SessionError, UsageError
from fleet_bus.sessions import DEFAULT_ROUTER, LEASE_MS, check_endpoint, configure

_SETTINGS: Final[dict[str, Any]] = {
    "scouting/delay": 0,
    # Peers that find each other bypass the router, and with it the access control.
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "timestamping/enabled": True,
    "timestamping/drop_future_timestamp": False,
    "adminspace/enabled": True,
    "adminspace/permissions": {"read": True, "write": False},
    # With shared memory on, a router refuses session 352.
    "transport/shared_memory/enabled": False,
    "transport/unicast/max_sessions": 10_000,
    "transport/link/tx/lease": LEASE_MS,
}
_PLACE_IN_SOURCE: Final = re.compile(r" at \S+\.rs:\d+\.?")
_WRAPPED: Final = re.compile(r'msg: "(?P<message>.*)", .*line: (?P<line>\d+), column: (?P<column>\d+)')
_IN_USE: Final = re.compile(r"bound to \w+/(?P<host>\S+):(?P<port>\d+): .*[Aa]ddress already in use")


class Router:
    """A running router, until ``close`` or the end of its ``with`` block; the port is free again at once.

    Listens on ``listen``, by default ``DEFAULT_ROUTER``; port 0 takes a free one. ``config_file`` is a
    configuration as zenohd reads it (JSON5, JSON or YAML); with one, ``listen`` left out means what the file
    says. Wherever the file leaves a setting at Zenoh's default, the fleet's own applies: no scouting, no
    shared memory, 10 000 sessions, a lease of 2 s, an admin space that can be read.

    ``warn`` is told each of ``warnings`` before it starts.

    Raises ``UsageError`` for a malformed endpoint or a file that cannot be read or is not a router's,
    ``SessionError`` if it cannot listen.
    """

    def __init__(
        self,
        listen: Sequence[str] | None = None,
        *,
        config_file: Path | None = None,
        warn: Callable[[str], object] | None = None,
    ) -> None:
        config = zenoh.Config() if config_file is None else _read(config_file)
        if listen is None and config_file is None:
            listen = (DEFAULT_ROUTER,)
        if listen is not None:
            configure(config, {"listen/endpoints": [check_endpoint(endpoint) for endpoint in listen]})
        defaults = zenoh.Config()
        untouched = {k: v for k, v in _SETTINGS.items() if config.get_json(k) == defaults.get_json(k)}
        configure(config, untouched | {"mode": "router"})
        self.warnings: tuple[str, ...] = _warnings(config)
        """What the file asks for and does not get, or will regret; one sentence each."""
        if warn is not None:
            for warning in self.warnings:
                warn(warning)
        try:
            session = zenoh.open(config)
        except zenoh.ZError as error:
            raise _cannot_listen(error) from error
        with ExitStack() as opening:
            opening.enter_context(session)
            self.endpoints: tuple[str, ...] = _locators(session) or _configured_endpoints(config)
            """Where it listens; port 0 is resolved unless the file closes the admin space or sets a namespace."""
            self._open = opening.pop_all()

    def close(self) -> None:
        """Stop routing and listening; closing again does nothing."""
        self._open.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()


def _read(file: Path) -> zenoh.Config:
    try:
        config = zenoh.Config.from_file(file)
    except zenoh.ZError as error:
        raise UsageError(f"router configuration {file}: {_reason(error)}") from error
    mode = json.loads(config.get_json("mode"))
    if mode not in (None, "router"):
        raise UsageError(f"router configuration {file}: mode is {mode!r}: write 'router' or leave it out")
    return config


def _warnings(config: zenoh.Config) -> tuple[str, ...]:
    found = []
    plugins = json.loads(config.get_json("plugins"))
    if plugins:
        found.append(
            f"plugins ({', '.join(plugins)}) are ignored: this router loads none; run zenohd with the file to have them"
        )
    starving = [
        rule["key_expr"]
        for group in json.loads(config.get_json("downsampling"))
        for rule in group["rules"]
        if "*" in rule["key_expr"]
    ]
    if starving:
        found.append(
            f"downsampling of {', '.join(starving)} is one rate for all keys together: of several vehicles, only the "
            "first is heard; thin where it is put instead"
        )
    return tuple(found)


def _locators(session: zenoh.Session) -> tuple[str, ...]:
    for reply in session.get(f"@/{session.zid()}/router"):
        if reply.ok is not None:
            return tuple(json.loads(reply.ok.payload.to_bytes())["locators"])
    return ()


def _configured_endpoints(config: zenoh.Config) -> tuple[str, ...]:
    endpoints = json.loads(config.get_json("listen/endpoints"))
    return tuple(endpoints["router"] if isinstance(endpoints, dict) else endpoints)


def _cannot_listen(error: zenoh.ZError) -> SessionError:
    in_use = _IN_USE.search(str(error))
    if in_use is None:
        return SessionError(f"the router cannot start: {_reason(error)}")
    return SessionError(
        f"port {in_use['port']} on {in_use['host']} is in use: stop the other router, or choose another with --port"
    )


def _reason(error: zenoh.ZError) -> str:
    """What Zenoh says, without its wrappings and the places in its source."""
    text = _PLACE_IN_SOURCE.sub("", str(error)).strip()
    wrapped = _WRAPPED.search(text)
    if wrapped is None:
        return text
    return f"line {wrapped['line']}, column {wrapped['column']}: {wrapped['message']}"
