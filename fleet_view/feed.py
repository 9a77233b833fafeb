"""From the bus into a ``FleetView``: what arrives waits in a queue of bounded length, and is read when asked to."""

import threading
from collections import deque
from contextlib import ExitStack
from typing import Final, Self

import zenoh

from fleet_bus import keys
from fleet_bus.clock import SYSTEM, Clock
from fleet_bus.errors import KeyIdError, MessageError
from fleet_bus.messages import Event, ReachTube, ServiceStatus, StateFlag, VehicleProfile, decode_states
from fleet_bus.pubsub import Received, declare_recovering_subscriber, subscribe
from fleet_view.traffic import kind_of
from fleet_view.view import FleetView

#: Messages that wait to be read at most; more are counted as refused (``overflow``).
MOST_WAITING: Final = 100_000
#: Tubes that are all read when they are taken in together; of more, the newest of each key only.
MOST_TUBES: Final = 2000
#: Events that a publisher keeps for who comes late.
CACHED_EVENTS: Final = 32

Arrived = tuple[float, Received]


class Feed:
    """Keeps a view up to date while its ``with`` block lasts: ``arrived`` on the bus's thread, ``take_in`` on yours.

    Rare messages come from caches, so that nothing depends on who was started first; states and tubes from now on.
    """

    def __init__(self, view: FleetView, clock: Clock = SYSTEM) -> None:
        self.view = view
        self._clock = clock
        self._waiting: deque[Arrived] = deque()
        self._lost = 0
        self._lock = threading.Lock()
        self._open = ExitStack()

    def connect(self, session: zenoh.Session) -> Self:
        """Subscribe on a session; to be closed with ``close`` or by a ``with`` block."""
        with ExitStack() as opening:
            for expression, history, late in (
                (keys.ALL_PROFILES, 1, False),
                (keys.ALL_EVENTS, CACHED_EVENTS, False),
                (keys.ALL_SERVICE_EVENTS, CACHED_EVENTS, True),
                (keys.ALL_STATUS, 1, True),
            ):
                opening.enter_context(
                    declare_recovering_subscriber(
                        session, expression, self.arrived, history=history, late_publishers=late
                    )
                )
            for expression in (keys.ALL_STATES, keys.ALL_TRUTHS, keys.ALL_TUBES, keys.ALL_DOCUMENTS):
                opening.enter_context(subscribe(session, expression, self.arrived))
            opening.enter_context(subscribe(session, keys.ALL_ASSIGNMENTS, self.arrived))
            self._open = opening.pop_all()
        return self

    def close(self) -> None:
        """Hear no more."""
        self._open.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def arrived(self, received: Received) -> None:
        """A message came; it is looked at by ``take_in``."""
        if len(self._waiting) >= MOST_WAITING:
            with self._lock:
                self._lost += 1
            return
        self._waiting.append((self._clock.monotonic(), received))

    def take_in(self) -> int:
        """Read what has arrived since the last time; how many messages that were."""
        now = self._clock.monotonic()
        came: list[Arrived] = []
        while self._waiting and len(came) < MOST_WAITING:
            came.append(self._waiting.popleft())
        with self._lock:
            lost, self._lost = self._lost, 0
        for _ in range(lost):
            self.view.refuse(MessageError("overflow", "more came than could be kept until it was read"), "", now)
        states: list[Arrived] = []
        tubes: list[Arrived] = []
        for at, received in came:
            self.view.count(received.key, len(received.payload), at)
            kind = kind_of(received.key)
            if kind == "state":
                states.append((at, received))
            elif kind == "tube":
                tubes.append((at, received))
            else:
                self._read(kind, at, received)
        self._read_states(states)
        if len(tubes) > MOST_TUBES:
            newest = {received.key: (at, received) for at, received in tubes}
            self.view.skip(len(tubes) - len(newest))
            tubes = sorted(newest.values(), key=lambda one: one[0])
        for at, received in tubes:
            self._read("tube", at, received)
        return len(came)

    def _read(self, kind: str, at: float, received: Received) -> None:
        try:
            self._take(kind, at, received)
        except MessageError as error:
            self.view.refuse(error, received.key, at)
        except KeyIdError as error:
            self.view.refuse(MessageError("key", str(error)), received.key, at)

    def _take(self, kind: str, at: float, received: Received) -> None:
        payload, encoding = received.payload, received.encoding
        if kind == "tube":
            vehicle = keys.vehicle_of(received.key)
            tube = ReachTube.decode(payload, encoding)
            if tube.vehicle != vehicle:
                raise MessageError("fields", f"a tube of {tube.vehicle} on the key of {vehicle}")
            self.view.tube(tube, at)
        elif kind == "status":
            self.view.status(ServiceStatus.decode(payload, encoding), at)
        elif kind == "event":
            self.view.event(Event.decode(payload, encoding))
        elif kind == "profile":
            self.view.profile(keys.vehicle_of(received.key), VehicleProfile.decode(payload, encoding), at)

    def _read_states(self, arrived: list[Arrived]) -> None:
        if not arrived:
            return
        payloads = [received.payload for _, received in arrived]
        batches, refused = decode_states(payloads, [received.encoding for _, received in arrived])
        for index, error in refused:
            self.view.refuse(error, arrived[index][1].key, arrived[index][0])
        for batch in batches:
            live = batch.index[(batch.flags & int(StateFlag.HISTORY)) == 0]
            vehicles, times = [], []
            for index in live.tolist():
                at, received = arrived[index]
                try:
                    vehicles.append(keys.vehicle_of(received.key))
                except KeyIdError as error:
                    self.view.refuse(MessageError("key", str(error)), received.key, at)
                else:
                    times.append(at)
            self.view.samples(vehicles, times)
