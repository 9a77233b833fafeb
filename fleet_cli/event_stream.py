"""``fleet events``: what is told of vehicles and services, that which is cached first, then as it comes."""

import queue
import re
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from typing import Final

from fleet_bus import keys
from fleet_bus.errors import MessageError, UsageError
from fleet_bus.messages import Event, EventKind
from fleet_bus.pubsub import Received, declare_recovering_subscriber, query_cache
from fleet_bus.rejections import Rejections
from fleet_bus.sessions import Role, open_session
from fleet_cli import logs
from fleet_cli.live import connected
from fleet_cli.terminal import Output, ReaderGoneError, as_text
from fleet_cli.watch import event_document, event_text
from fleet_view.feed import CACHED_EVENTS

#: Seconds for those who have events in their caches to answer.
CACHE_SECONDS: Final = 1.0
#: Events that are remembered, so as to tell each once.
REMEMBERED: Final = 10_000

_UNITS: Final = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86_400.0}


@dataclass(frozen=True, slots=True)
class Filter:
    """Which events are wanted: of vehicles whose name a pattern fits (None: of services, too), of some kinds (none: of
    all), of those that are cached the ones not before ``since`` (Unix ns)."""

    vehicle: str | None = None
    kinds: frozenset[EventKind] = frozenset()
    since: int = 0

    def wants(self, event: Event, *, cached: bool) -> bool:
        """Whether an event passes. Only what is cached can be too old: clocks differ."""
        if cached and event.t < self.since:
            return False
        if self.kinds and event.kind not in self.kinds:
            return False
        return self.vehicle is None or (event.vehicle is not None and fnmatchcase(event.vehicle, self.vehicle))


def kinds_of(names: Iterable[str]) -> frozenset[EventKind]:
    """Kinds of events by name; raise ``UsageError`` for a name that there is none of."""
    found = set()
    for name in names:
        try:
            found.add(EventKind(name))
        except ValueError:
            raise UsageError(f"--kind {name!r:.40}: choose of {', '.join(EventKind)}") from None
    return frozenset(found)


def since_of(text: str, now: int) -> int:
    """Unix ns of a time span before ``now`` (ns), such as ``90``, ``10min`` or ``2 h``, or of a time in ISO 8601.

    Raises ``UsageError`` for what is neither. A time without an offset is local.
    """
    span = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([a-z]*)\s*", text)
    if span is not None and span[2] in _UNITS and len(span[1]) < 16:
        return now - round(float(span[1]) * _UNITS[span[2]] * 1e9)
    try:
        return round(datetime.fromisoformat(text).astimezone(UTC).timestamp() * 1e9)
    except (ValueError, OverflowError, OSError):
        raise UsageError(
            f"--since {text!r:.40}: write a time span (90, 90s, 10min, 2h, 1d) or a time (2026-01-31T12:00)"
        ) from None


class Reader:
    """Reads events, each once; what cannot be read is counted and told in the log."""

    def __init__(self) -> None:
        self.rejections = Rejections()
        self._known: OrderedDict[tuple[str, bytes], None] = OrderedDict()

    def read(self, received: Received) -> Event | None:
        """An event that has not come before."""
        if (received.key, received.payload) in self._known:
            return None
        self._known[received.key, received.payload] = None
        if len(self._known) > REMEMBERED:
            self._known.popitem(last=False)
        try:
            return Event.decode(received.payload, received.encoding)
        except MessageError as error:
            self.rejections.count(error, received.key)
            return None

    def in_order(self, received: Iterable[Received]) -> list[Event]:
        """Events by their time, each once."""
        return sorted((event for one in received if (event := self.read(one)) is not None), key=lambda event: event.t)


class _Teller:
    """Writes wanted events; ``enough`` once there were as many as asked for."""

    def __init__(self, output: Output, wanted: Filter, count: int | None, json: bool) -> None:
        self._output = output
        self._wanted = wanted
        self._left = count
        self._json = json

    @property
    def enough(self) -> bool:
        return self._left is not None and self._left <= 0

    def tell(self, event: Event, *, cached: bool) -> None:
        if self.enough or not self._wanted.wants(event, cached=cached):
            return
        if self._left is not None:
            self._left -= 1
        if self._json:
            self._output.json({**event_document(event), "cached": cached})
        else:
            self._output.text(as_text(event_text(event, whole=True), terminal=self._output.terminal, whole=True))


def follow_events(
    routers: Sequence[str],
    stop: threading.Event,
    wanted: Filter,
    *,
    count: int | None = None,
    duration: float | None = None,
    json: bool = False,
) -> None:
    """Write events until told to stop, or ``count`` have come, or ``duration`` seconds have passed.

    Raises ``SessionError`` if no router answers.
    """
    deadline = None if duration is None else time.monotonic() + duration
    output, reader = Output(), Reader()
    teller = _Teller(output, wanted, count, json)
    arrived: queue.SimpleQueue[Received] = queue.SimpleQueue()
    with ExitStack() as opened:
        session = opened.enter_context(open_session(Role.VIEWER, routers, stop=stop))
        cached: list[Received] = []
        # Subscribed first: nothing falls between what is cached and what comes.
        for expression, few in ((keys.ALL_EVENTS, False), (keys.ALL_SERVICE_EVENTS, True)):
            opened.enter_context(
                declare_recovering_subscriber(
                    session, expression, arrived.put, history=CACHED_EVENTS, late_publishers=few
                )
            )
            cached += query_cache(session, expression, max_samples=CACHED_EVENTS, timeout=CACHE_SECONDS)
        while not arrived.empty():
            cached.append(arrived.get())
        try:
            for event in reader.in_order(cached):
                teller.tell(event, cached=True)
            lost = _Lost(lambda: connected(session), routers)
            while not (teller.enough or stop.is_set() or (deadline is not None and time.monotonic() >= deadline)):
                output.check()
                lost.look()
                try:
                    event_or_none = reader.read(arrived.get(timeout=0.1))
                except queue.Empty:
                    continue
                if event_or_none is not None:
                    teller.tell(event_or_none, cached=False)
        except ReaderGoneError:
            return


class _Lost:
    """Says on stderr when the router goes and when it is back."""

    def __init__(self, connected: Callable[[], bool], routers: Sequence[str]) -> None:
        self._connected = connected
        self._routers = routers
        self._was = True

    def look(self) -> None:
        there = self._connected()
        if there != self._was:
            where = ", ".join(self._routers)
            logs.warn(f"the router is back at {where}" if there else f"no router answers at {where}: trying on")
        self._was = there
