"""The bus, read once for all who look: messages in, a new picture ten times a second."""

import threading
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Final, Self

import numpy as np
import structlog

from fleet_bus import keys
from fleet_bus.bus import Bus, Handle
from fleet_bus.clock import SYSTEM, Clock
from fleet_bus.errors import KeyIdError, MessageError
from fleet_bus.messages import Assignment, Event, ScenarioDocument, ServiceStatus, VehicleProfile
from fleet_bus.messages.state import decode_states
from fleet_bus.pubsub import Received
from fleet_bus.rejections import Rejections
from fleet_dashboard.history import History, Series
from fleet_dashboard.inbox import Inbox
from fleet_dashboard.picture import Mark, Picture, nothing
from fleet_dashboard.regions import Regions, RegionStore
from fleet_dashboard.services import Services
from fleet_dashboard.table import VehicleTable, arrivals
from fleet_dashboard.timeline import ASSUMED, EventLog, Obligations
from fleet_dashboard.tube_batch import decode_tubes

_log = structlog.get_logger(__name__)

#: Seconds between two pictures.
TICK: Final = 0.1
#: Later than all times, ns.
_EVER: Final = 2**63 - 1

#: Subscribes to what is put from now on.
Subscribe = Callable[[str, Callable[[Received], None]], Handle]


class Gateway:
    """What the page knows. ``feed`` may be called from any thread; ``tick`` from one at a time."""

    def __init__(
        self,
        clock: Clock = SYSTEM,
        *,
        draw: Callable[[str], Regions] | None = None,
        history: History | None = None,
        series: Series | None = None,
    ) -> None:
        self.clock = clock
        self.rejections = Rejections()
        self.table = VehicleTable()
        self.services = Services()
        self.events = EventLog()
        self.obligations = Obligations()
        self.history = History() if history is None else history
        self.series = Series() if series is None else series
        self.regions = RegionStore(draw)
        self.profiles: dict[str, VehicleProfile] = {}
        self.newest_state: dict[str, Received] = {}
        self.newest_tube: dict[str, Received] = {}
        #: Scenario and predicate that cut the newest tube of each vehicle, with the first and last step.
        self.cuts: dict[str, list[tuple[str, str, int, int]]] = {}
        self._verdicts: dict[str, Mapping[str, str]] = {}
        self.picture: Picture = nothing()
        self.connected: Callable[[], bool] = lambda: True
        self._number = 0
        self._inbox = Inbox(self.rejections)
        self._tokens: deque[tuple[str, bool, int]] = deque()
        self._counts: Counter[str] = Counter()
        self._rated = 0
        #: Why ticks fail, empty while they do not.
        self.failed = ""
        self._acting: frozenset[tuple[str, str]] = frozenset()
        self._acting_at = 0
        self._open = ExitStack()

    # Reading the bus

    def listen(self, bus: Bus, subscribe: Subscribe) -> Self:
        """Read a bus until ``close``: what is rare from its caches on, streams by ``subscribe`` from now on."""
        with ExitStack() as opening:
            for expression in (keys.ALL_PROFILES, keys.ALL_DOCUMENTS, keys.ALL_ASSIGNMENTS, keys.ALL_STATUS):
                opening.enter_context(bus.subscriber(expression, self.feed, history=1))
            for expression in (keys.ALL_EVENTS, keys.ALL_SERVICE_EVENTS):
                opening.enter_context(bus.subscriber(expression, self.feed, history=32))
            opening.enter_context(bus.watch_alive("svc/*/*", self._token))
            for expression in (keys.ALL_STATES, keys.ALL_TUBES):
                opening.enter_context(subscribe(expression, self.feed))
            self._open = opening.pop_all()
        return self

    def close(self) -> None:
        """Stop reading the bus."""
        self._open.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def feed(self, received: Received) -> None:
        """A message, from the bus or from a recording; it is looked at with the next tick."""
        self._inbox.put(received)

    def _token(self, key: str, alive: bool) -> None:
        self._tokens.append((key, alive, self.clock.time_ns()))

    # Making pictures

    def run(self, stop: threading.Event) -> None:
        """Tick until told to stop."""
        while not self.clock.wait(stop, TICK):
            try:
                self.tick(self.clock.time_ns())
                self.failed = ""
            except Exception as error:
                # The next tick may do better. What is shown stands still until then, which clients are told.
                what = f"{type(error).__name__}: {error}"
                if what != self.failed:
                    _log.error("a tick of the page failed", error=what[:500])
                self.failed = what

    def tick(self, now: int) -> Picture:
        """Look at what has come, and make the picture of ``now`` (ns)."""
        came = self._inbox.take()
        self._counts["tubes"] += came.tubes_came
        for message in came.others:
            self._checked(message, self._rare)
        self._states(came.states)
        stacks = came.tubes
        while stacks:
            # Of a vehicle the newest tube is read; where that is refused, the one before it.
            refused = self._tube_messages([stack.pop() for stack in stacks])
            stacks = [stacks[i] for i in refused if stacks[i]]
        # After the messages: the last status of a service that is gone came before its token went.
        while self._tokens:
            self.services.token(*self._tokens.popleft())
        self._number += 1
        picture = self.table.picture(self._number, now, self.services.silent_servers(now))
        self.picture = replace(picture, acting=self._acting_in(picture))
        self.history.add(self.picture)
        self._rates(now)
        return self.picture

    def _rates(self, now: int) -> None:
        seconds = (now - self._rated) / 1e9
        if 0 <= seconds < 1:
            return
        counts, self._counts = self._counts, Counter()
        if self._rated and seconds > 0:
            self.series.add(self.picture, counts["samples"] / seconds, counts["tubes"] / seconds)
        self._rated = now

    def _acting_in(self, picture: Picture) -> frozenset[tuple[str, str]]:
        if 0 <= picture.t - self._acting_at < 1_000_000_000:
            return self._acting
        self._acting_at = picture.t
        fresh = {picture.ids[row] for row in np.flatnonzero(~picture.stale()).tolist()}
        self._acting = frozenset(
            (scenario, predicate)
            for vehicle, cuts in self.cuts.items()
            if vehicle in fresh
            for scenario, predicate, *_ in cuts
        )
        return self._acting

    def _checked(self, message: Received, handle: Callable[[Received], None]) -> None:
        try:
            handle(message)
        except MessageError as error:
            self.rejections.count(error, message.key)
        except KeyIdError as error:
            self.rejections.count(MessageError("key", str(error)), message.key)

    def _rare(self, message: Received) -> None:
        chunks = message.key.split("/")
        match chunks:
            case ["svc", kind, instance, "status"]:
                status = ServiceStatus.decode(message.payload, message.encoding)
                _named(message, (kind, instance), (status.kind, status.instance))
                self.services.status(status, message.arrived_ns)
            case ["reach", *vehicle, "event"] | ["svc", _, _, *vehicle, "event"]:
                event = Event.decode(message.payload, message.encoding)
                _named(message, tuple(vehicle), () if event.vehicle is None else (event.vehicle,))
                if self.events.add(event, message.arrived_ns):
                    self.obligations.event(event, message.arrived_ns)
                    if event.vehicle is not None:
                        self._astray(event.vehicle)
            case ["fleet", _, "profile"]:
                vehicle = keys.vehicle_of(message.key)
                profile = VehicleProfile.decode(message.payload, message.encoding)
                if self.table.profile(vehicle, profile):
                    self.profiles[vehicle] = profile
            case ["spec", _, "document"]:
                self.regions.document(ScenarioDocument.decode(message.payload, message.encoding))
            case ["spec", scenario, "assignment", vehicle]:
                assignment = Assignment.decode(message.payload, message.encoding)
                _named(message, (scenario, vehicle), (assignment.scenario, assignment.vehicle))
                self.table.row(vehicle)
                t = min(assignment.time_zero, message.arrived_ns)
                self.obligations.assigned(vehicle, scenario, assignment.active, t)
                self._astray(vehicle)
            case ["fleet", _, "truth"]:
                # What only a simulator knows is in recordings, too.
                pass
            case _:
                raise MessageError("key", f"nothing is read from {message.key:.120}")

    def _astray(self, vehicle: str) -> None:
        marks = Mark(0)
        for broken in self.obligations.contradicted(vehicle, _EVER):
            marks |= Mark.LEFT if broken.obligation.endswith(ASSUMED) else Mark.VIOLATES
        if marks or self.table.find(vehicle) is not None:
            self.table.astray(vehicle, marks)

    def _states(self, messages: Sequence[Received]) -> None:
        batches, refused = decode_states([m.payload for m in messages], [m.encoding for m in messages])
        for index, error in refused:
            self.rejections.count(error, messages[index].key)
        for batch in batches:
            rows = np.array([self._row_of(messages[i]) for i in batch.index.tolist()], dtype=np.intp)
            self.table.states(rows, batch, arrivals(messages, batch.index))
            self._counts["samples"] += len(rows)
            for i, row in zip(batch.index.tolist(), rows.tolist(), strict=True):
                if row >= 0:
                    self.newest_state[messages[i].key] = messages[i]

    def _row_of(self, message: Received) -> int:
        try:
            row = self.table.row(keys.vehicle_of(message.key))
        except KeyIdError as error:
            self.rejections.count(MessageError("key", str(error)), message.key)
            return -1
        if row < 0:
            self.rejections.count(MessageError("overflow", "more vehicles than the page keeps"), message.key)
        return row

    def _tube_messages(self, messages: Sequence[Received]) -> list[int]:
        """Take in tubes, of each vehicle one; places of those that are refused."""
        batches, refused = decode_tubes(messages)
        servers: dict[str, int] = {}
        for index, error in refused:
            self.rejections.count(error, messages[index].key)
        for batch in batches:
            newer = self.table.tubes(batch, arrivals(messages, batch.index))
            for i in np.flatnonzero(newer).tolist():
                fields, vehicle, message = batch.fields[i], batch.vehicles[i], messages[int(batch.index[i])]
                self.newest_tube[vehicle] = message
                self.cuts[vehicle] = fields["k"]
                servers[fields["sv"]] = message.arrived_ns
                # Verdicts seldom change, and tubes come often.
                if fields["vd"] != self._verdicts.get(vehicle):
                    self._verdicts[vehicle] = fields["vd"]
                    t = min(int(batch.t[i]), message.arrived_ns)
                    if self.obligations.verdicts(vehicle, fields["vd"], t):
                        self._astray(vehicle)
        for server, arrived in servers.items():
            self.services.heard(server, arrived)
        return [index for index, _ in refused]


def _named(message: Received, key: tuple[str, ...], said: tuple[str, ...]) -> None:
    """Raise ``MessageError`` (key) unless a message is about what its key is about."""
    if key != said:
        raise MessageError("key", f"a message about {'/'.join(said) or 'a service'} came on {message.key:.120}")
