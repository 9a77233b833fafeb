"""The reach server: the bus in, engine, the bus out, a round at a time."""

import gc
import threading
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Final

import numpy as np
import structlog

from fleet_bus import keys
from fleet_bus.bus import Bus, Publisher
from fleet_bus.clock import SYSTEM, Clock
from fleet_bus.errors import KeyIdError, MessageError
from fleet_bus.messages import (
    Assignment,
    Event,
    EventKind,
    ScenarioDocument,
    ServiceStatus,
    VehicleProfile,
)
from fleet_bus.pubsub import Received
from fleet_bus.rejections import Rejections
from fleet_bus.sessions import DEFAULT_ROUTER, Role
from fleet_bus.writers import Source
from fleet_bus.zenoh_bus import open_bus
from reach_server.data.events import EngineEvent
from reach_server.service import tube_messages
from reach_server.service.cache_queries import HISTORY, CacheQueries
from reach_server.service.fleet import Fleet
from reach_server.service.ingest import Ingest, VehicleBatch, decoded
from reach_server.service.load import Load
from reach_server.service.newest_tubes import NewestTubes
from reach_server.service.other_servers import OtherServers
from reach_server.service.outbox import EVENT_CACHE, Outbox
from reach_server.service.presence import Presence
from reach_server.service.recording import Recording
from reach_server.service.stages import Stages
from reach_server.service.status import Counters, FleetGauges, Tally, service_status

_log = structlog.get_logger(__name__)

TICK_SECONDS: Final = 0.02
STATUS_SECONDS: Final = 1.0


class ReachServer:
    """One reach server between ``with``; ``run`` works until told to stop.

    Three sessions: *input* carries states only, *control* everything rare (liveliness tokens in a session slow
    down its data), *output* the tubes; ``connect`` opens one, by default over Zenoh to the ``routers``. Raises
    ``SessionError`` if no router answers, ``Stopped`` if ``stop`` is set before one does.
    """

    def __init__(
        self,
        instance: str,
        routers: Sequence[str] = (DEFAULT_ROUTER,),
        *,
        stop: threading.Event | None = None,
        clock: Clock = SYSTEM,
        connect: Callable[[], Bus] | None = None,
    ) -> None:
        self.instance = keys.check_id(instance, "server")
        self.rejections = Rejections()
        self.ingest = Ingest(self.rejections)
        self._clock = clock
        self._started = clock.time_ns()
        self._recording = Recording(instance, self._started)
        self._journal = self._recording.journal
        self.fleet = Fleet(self.rejections, lambda: self._journal.stamp)
        self._routers = routers
        self._connect = connect or partial(open_bus, Role.SERVICE, routers, stop)
        self._control: deque[Received | tuple[str, bool]] = deque()
        self._open = ExitStack()
        self._tally = Tally(round_ns=self._started)
        #: Classes when ``_settle`` last did something.
        self._settled = 0
        self._presence = Presence()
        self._load = Load()
        self._others = OtherServers("", instance)
        self._newest = NewestTubes()
        self._stages = Stages(clock)
        self._gauges = self._gauges_now()

    def __enter__(self) -> "ReachServer":
        with ExitStack() as opening:
            declare = opening.enter_context
            output, control, query = (declare(self._connect()) for _ in range(3))
            status = keys.service_status("reach", self.instance)
            self._status: Publisher = declare(output.publisher(status, ServiceStatus.encoding(), cache=1))
            own_events = keys.service_event("reach", self.instance)
            told = declare(output.publisher(own_events, Event.encoding(), cache=EVENT_CACHE))
            self._outbox = Outbox(self.instance, self._clock, self._tally, output, told)
            declare(self._recording.open(output))
            self._others = OtherServers(output.session_id, self.instance)
            self._queries = declare(CacheQueries(query, self.fleet, self._take_in))
            for expression in (keys.ALL_PROFILES, keys.ALL_DOCUMENTS, keys.ALL_ASSIGNMENTS, keys.ALL_STATUS):
                declare(control.subscriber(expression, self._control.append, history=1, late_publishers=True))
            for expression in (keys.ALL_ALIVE, keys.ALL_RECORDERS):
                declare(control.watch_alive(expression, lambda key, alive: self._control.append((key, alive))))
            states = declare(self._connect())
            declare(states.subscriber(keys.ALL_STATES, self.ingest.put, history=HISTORY))
            declare(control.alive(keys.service("reach", self.instance)))
            _log.info("reach server ready", id=self.instance, routers=list(self._routers))
            self._open = opening.pop_all()
        return self

    def __exit__(self, *exc_info: object) -> None:
        with self._open:
            self._outbox.close()

    def _take_in(self, received: Received) -> None:
        """What an agent's cache holds goes the way of what comes live."""
        if received.key.endswith("/state"):
            self.ingest.put(received)
        else:
            self._control.append(received)

    def run(self, stop: threading.Event) -> None:
        """Work until ``stop`` is set: one tick takes everything that has come since the last."""
        next_status = self._clock.monotonic()
        while not stop.is_set():
            began = self._clock.monotonic()
            try:
                self.tick()
            except Exception as error:
                # One vehicle's data must not end the service of all others; the status counts it.
                self._tally.failures += 1
                self._journal.fail(error)
                _log.exception("a round failed, its samples are lost")
            self._tally.round_ns = self._clock.time_ns()
            self._settle()
            due = began >= next_status
            if due:
                next_status = began + STATUS_SECONDS
                self.look_around(began)
                self._gauges = self._gauges_now()
            self._recording.end(self.fleet, began)
            if due:
                self._status.put(self.status().encode())
            self._clock.wait(stop, max(0.0, TICK_SECONDS - (self._clock.monotonic() - began)))

    def _settle(self) -> None:
        """Once a class has had its first tubes, leave what is there, modules and compiled code, out of later garbage
        collections: looking through it stops a round for a tenth of a second."""
        engines = len(self.fleet.engines)
        if self._tally.tubes and engines != self._settled:
            self._settled = engines
            gc.collect()
            gc.freeze()

    def tick(self) -> None:
        """One round: rare messages first, then all samples, then the tubes of their newest."""
        now = self._clock.monotonic()
        self._stages.begin()
        self._journal.begin(now, self._clock.time_ns())
        self._handle_control(now)
        self._stages.passed("control")
        taken = self.ingest.take()
        if taken:
            self._journal.process(taken)
            batches = decoded(taken, self.rejections)
            self._stages.passed("decode")
            if batches:
                self._process(batches, now)
            else:
                self._journal.processed((), None)
        for event in self._journal.elapse(partial(self.fleet.elapse, now)):
            self._outbox.put_event(event)
        self._queries.ask(now)
        self._stages.passed("upkeep")

    def _process(self, batches: list[VehicleBatch], now: float) -> None:
        began = self._clock.monotonic()
        outcome = self.fleet.process(batches, now, self._stages.passed)
        seconds = self._clock.monotonic() - began
        self._tally.compute.append(seconds)
        self._tally.stored += outcome.stored
        self._tally.repeated += outcome.repeated
        self._tally.checks += outcome.checks
        self._tally.batch.add(sum(len(batch.vehicles) for batch in batches))
        for _, tubes in outcome.tubes:
            self._newest.see(tubes)
        self._journal.processed(outcome.events, self._load.note)
        for tube in tube_messages.of_round(
            outcome.tubes, self._load.note, server=self.instance, server_epoch=self._started, compute_seconds=seconds
        ):
            payload = tube.encode()
            self._journal.tube(tube, payload)
            self._outbox.put_tube(tube, payload)
        self._tally.latencies.append(self._clock.monotonic() - began)
        if outcome.tubes:
            self._see_load(batches, [vehicle for _, tubes in outcome.tubes for vehicle in tubes.vehicles])
        for event in outcome.events:
            self._outbox.put_event(event)
        for batch in batches:
            for vehicle in set(batch.vehicles):
                self._queries.see(vehicle, now)
        self._stages.passed("publish")

    def _see_load(self, batches: list[VehicleBatch], served: list[str]) -> None:
        """Hold the times at which the newest samples of a round came against that at which the tubes of the vehicles
        ``served`` were out."""
        newest: dict[str, int] = {}
        for batch in batches:
            if batch.arrived_ns is not None:
                newest.update(zip(batch.vehicles, batch.arrived_ns.tolist(), strict=True))
        now = self._clock.time_ns()
        behind = (now - min(newest.values())) / 1e9 if newest else 0.0
        arrived = np.array([newest[vehicle] for vehicle in served if vehicle in newest], dtype=np.int64)
        self._tally.tube_latency.add(np.maximum(now - arrived, 0) / 1e9)
        if self._load.see(max(0.0, behind)):
            self._outbox.tell(EventKind.BEHIND, self._load.message, {"behind": self._load.behind})

    def _handle_control(self, now: float) -> None:
        while self._control:
            item = self._control.popleft()
            if isinstance(item, tuple):
                self._handle_token(*item, now)
                continue
            try:
                for event in self._handle_document(item, now):
                    self._outbox.put_event(event)
            except MessageError as error:
                self.rejections.count(error, item.key)
                self._tell_refused_document(item, error)
            except KeyIdError as error:
                self.rejections.count(MessageError("key", str(error)), item.key)

    def _handle_token(self, key: str, alive: bool, now: float) -> None:
        if key.startswith("svc/"):
            self._recording.token(key, alive)
            return
        try:
            vehicle = keys.vehicle_of(key)
        except KeyIdError as error:
            self.rejections.count(MessageError("key", str(error)), key)
            return
        self._presence.token(vehicle, alive, now)
        if not alive:
            self._queries.forget(vehicle)

    def _handle_document(self, item: Received, now: float) -> list[EngineEvent]:
        if item.key.startswith("svc/"):
            self._handle_status(item, now)
            return []
        if item.key.startswith("fleet/"):
            vehicle = keys.vehicle_of(item.key)
            profile = VehicleProfile.decode(item.payload, item.encoding)
            put = partial(self.fleet.set_profile, vehicle, profile, item.source, now)
            return self._journal.document("profile", item, put)
        if item.key.endswith("/document"):
            document = ScenarioDocument.decode(item.payload, item.encoding)
            if keys.document(document.scenario) != item.key:
                raise MessageError("key", f"scenario {document.scenario} was put on {item.key}")
            put = partial(self.fleet.set_scenario, document, item.source, now)
            return self._journal.document("document", item, put)
        assignment = Assignment.decode(item.payload, item.encoding)
        if keys.assignment(assignment.scenario, assignment.vehicle) != item.key:
            raise MessageError("key", f"an assignment of {assignment.vehicle} was put on {item.key}")
        return self._journal.document("assignment", item, partial(self.fleet.assign, assignment, item.source, now))

    def _handle_status(self, item: Received, now: float) -> None:
        status = ServiceStatus.decode(item.payload, item.encoding)
        if keys.service_status(status.kind, status.instance) != item.key:
            raise MessageError("key", f"the status of {status.kind}/{status.instance} was put on {item.key}")
        if status.kind == "side-info":
            self._journal.hear(item.source)
            self.fleet.hear_service(item.source, now)
        elif status.kind == "reach" and (news := self._others.hear(status, item.source, now)):
            self._outbox.tell(EventKind.SECOND_SERVER, news, {"instance": status.instance, "session": item.source})

    def look_around(self, now: float) -> None:
        """Find out who is gone at ``now`` (s), and forget what need not be kept; done once a second."""
        for news in self._others.elapse(now):
            self._outbox.tell(EventKind.SECOND_SERVER, news, {})
        waiting = self._presence.waiting
        heard = {vehicle: at for vehicle in waiting if (at := self.fleet.heard(vehicle)) is not None}
        intervals = {vehicle: self.fleet.interval(vehicle) for vehicle in waiting}
        for vehicle in self._presence.gone(heard, intervals, now):
            self._newest.forget(vehicle)
            self._journal.gone(vehicle)
            self.fleet.mark_gone(vehicle)
            message = f"{vehicle} is gone: no samples come, and it is out of sight"
            self._outbox.put_event(EngineEvent(EventKind.VEHICLE_GONE, vehicle, self._clock.time_ns(), message))
        self._journal.let_go(now)
        for vehicle in self.fleet.let_go(now):
            _log.info("let go of a vehicle that was silent for long", vehicle=vehicle)
            self._queries.forget(vehicle)
            self._outbox.forget(vehicle)
            self._newest.forget(vehicle)

    def _tell_refused_document(self, item: Received, error: MessageError) -> None:
        if not item.key.startswith("fleet/"):
            _log.warning("document refused", key=item.key, source=item.source, error=str(error))
            return
        try:
            vehicle = keys.vehicle_of(item.key)
        except KeyIdError:
            return
        message = f"profile of {vehicle} from {Source(item.source)} refused: {error}"
        self._outbox.put_event(EngineEvent(EventKind.PROFILE_REFUSED, vehicle, self._clock.time_ns(), message))

    def status(self) -> ServiceStatus:
        """Counters and gauges of this moment."""
        return service_status(
            self.instance, self._started, self._clock.time_ns(), tally=self._tally, fleet=self.fleet, load=self._load,
            states=self.ingest.received, refused=self.rejections.snapshot(), waiting=self._newest.waiting,
            problems=[*self._others.problems, *self._recording.problems], chain=self._journal.summary(),
        )  # fmt: skip

    def _gauges_now(self) -> FleetGauges:
        clocks = self.fleet.clock_offsets().values()
        return FleetGauges(
            known=len(self.fleet.vehicles), waiting=len(self._newest.waiting), engines=len(self.fleet.engines),
            newest=self._newest.by_label(), clocks_off=self.fleet.clocks_off,
            clock_offset=max((abs(offset) for offset, _ in clocks), default=0.0),
            problems=len(self._others.problems) + self._load.late,
        )  # fmt: skip

    def counters(self) -> Counters:
        """What has been counted until now, for any thread to read while the server works; what takes a look at all
        vehicles is up to a second old."""
        return Counters(
            self._tally, self._gauges, self._stages.seconds, self.rejections.snapshot(), self.ingest.received,
            self.ingest.queued, self._load.behind,
        )  # fmt: skip
