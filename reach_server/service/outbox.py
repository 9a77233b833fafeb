"""What a server puts on the bus: tubes and events of vehicles, and events about itself."""

from contextlib import ExitStack
from typing import Final

import structlog

from fleet_bus import keys
from fleet_bus.bus import Bus, Publisher
from fleet_bus.clock import Clock
from fleet_bus.messages import Event, EventKind, ReachTube
from fleet_bus.messages import tube as tube_message
from reach_server.data.events import EngineEvent
from reach_server.service.event_limit import EventLimit
from reach_server.service.status import Tally

_log = structlog.get_logger(__name__)

EVENT_CACHE: Final = 32
#: Where tubes are put faster than a link takes them, some are dropped: subscribers fetch them from here.
TUBE_CACHE: Final = 8
LONGEST_MESSAGE: Final = 2000


class Outbox:
    """Publishers by key, made when something is first put; what is put is counted in the tally.

    ``own_events`` publishes what is told of the server itself; it is closed by who made it.
    """

    def __init__(self, instance: str, clock: Clock, tally: Tally, bus: Bus, own_events: Publisher) -> None:
        self._instance = instance
        self._clock = clock
        self._tally = tally
        self._bus = bus
        self._own_events = own_events
        self._limit = EventLimit()
        self._publishers: dict[str, Publisher] = {}

    def put_tube(self, tube: ReachTube, payload: bytes) -> None:
        """Publish the tube of a vehicle, as it was encoded."""
        self._publisher(keys.tube(tube.vehicle), tube_message.ENCODING, TUBE_CACHE).put(payload)
        self._tally.tubes += 1
        key = tube.label, tube.method
        self._tally.by_label[key] = self._tally.by_label.get(key, 0) + 1

    def put_event(self, event: EngineEvent) -> None:
        """Publish an event about a vehicle, unless too many of its kind have come of late."""
        admitted = self._limit.admit(event, self._clock.monotonic())
        if admitted is None:
            self._tally.withheld += 1
            return
        message = Event(
            kind=admitted.kind, vehicle=admitted.vehicle, t=admitted.t, source=self._instance,
            message=admitted.message[:LONGEST_MESSAGE], details=admitted.details,
        )  # fmt: skip
        _log.info("event", kind=str(admitted.kind), vehicle=admitted.vehicle, message=admitted.message)
        self._publisher(keys.event(admitted.vehicle), Event.encoding(), EVENT_CACHE).put(message.encode())
        self._count(admitted.kind)

    def tell(self, kind: EventKind, message: str, details: dict[str, str | int | float | bool]) -> None:
        """Publish an event about the server itself."""
        event = Event(
            kind=kind, t=self._clock.time_ns(), source=self._instance, message=message[:LONGEST_MESSAGE],
            details=details,
        )  # fmt: skip
        _log.warning("event", kind=str(kind), message=message)
        self._own_events.put(event.encode())
        self._count(kind)

    def _count(self, kind: EventKind) -> None:
        self._tally.events += 1
        self._tally.by_kind[kind] += 1

    def forget(self, vehicle: str) -> None:
        """Close the publishers of a vehicle that is not known any more."""
        self._limit.forget(vehicle)
        for key in (keys.tube(vehicle), keys.event(vehicle)):
            if (publisher := self._publishers.pop(key, None)) is not None:
                publisher.close()

    def _publisher(self, key: str, encoding: str, cache: int) -> Publisher:
        publisher = self._publishers.get(key)
        if publisher is None:
            # Dropping would lose tubes in bursts; a patient one waits for the oldest only.
            publisher = self._publishers[key] = self._bus.publisher(key, encoding, cache=cache, patient=True)
        return publisher

    def close(self) -> None:
        """Close the publishers of all vehicles, each even if another one cannot be."""
        with ExitStack() as closing:
            for publisher in reversed(self._publishers.values()):
                closing.callback(publisher.close)
