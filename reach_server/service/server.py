"""The reach server: Zenoh in, engine, Zenoh out. The only module of the package that knows clock and network."""

import gc
import threading
import time
from collections import deque
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from itertools import islice
from typing import Final

import structlog
import zenoh

from fleet_bus import keys
from fleet_bus.errors import KeyIdError, MessageError
from fleet_bus.messages import (
    Assignment,
    Event,
    EventKind,
    ScenarioDocument,
    ServiceStatus,
    VehicleProfile,
)
from fleet_bus.messages import tube as tube_message
from fleet_bus.pubsub import (
    CachedPublisher,
    Received,
    declare_alive,
    declare_cached_publisher,
    declare_recovering_subscriber,
    query_cache,
    watch_alive,
)
from fleet_bus.rejections import Rejections
from fleet_bus.sessions import DEFAULT_ROUTER, Role, open_session
from fleet_bus.writers import Source
from reach_server.data.events import EngineEvent
from reach_server.service import tube_messages as publish
from reach_server.service.event_limit import EventLimit
from reach_server.service.fleet import Fleet
from reach_server.service.ingest import Ingest, VehicleBatch
from reach_server.service.load import Load
from reach_server.service.other_servers import OtherServers
from reach_server.service.presence import Presence

_log = structlog.get_logger(__name__)

#: Samples asked of each agent's cache when the server starts; more than any window holds.
HISTORY: Final = 100_000
TICK_SECONDS: Final = 0.02
STATUS_SECONDS: Final = 1.0
#: A vehicle whose first samples, or whose profile, are still missing after this long gets one query of its cache.
GRACE_SECONDS: Final = 0.2
QUERY_SECONDS: Final = 2.0
#: Caches that are asked at once.
QUERIES: Final = 16
EVENT_CACHE: Final = 32


class ReachServer:
    """One reach server between ``with``; ``run`` works until told to stop.

    Three sessions: *input* carries states only, *control* everything rare (liveliness tokens in a session slow
    down its data), *output* the tubes. Raises ``SessionError`` if no router answers, ``Stopped`` if ``stop`` is set
    before one does.
    """

    def __init__(
        self, instance: str, routers: Sequence[str] = (DEFAULT_ROUTER,), *, stop: threading.Event | None = None
    ) -> None:
        self.instance = keys.check_id(instance, "server")
        self.rejections = Rejections()
        self.ingest = Ingest(self.rejections)
        self.fleet = Fleet(self.rejections, time.time_ns)
        self._routers = routers
        self._stop = stop
        self._control: deque[Received | tuple[str, bool]] = deque()
        self._open = ExitStack()
        self._tubes: dict[str, CachedPublisher] = {}
        self._events: dict[str, CachedPublisher] = {}
        self._started = time.time_ns()
        self._tube_count = 0
        self._event_count = 0
        self._stored = 0
        #: Classes when ``_settle`` last did something.
        self._settled = 0
        self._failures = 0
        self._repeated = 0
        self._latencies: deque[float] = deque(maxlen=10_000)
        self._compute: deque[float] = deque(maxlen=1000)
        #: Epochs whose cache was asked for samples, and vehicles whose cache was asked for the profile.
        self._asked: dict[str, int] = {}
        self._asked_profile: set[str] = set()
        self._seen: dict[str, float] = {}
        self._presence = Presence()
        self._load = Load()
        self._limit = EventLimit()
        self._others = OtherServers("", instance)
        self._queries = ThreadPoolExecutor(QUERIES, thread_name_prefix="cache-query")
        #: Why vehicles have no tube, by id.
        self._waiting: dict[str, str] = {}

    def __enter__(self) -> "ReachServer":
        with ExitStack() as opening:
            opened = partial(open_session, Role.SERVICE, self._routers, stop=self._stop)
            self._output: zenoh.Session = opening.enter_context(opened())
            control = opening.enter_context(opened())
            self._query = opening.enter_context(opened())
            declare = opening.enter_context
            status = keys.service_status("reach", self.instance)
            self._status = declare(declare_cached_publisher(self._output, status, ServiceStatus.encoding(), cache=1))
            own_events = keys.service_event("reach", self.instance)
            self._own_events = declare(
                declare_cached_publisher(self._output, own_events, Event.encoding(), cache=EVENT_CACHE)
            )
            self._others = OtherServers(str(self._output.zid()), self.instance)
            opening.callback(self._queries.shutdown, wait=False, cancel_futures=True)
            for expression in (keys.ALL_PROFILES, keys.ALL_DOCUMENTS, keys.ALL_ASSIGNMENTS, keys.ALL_STATUS):
                declare(
                    declare_recovering_subscriber(
                        control, expression, self._control.append, history=1, late_publishers=True
                    )
                )
            declare(watch_alive(control, keys.ALL_ALIVE, lambda key, alive: self._control.append((key, alive))))
            states = opening.enter_context(opened())
            declare(declare_recovering_subscriber(states, keys.ALL_STATES, self.ingest.put, history=HISTORY))
            declare(declare_alive(control, keys.service("reach", self.instance)))
            _log.info("reach server ready", id=self.instance, routers=list(self._routers))
            self._open = opening.pop_all()
        return self

    def __exit__(self, *exc_info: object) -> None:
        with self._open:
            for publisher in (*self._tubes.values(), *self._events.values()):
                publisher.close()

    def run(self, stop: threading.Event) -> None:
        """Work until ``stop`` is set: one tick takes everything that has come since the last."""
        next_status = time.monotonic()
        while not stop.is_set():
            began = time.monotonic()
            try:
                self.tick()
            except Exception:
                # One vehicle's data must not end the service of all others; the status counts it.
                self._failures += 1
                _log.exception("a round failed, its samples are lost")
            self._settle()
            if began >= next_status:
                next_status = began + STATUS_SECONDS
                self._look_around(began)
                self._publish_status()
            stop.wait(max(0.0, TICK_SECONDS - (time.monotonic() - began)))

    def _settle(self) -> None:
        """Once a class has had its first tubes, leave what is there, modules and compiled code, out of later garbage
        collections: looking through it stops a round for a tenth of a second."""
        engines = len(self.fleet.engines)
        if self._tube_count and engines != self._settled:
            self._settled = engines
            gc.collect()
            gc.freeze()

    def tick(self) -> None:
        """One round: rare messages first, then all samples, then the tubes of their newest."""
        now = time.monotonic()
        self._handle_control(now)
        batches = self.ingest.drain()
        if batches:
            self._process(batches, now)
        for event in self.fleet.elapse(now):
            self._publish_event(event)
        self._fetch_missing(now)

    def _process(self, batches: list[VehicleBatch], now: float) -> None:
        began = time.perf_counter()
        outcome = self.fleet.process(batches, now)
        seconds = time.perf_counter() - began
        self._compute.append(seconds)
        self._stored += outcome.stored
        self._repeated += outcome.repeated
        late = self._load.note
        for engine, tubes in outcome.tubes:
            for vehicle in tubes.vehicles:
                self._waiting.pop(vehicle, None)
            self._waiting |= tubes.waiting
            audits = [engine.audit_of(vehicle) for vehicle in tubes.vehicles]
            profile = engine.profile
            for message in publish.messages(
                tubes if late is None else tubes.noted(dict.fromkeys(tubes.vehicles, late)),
                profile.state_names, profile.position, audits,
                server=self.instance, server_epoch=self._started, compute_seconds=seconds,
            ):  # fmt: skip
                self._publisher(self._tubes, keys.tube(message.vehicle), tube_message.ENCODING, 1).put(message.encode())
                self._tube_count += 1
        self._latencies.append(time.perf_counter() - began)
        if outcome.tubes:
            self._see_load(batches)
        for event in outcome.events:
            self._publish_event(event)
        for batch in batches:
            for vehicle in set(batch.vehicles):
                self._seen.setdefault(vehicle, now)

    def _see_load(self, batches: list[VehicleBatch]) -> None:
        """Hold the times at which the newest samples of a round came against that at which their tubes were out."""
        newest: dict[str, int] = {}
        for batch in batches:
            if batch.arrived_ns is not None:
                newest.update(zip(batch.vehicles, batch.arrived_ns.tolist(), strict=True))
        behind = (time.time_ns() - min(newest.values())) / 1e9 if newest else 0.0
        if self._load.see(max(0.0, behind)):
            self._tell(EventKind.BEHIND, self._load.message, {"behind": self._load.behind})

    def _handle_control(self, now: float) -> None:
        while self._control:
            item = self._control.popleft()
            if isinstance(item, tuple):
                self._handle_token(*item, now)
                continue
            try:
                for event in self._handle_document(item, now):
                    self._publish_event(event)
            except MessageError as error:
                self.rejections.count(error, item.key)
                self._tell_refused_document(item, error)
            except KeyIdError as error:
                self.rejections.count(MessageError("key", str(error)), item.key)

    def _handle_token(self, key: str, alive: bool, now: float) -> None:
        try:
            vehicle = keys.vehicle_of(key)
        except KeyIdError as error:
            self.rejections.count(MessageError("key", str(error)), key)
            return
        self._presence.token(vehicle, alive, now)
        if not alive:
            # It may come back with a cache that holds what was missed meanwhile.
            self._forget_asked(vehicle)

    def _handle_document(self, item: Received, now: float) -> list[EngineEvent]:
        if item.key.startswith("svc/"):
            self._handle_status(item, now)
            return []
        if item.key.startswith("fleet/"):
            vehicle = keys.vehicle_of(item.key)
            profile = VehicleProfile.decode(item.payload, item.encoding)
            return self.fleet.set_profile(vehicle, profile, item.source, now)
        if item.key.endswith("/document"):
            document = ScenarioDocument.decode(item.payload, item.encoding)
            if keys.document(document.scenario) != item.key:
                raise MessageError("key", f"scenario {document.scenario} was put on {item.key}")
            return self.fleet.set_scenario(document, item.source, now)
        assignment = Assignment.decode(item.payload, item.encoding)
        if keys.assignment(assignment.scenario, assignment.vehicle) != item.key:
            raise MessageError("key", f"an assignment of {assignment.vehicle} was put on {item.key}")
        return self.fleet.assign(assignment, item.source, now)

    def _handle_status(self, item: Received, now: float) -> None:
        status = ServiceStatus.decode(item.payload, item.encoding)
        if keys.service_status(status.kind, status.instance) != item.key:
            raise MessageError("key", f"the status of {status.kind}/{status.instance} was put on {item.key}")
        if status.kind == "side-info":
            self.fleet.hear_service(item.source, now)
        elif status.kind == "reach" and (news := self._others.hear(status, item.source, now)):
            self._tell(EventKind.SECOND_SERVER, news, {"instance": status.instance, "session": item.source})

    def _look_around(self, now: float) -> None:
        """Once a second: who is gone, and what need not be kept any more."""
        for news in self._others.elapse(now):
            self._tell(EventKind.SECOND_SERVER, news, {})
        waiting = self._presence.waiting
        heard = {vehicle: at for vehicle in waiting if (at := self.fleet.heard(vehicle)) is not None}
        intervals = {vehicle: self.fleet.interval(vehicle) for vehicle in waiting}
        for vehicle in self._presence.gone(heard, intervals, now):
            self._waiting.pop(vehicle, None)
            self.fleet.mark_gone(vehicle)
            message = f"{vehicle} is gone: no samples come, and it is out of sight"
            self._publish_event(EngineEvent(EventKind.VEHICLE_GONE, vehicle, time.time_ns(), message))
        for vehicle in self.fleet.let_go(now):
            _log.info("let go of a vehicle that was silent for long", vehicle=vehicle)
            self._forget_asked(vehicle)
            self._limit.forget(vehicle)
            self._waiting.pop(vehicle, None)
            for publishers, key in ((self._tubes, keys.tube(vehicle)), (self._events, keys.event(vehicle))):
                if (publisher := publishers.pop(key, None)) is not None:
                    publisher.close()

    def _forget_asked(self, vehicle: str) -> None:
        self._asked.pop(vehicle, None)
        self._asked_profile.discard(vehicle)
        self._seen.pop(vehicle, None)

    def _tell_refused_document(self, item: Received, error: MessageError) -> None:
        if not item.key.startswith("fleet/"):
            _log.warning("document refused", key=item.key, source=item.source, error=str(error))
            return
        try:
            vehicle = keys.vehicle_of(item.key)
        except KeyIdError:
            return
        message = f"profile of {vehicle} from {Source(item.source)} refused: {error}"
        self._publish_event(EngineEvent(EventKind.PROFILE_REFUSED, vehicle, time.time_ns(), message))

    def _fetch_missing(self, now: float) -> None:
        """Ask the caches of agents that were there before they could be heard, once per start of an agent."""
        for vehicle, since in list(self._seen.items()):
            if now - since < GRACE_SECONDS:
                continue
            if vehicle not in self._asked_profile and self.fleet.waits_for_profile(vehicle):
                self._asked_profile.add(vehicle)
                self._queries.submit(self._fetch, keys.profile(vehicle), 1)
            first = self.fleet.first_sample(vehicle)
            if first is None or self._asked.get(vehicle) == first[0]:
                continue
            self._asked[vehicle] = first[0]
            if first[1] > 0:
                self._queries.submit(self._fetch, keys.state(vehicle), HISTORY)

    def _fetch(self, key: str, most: int) -> None:
        """Put what an agent's cache holds into the queue; what is known already is dropped by the window."""
        try:
            found = query_cache(self._query, key, max_samples=most, timeout=QUERY_SECONDS)
        except zenoh.ZError as error:
            _log.warning("cache query failed", key=key, error=str(error))
            return
        for received in found:
            if key.endswith("/state"):
                self.ingest.put(received)
            else:
                self._control.append(received)

    def _publisher(self, known: dict[str, CachedPublisher], key: str, encoding: str, cache: int) -> CachedPublisher:
        publisher = known.get(key)
        if publisher is None:
            # DROP would lose tubes in bursts; BLOCK_FIRST waits for the oldest only.
            publisher = known[key] = declare_cached_publisher(
                self._output, key, encoding, cache=cache, congestion=zenoh.CongestionControl.BLOCK_FIRST
            )
        return publisher

    def _publish_event(self, event: EngineEvent) -> None:
        admitted = self._limit.admit(event, time.monotonic())
        if admitted is None:
            return
        event = admitted
        message = Event(
            kind=event.kind, vehicle=event.vehicle, t=event.t, source=self.instance,
            message=event.message[:2000], details=event.details,
        )  # fmt: skip
        _log.info("event", kind=str(event.kind), vehicle=event.vehicle, message=event.message)
        self._publisher(self._events, keys.event(event.vehicle), Event.encoding(), EVENT_CACHE).put(message.encode())
        self._event_count += 1

    def _tell(self, kind: EventKind, message: str, details: dict[str, str | int | float | bool]) -> None:
        """Publish an event about the server itself."""
        event = Event(kind=kind, t=time.time_ns(), source=self.instance, message=message[:2000], details=details)
        _log.warning("event", kind=str(kind), message=message)
        self._own_events.put(event.encode())
        self._event_count += 1

    def status(self) -> ServiceStatus:
        """Counters and gauges of this moment."""
        filled = [count for engine in self.fleet.engines for count in engine.window_filled().tolist()]
        clocks = sorted(self.fleet.clock_offsets().items(), key=lambda item: -abs(item[1][0]))[:100]
        return ServiceStatus(
            kind="reach", instance=self.instance, t=time.time_ns(), started=self._started,
            counters={
                "states": self.ingest.received, "stored": self._stored, "repeated": self._repeated,
                "tubes": self._tube_count, "events": self._event_count,
                "events_withheld": self._limit.withheld, "failures": self._failures,
            },
            gauges={
                "vehicles": float(len(filled)), "waiting": float(len(self._waiting)),
                "window_least": float(min(filled, default=0)),
                "compute_p50": _quantile(self._compute, 0.5), "compute_p99": _quantile(self._compute, 0.99),
                "tick_p50": _quantile(self._latencies, 0.5), "tick_p99": _quantile(self._latencies, 0.99),
                "behind": self._load.behind, "known": float(len(self.fleet.vehicles)),
            },
            refused=self.rejections.snapshot(),
            waiting={vehicle: why[:200] for vehicle, why in islice(sorted(self._waiting.items()), 100)},
            clock_offsets={vehicle: offset for vehicle, (offset, _) in clocks},
            clock_spreads={vehicle: spread for vehicle, (_, spread) in clocks},
            problems=[*self._others.problems, *([self._load.message] if self._load.late else [])][:32],
        )  # fmt: skip

    def _publish_status(self) -> None:
        self._status.put(self.status().encode())


def _quantile(values: deque[float], q: float) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(q * len(ordered)))] if ordered else 0.0
