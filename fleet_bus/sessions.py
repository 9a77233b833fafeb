"""Opening Zenoh sessions: one configuration per role in the fleet, with errors a person can act on."""

import json
import re
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from enum import StrEnum
from typing import Any, Final

import zenoh

from fleet_bus import tls
from fleet_bus.errors import SessionError, Stopped, UsageError

DEFAULT_ROUTER: Final = "tcp/127.0.0.1:7447"

# Each end announces the lease under which the other may give it up, so sessions and routers carry the same
# one: a frozen or cut-off vehicle is gone after 2 s instead of Zenoh's 10.
LEASE_MS: Final = 2000

_SOCKET_ENDPOINT: Final = re.compile(
    r"(tcp|udp|tls|quic|ws)/(\[[^\s\[\]]+\]|[^\s/:\[\]?#]+):(?P<port>[0-9]{1,5})([?#]\S*)?"
)
_PATH_ENDPOINT: Final = re.compile(r"unixsock-stream/\S+")


class Role(StrEnum):
    """What a process is on the bus; it decides how its session behaves without a router."""

    AGENT = "agent"
    SERVICE = "service"
    VIEWER = "viewer"


def check_endpoint(endpoint: str) -> str:
    """Return ``endpoint`` unchanged if Zenoh can connect to or listen on it; raise ``UsageError`` otherwise.

    Zenoh itself accepts ``tcp/127.0.0.1`` or ``tcp/host:abc`` and then retries for ever in silence.
    """
    socket = _SOCKET_ENDPOINT.fullmatch(endpoint)
    if (socket is not None and int(socket["port"]) < 2**16) or _PATH_ENDPOINT.fullmatch(endpoint) is not None:
        return endpoint
    raise UsageError(f"{endpoint!r:.120} is not an endpoint: write <protocol>/<host>:<port>, such as {DEFAULT_ROUTER}")


def configure(config: zenoh.Config, settings: Mapping[str, Any]) -> None:
    """Write ``settings`` (Zenoh's configuration path to JSON value) into ``config``; may raise ``ZError``."""
    for path, value in settings.items():
        config.insert_json5(path, json.dumps(value))


def open_session(
    role: Role,
    routers: Sequence[str] = (DEFAULT_ROUTER,),
    *,
    namespace: str | None = None,
    scouting: bool = False,
    timeout: float = 5.0,
    stop: threading.Event | None = None,
) -> zenoh.Session:
    """Open session of ``role``, to be closed by the caller (it is a context manager).

    An agent opens at once, router or not, and connects to every router of ``routers`` as soon as it is there:
    what it put meanwhile waits in its caches. It does not hear other agents, since a router passes nothing
    from peer to peer. A service or viewer waits up to ``timeout`` seconds for the first router that answers, or
    until ``stop`` is set. Each comes back by itself after a router has been away, with all that it declared.

    Connected to two routers that are linked to each other, an agent's samples arrive twice at readers that do not
    recover: name several routers to an agent only where these are not linked.

    ``namespace`` is a prefix that this session adds to each key it sends and strips from each key it
    receives. ``scouting`` also looks for others by multicast and gossip, for a lab bench: what is found that
    way bypasses the access control of the routers named here.

    Raises ``UsageError`` for a malformed endpoint or namespace, ``SessionError`` if no router answers, if one answers
    and TLS fails (the message says which, and why) and for certificates that cannot be used, ``Stopped`` if ``stop``
    was set before.
    """
    endpoints = [check_endpoint(router) for router in routers]
    settings: dict[str, Any] = {
        "connect/endpoints": endpoints,
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2},
        "scouting/delay": 0,
        "scouting/multicast/enabled": scouting,
        "scouting/gossip/enabled": scouting,
        "timestamping/enabled": True,
        "transport/link/tx/lease": LEASE_MS,
        # Otherwise 16 MiB are reserved at the first put of 3 KiB, by each session.
        "transport/shared_memory/enabled": False,
    }
    for endpoint in endpoints:
        tls.check_files(endpoint)
    if role is Role.AGENT:
        settings |= {"mode": "peer", "listen/endpoints": []}
    else:
        # With a timeout of its own, Zenoh would spend all of it on the first router; with 0 it tries each
        # once. A router that accepts and is mute would cost 10 s, unless the time to open is bounded too.
        share = max(500, round(1000 * timeout / max(1, len(endpoints))))
        settings |= {"mode": "client", "connect/timeout_ms": 0, "transport/unicast/open_timeout": share}
    config = zenoh.Config()
    configure(config, settings)
    if namespace is not None:
        try:
            configure(config, {"namespace": namespace})
        except zenoh.ZError:
            raise UsageError(f"{namespace!r:.80} is not a namespace: write such as 'site/lab'") from None
    if stop is not None and stop.is_set():
        raise Stopped("told to end before a session was opened")
    if role is Role.AGENT:
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            raise SessionError(f"no session can be opened: {error}") from error
    return _open_client(config, endpoints, timeout, threading.Event() if stop is None else stop)


def why_not_connected(session: zenoh.Session, routers: Sequence[str]) -> str | None:
    """Why an agent's session, which opens without a router, has none of ``routers``; None if it has one."""
    return None if list(session.info.routers_zid()) else _no_router(routers)


def _open_client(config: zenoh.Config, routers: Sequence[str], timeout: float, stop: threading.Event) -> zenoh.Session:
    deadline = time.monotonic() + timeout
    while True:
        if stop.is_set():
            raise Stopped("told to end before a router answered")
        try:
            return _Attempt(config).result(stop)
        except zenoh.ZError as error:
            if time.monotonic() >= deadline:
                raise SessionError(_no_router(routers)) from error
        stop.wait(0.1)


def _no_router(routers: Sequence[str]) -> str:
    # Zenoh says the same of a router that is not there and of a certificate that it refuses.
    failures = [failure for failure in map(tls.failure, routers) if failure is not None]
    if failures:
        return "; ".join(failures)
    return (
        f"no router answers at {', '.join(routers) or 'any address'}: start one with "
        "`fleet router`, or name the right one with --router"
    )


class _Attempt:
    """One call of ``zenoh.open`` in a thread: it can take seconds, in which the main thread must see signals."""

    def __init__(self, config: zenoh.Config) -> None:
        self._config = config
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._given_up = False
        self._session: zenoh.Session | None = None
        self._error: BaseException | None = None

    def result(self, stop: threading.Event) -> zenoh.Session:
        """The session; raise what ``zenoh.open`` raised, or ``Stopped``. A session that comes too late is closed."""
        threading.Thread(target=self._open, name="open session", daemon=True).start()
        try:
            while not self._over.wait(0.02):
                if stop.is_set():
                    raise Stopped("told to end before a router answered")
        except BaseException:
            with self._lock:
                self._given_up = True
                if self._session is not None:
                    self._session.close()  # type: ignore[no-untyped-call]
            raise
        if self._error is not None:
            raise self._error
        assert self._session is not None
        return self._session

    def _open(self) -> None:
        try:
            session = zenoh.open(self._config)
        except BaseException as error:
            self._error = error
        else:
            with self._lock:
                self._session = session
                late = self._given_up
            if late:
                with suppress(zenoh.ZError):
                    session.close()  # type: ignore[no-untyped-call]
        self._over.set()
