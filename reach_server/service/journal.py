"""What a server does to its fleet, noted round by round, with a chain over all that came in and went out.

Everything between the bus and the bus is a function of the messages, of their order and of the times that are handed
in. A journal names the messages and has the rest, so that its rounds can be computed anew (``replay``).
"""

from collections.abc import Callable, Sequence
from hashlib import blake2b
from itertools import chain as chained
from typing import Final

import msgpack
import numpy as np
import structlog

from fleet_bus.errors import MessageError
from fleet_bus.messages import JournalRound, ReachTube
from fleet_bus.messages.journal import (
    BEGINNING,
    DIGEST,
    MOST_CALLS,
    MOST_LISTED,
    Call,
    digest_of,
    link,
    tube_digest,
)
from fleet_bus.messages.ranges import LISTED
from fleet_bus.pubsub import Received
from reach_server.data.events import EngineEvent
from reach_server.service.build import build

_log = structlog.get_logger(__name__)

#: Rounds without any input after which one is written down all the same: about a second.
MOST_IDLE: Final = 50
#: Samples, and tubes, in a message where a round speaks about more vehicles than a message lists.
CROWDED: Final = int(LISTED.high) // 2
#: What the name of an error begins with that the fleet itself has raised.
IN_FLEET: Final = "fleet: "


def event_digest(event: EngineEvent) -> bytes:
    """Digest of what an event says, before too many of its kind are held back."""
    details = list(chained.from_iterable(event.details.items()))
    packed = msgpack.packb([str(event.kind), event.vehicle, event.t, event.message, details])
    return blake2b(packed, digest_size=DIGEST).digest()


def failure(error: Exception, *, inside: bool) -> str:
    """How a journal names an error; one that the fleet raises is raised again when its rounds are computed anew."""
    return f"{IN_FLEET if inside else ''}{type(error).__name__}"


class Journal:
    """The rounds of a server that ``started`` (Unix ns), as messages for ``put``.

    ``begin`` and ``end`` enclose a round, and what the server does to its fleet in between goes through here. The
    chain is kept all the time, ``put`` may drop what nobody wants.
    """

    def __init__(self, server: str, started: int, put: Callable[[bytes], object]) -> None:
        self._server = server
        self._started = started
        self._put = put
        self._build = build()
        self.chain = BEGINNING
        #: Rounds that were written down, and samples, tubes and events in them.
        self.number = 0
        self.totals = (0, 0, 0)
        #: Time of the round (Unix ns): that of all events that no sample tells the time of.
        self.stamp = 1
        self._now = 0.0
        self._open = False
        self._idle: list[float] = []
        self._clear()

    def _clear(self) -> None:
        self._calls: list[Call] = []
        self._taken: list[tuple[str, Received]] = []
        self._tubes: list[tuple[str, int, int]] = []
        self._tube_digests: list[bytes] = []
        self._event_digests: list[bytes] = []
        self._note = self._failed = ""
        #: Whether the fleet is at work.
        self._inside = False

    def begin(self, now: float, stamp: int) -> None:
        """A round begins at ``now`` (s, of a clock that never goes back), ``stamp`` (Unix ns)."""
        self.end()
        self._open, self._now, self.stamp = True, now, stamp

    def document(self, kind: str, item: Received, work: Callable[[], list[EngineEvent]]) -> list[EngineEvent]:
        """Note that a message is taken in, and what happens by it; raises what ``work`` does."""
        digest = digest_of(item.payload, item.encoding).hex()
        self._calls.append(Call(kind, self._now, item.key, item.source, digest))
        return self._done(work)

    def hear(self, source: str) -> None:
        """Note that a side-info service was heard."""
        self._calls.append(Call("hear", self._now, source=source))

    def process(self, taken: list[tuple[str, Received]]) -> None:
        """Note that samples are taken in, each with its vehicle, in this order."""
        self._calls.append(Call("process", self._now))
        self._taken, self._inside = taken, True

    def processed(self, events: Sequence[EngineEvent], note: str | None) -> None:
        """Note what happened by the samples, and what their tubes say of the server's load."""
        self._inside = False
        self._told(events)
        self._note = note or ""

    def tube(self, tube: ReachTube, payload: bytes) -> None:
        """Note a tube."""
        self._tubes.append((tube.vehicle, tube.epoch, tube.seq))
        self._tube_digests.append(tube_digest(payload))

    def elapse(self, work: Callable[[], list[EngineEvent]]) -> list[EngineEvent]:
        """Note that time passes, and what happens by it; raises what ``work`` does."""
        self._calls.append(Call("elapse", self._now))
        return self._done(work)

    def gone(self, vehicle: str) -> None:
        """Note that a vehicle was found gone."""
        self._calls.append(Call("gone", self._now, vehicle))

    def let_go(self, now: float) -> None:
        """Note that vehicles that were silent for long are forgotten, at ``now`` (s)."""
        self._calls.append(Call("let_go", now))

    def fail(self, error: Exception) -> None:
        """Note that an error ends the round, and whether the fleet itself raised it."""
        self._failed = failure(error, inside=self._inside)

    def _done(self, work: Callable[[], list[EngineEvent]]) -> list[EngineEvent]:
        self._inside = True
        try:
            events = work()
        except MessageError:
            self._inside = False
            raise
        self._inside = False
        return self._told(events)

    def _told(self, events: Sequence[EngineEvent]) -> list[EngineEvent]:
        self._event_digests += map(event_digest, events)
        return list(events)

    def end(self) -> None:
        """The round is over: it is written down, unless nothing but time came and went."""
        if not self._open:
            return
        self._open = False
        idle = len(self._calls) == 1 and self._calls[0].kind == "elapse" and not (self._event_digests or self._failed)
        try:
            if idle and len(self._idle) < MOST_IDLE:
                self._idle.append(self._now)
            else:
                self._write()
        finally:
            self._clear()

    def flush(self) -> None:
        """Between rounds: write down those without any input that are not yet."""
        if self._idle:
            self._write()

    def _write(self) -> None:
        self.number += 1
        try:
            self._write_parts()
        except MessageError as error:
            # The gap in the numbers tells that this round cannot be computed anew; the service goes on.
            _log.warning("a round could not be written down", round=self.number, error=str(error))
        finally:
            self._idle = []

    def _write_parts(self) -> None:
        came = len(self._taken), len(self._tubes), len(self._event_digests)
        samples, tubes, events = self.totals = (
            self.totals[0] + came[0], self.totals[1] + came[1], self.totals[2] + came[2],
        )  # fmt: skip
        names = {vehicle for vehicle, _ in self._taken}.union(vehicle for vehicle, _, _ in self._tubes)
        sessions = {received.source for _, received in self._taken}
        step = MOST_LISTED if max(len(names), len(sessions)) <= LISTED.high else CROWDED
        parts = max(1, *(-(-n // step) for n in came), -(-len(self._calls) // MOST_CALLS))
        for part in range(parts):
            taken, made = self._taken[part * step : (part + 1) * step], self._tubes[part * step : (part + 1) * step]
            vehicles = _places([*(vehicle for vehicle, _ in taken), *(vehicle for vehicle, _, _ in made)])
            sources = _places([received.source for _, received in taken])
            message = JournalRound(
                self._server, self._started, self._build, self.number, self._now, self.stamp, (part + 1, parts),
                np.array(self._idle if part == 0 else [], dtype="<f8"), tuple(vehicles), tuple(sources),
                tuple(self._calls[part * MOST_CALLS : (part + 1) * MOST_CALLS]),
                np.array([vehicles[vehicle] for vehicle, _ in taken], dtype="<u2"),
                np.array([sources[received.source] for _, received in taken], dtype="<u2"),
                np.array([received.arrived_ns for _, received in taken], dtype="<i8"),
                b"".join([digest_of(received.payload, received.encoding) for _, received in taken]),
                np.array([vehicles[vehicle] for vehicle, _, _ in made], dtype="<u2"),
                np.array([epoch for _, epoch, _ in made], dtype="<i8"),
                np.array([seq for _, _, seq in made], dtype="<i8"),
                b"".join(self._tube_digests[part * step : (part + 1) * step]),
                b"".join(self._event_digests[part * step : (part + 1) * step]),
                self._note, self._failed, (samples, tubes, events),
            )  # fmt: skip
            payload = message.encode()
            self.chain = link(self.chain, payload)
            self._put(payload[: -len(self.chain)] + self.chain.encode())

    def summary(self) -> dict[str, str]:
        """What a status tells of the journal."""
        samples, tubes, events = self.totals
        counts = {"round": self.number, "samples": samples, "tubes": tubes, "events": events}
        return {"value": self.chain, **{name: str(count) for name, count in counts.items()}, "build": self._build}


def _places(names: list[str]) -> dict[str, int]:
    """The different ones of some names, each with its place among them."""
    return {name: place for place, name in enumerate(dict.fromkeys(names))}
