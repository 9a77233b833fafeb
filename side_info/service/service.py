"""The side-info service: publishes scenarios, and which vehicle takes part in which from when on."""

from collections import Counter, defaultdict, deque
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from threading import Event
from typing import Final

import structlog
import zenoh

from fleet_bus import keys
from fleet_bus.bus import Bus
from fleet_bus.clock import SYSTEM, Clock
from fleet_bus.errors import KeyIdError, MessageError, ScenarioError
from fleet_bus.messages import Assignment, ScenarioDocument, ServiceStatus, StateBatch, StateFlag, decode_states, ranges
from fleet_bus.pubsub import Received
from fleet_bus.rejections import Rejections
from fleet_bus.writers import Source
from fleet_bus.zenoh_bus import as_bus
from side_info.documents.scenario import Scenario
from side_info.service import watching
from side_info.service.publications import Publications
from side_info.service.starts import VehicleStart
from side_info.service.watching import Refusal, Watched

KIND: Final = "side-info"
EVERY_VEHICLE: Final = "*"

_TICK: Final = 0.02
_TICKS_PER_LOOK: Final = 25
_STATUS_PERIOD_NS: Final = 10**9
_QUERY_TIMEOUT: Final = 0.5
_WHOLE_CACHE: Final = 200_000
_ARRIVED_LIMIT: Final = 200_000

_log = structlog.get_logger(__name__)


class SideInfoService:
    """Publishes ``scenarios``, and for each vehicle the assignment to its scenario.

    ``assign`` is vehicle → scenario; ``*`` stands for every vehicle that it does not name, once it is seen.
    Time zero of a scenario that begins with the vehicle is the stamp of the sample that began its current
    trajectory (flagged so, or the first of an agent's start); when a new one begins, the assignment is published anew.
    Where that sample is neither on the bus nor in the vehicle's cache, the vehicle is not assigned, since a guess
    could cut its sets wrongly, and the log and the status say so.
    ``files`` says which scenario was read from which file: these are watched, and a document of a greater version that
    checks takes the place of the published one; any other change is refused, counted and logged, once.
    Of the samples in the caches of vehicles, ``history`` each are asked for at the start.
    ``clock_offset`` (s) bounds how far the clocks of vehicles and scenarios differ; it goes into assignments.
    ``session`` may be any ``Bus``, ``clock`` any ``Clock``.

    Raises ``ScenarioError`` for an assignment or a file of a scenario that is not loaded, for two of one name and for a
    clock offset out of its range, ``KeyIdError`` for an id that cannot be in a key.
    """

    def __init__(
        self,
        session: zenoh.Session | Bus,
        scenarios: Sequence[Scenario],
        assign: Mapping[str, str],
        instance: str,
        *,
        files: Mapping[str, Path] | None = None,
        clock_offset: float = 0.0,
        history: int = 4096,
        clock: Clock = SYSTEM,
    ) -> None:
        self._scenarios = {scenario.name: scenario for scenario in scenarios}
        loaded = ", ".join(scenario.name for scenario in scenarios) or "none"
        if len(self._scenarios) < len(scenarios):
            raise ScenarioError(f"two scenarios have one name: {loaded}")
        for vehicle, name in assign.items():
            if vehicle != EVERY_VEHICLE:
                keys.check_id(vehicle)
            if name not in self._scenarios:
                raise ScenarioError(f"vehicle {vehicle} is assigned to scenario {name!r:.80}: loaded are {loaded}")
        for name, path in (files or {}).items():
            if name not in self._scenarios:
                raise ScenarioError(f"{path}: scenario {name!r:.80} is not loaded: loaded are {loaded}")
        if clock_offset not in ranges.CLOCK_OFFSET:
            raise ScenarioError(f"the clock offset {clock_offset:g} s bounds nothing: expected {ranges.CLOCK_OFFSET}")
        keys.service(KIND, instance)
        self._bus = as_bus(session)
        self._watched = {name: Watched.begin(path, self._scenarios[name]) for name, path in (files or {}).items()}
        self._assign = dict(assign)
        self._instance = instance
        self._clock_offset = clock_offset
        self._history = history
        self._clock = clock
        self._arrived: deque[Received] = deque()
        self._rejections = Rejections()
        self._starts: defaultdict[str, VehicleStart] = defaultdict(VehicleStart)
        self._searched: set[str] = set()
        #: Vehicles whose states a second source publishes.
        self._rivalled: set[str] = set()
        self._assignments: dict[str, int | None] = {}
        self._counters: Counter[str] = Counter(states=0, assignments=0, documents_published=0)
        self._refused_documents: Counter[str] = Counter()
        #: The newest one that was published; any thread may read it.
        self.newest_status: ServiceStatus | None = None

    def run(self, stop: Event) -> None:
        """Serve until ``stop`` is set; raise ``zenoh.ZError`` if the session is closed under it."""
        with Publications(self._bus, keys.ALL_DOCUMENTS, keys.ALL_ASSIGNMENTS) as publications:
            for scenario in self._scenarios.values():
                self._publish_document(scenario, publications)
            for vehicle in self._assign:
                if vehicle != EVERY_VEHICLE:
                    self._publish_assignment(vehicle, publications)
            with (
                self._bus.subscriber(keys.ALL_STATES, self._receive, history=self._history),
                self._bus.alive(keys.service(KIND, self._instance)),
            ):
                self._serve(stop, publications)

    def _serve(self, stop: Event, publications: Publications) -> None:
        started = next_status = self._clock.time_ns()
        for tick in count():
            self._take_in(publications)
            if tick % _TICKS_PER_LOOK == 0:
                self._look_at_files(publications)
            now = self._clock.time_ns()
            # A clock that was set back must not silence the status.
            if not next_status - _STATUS_PERIOD_NS < now < next_status:
                status = self._status(now, started)
                publications.put(keys.service_status(KIND, self._instance), ServiceStatus.encoding(), status.encode())
                self.newest_status = status
                next_status = now + _STATUS_PERIOD_NS
            if self._clock.wait(stop, _TICK):
                return

    def _receive(self, received: Received) -> None:
        if len(self._arrived) < _ARRIVED_LIMIT:
            self._arrived.append(received)
        else:
            self._rejections.count(MessageError("overflow", f"more than {_ARRIVED_LIMIT} wait"), received.key)

    def _take_in(self, publications: Publications) -> None:
        """Process what has arrived since the last time."""
        arrived = [self._arrived.popleft() for _ in range(len(self._arrived))]
        now = self._clock.monotonic()
        changed = {vehicle for vehicle in self._rivalled if self._starts[vehicle].elapse(now)}
        for (vehicle, source), samples in self._decode(arrived).items():
            start = self._starts[vehicle]
            before = start.writer.conflict
            if start.take_in(source, samples, now):
                changed.add(vehicle)
            if start.writer.conflict and not before:
                first, second = start.writer.source, start.writer.rival
                _log.warning("two sources publish a vehicle", vehicle=vehicle, first=str(first), second=str(second))
            if start.writer.rival is not None:
                self._rivalled.add(vehicle)
        self._rivalled = {vehicle for vehicle in self._rivalled if self._starts[vehicle].writer.rival is not None}
        for vehicle in changed:
            start = self._starts[vehicle]
            if start.seen and start.time_zero is None and vehicle not in self._searched:
                self._searched.add(vehicle)
                self._search(vehicle)
            self._publish_assignment(vehicle, publications)

    def _decode(self, arrived: list[Received]) -> dict[tuple[str, Source], list[tuple[int, int]]]:
        """Stamps and flags by vehicle and source, in the order of arrival, of those that take part in a scenario."""
        wanted: list[tuple[str, Received]] = []
        for received in arrived:
            try:
                vehicle = keys.vehicle_of(received.key)
            except KeyIdError as error:
                self._rejections.count(MessageError("key", str(error)), received.key)
                continue
            if self._scenario_of(vehicle) is not None:
                wanted.append((vehicle, received))
        batches, refused = decode_states(
            [received.payload for _, received in wanted], [received.encoding for _, received in wanted]
        )
        for index, refusal in refused:
            self._rejections.count(refusal, wanted[index][1].key)
        rows = [
            row
            for batch in batches
            for row in zip(batch.index.tolist(), batch.t.tolist(), _flags(batch), batch.epoch.tolist(), strict=True)
        ]
        self._counters["states"] += len(rows)
        samples: defaultdict[tuple[str, Source], list[tuple[int, int]]] = defaultdict(list)
        for index, t, flags, epoch in sorted(rows):
            vehicle, received = wanted[index]
            samples[vehicle, Source(received.source, epoch)].append((t, flags))
        return samples

    def _search(self, vehicle: str) -> None:
        """Look for the start of a vehicle in its cache: it was under way when its first sample came here."""
        cached = self._bus.query(keys.state(vehicle), max_samples=_WHOLE_CACHE, timeout=_QUERY_TIMEOUT)
        start = self._starts[vehicle]
        if start.writer.source is not None:
            start.see(self._decode(cached).get((vehicle, start.writer.source), []))
        if start.time_zero is None:
            _log.warning("start not seen: not assigned until a trajectory begins", vehicle=vehicle)

    def _scenario_of(self, vehicle: str) -> Scenario | None:
        name = self._assign.get(vehicle, self._assign.get(EVERY_VEHICLE))
        return None if name is None else self._scenarios[name]

    def _publish_document(self, scenario: Scenario, publications: Publications) -> None:
        document = ScenarioDocument(scenario=scenario.name, version=scenario.version, text=scenario.text)
        publications.put(keys.document(scenario.name), ScenarioDocument.encoding(), document.encode())
        self._counters["documents_published"] += 1

    def _publish_assignment(self, vehicle: str, publications: Publications) -> None:
        """Publish the assignment of a vehicle if its time zero is known and not yet published."""
        scenario = self._scenario_of(vehicle)
        if scenario is None:
            return
        time_zero = self._time_zero(vehicle, scenario)
        if time_zero is not None and time_zero != self._assignments.get(vehicle):
            self._put_assignment(vehicle, scenario, time_zero, publications)
            self._assignments[vehicle] = time_zero

    def _time_zero(self, vehicle: str, scenario: Scenario) -> int | None:
        return self._starts[vehicle].time_zero if scenario.time_zero is None else scenario.time_zero

    def _put_assignment(
        self, vehicle: str, scenario: Scenario, time_zero: int, publications: Publications, *, active: bool = True
    ) -> None:
        assignment = Assignment(
            scenario=scenario.name,
            vehicle=vehicle,
            time_zero=time_zero,
            active=active,
            clock_offset=self._clock_offset,
        )
        publications.put(keys.assignment(scenario.name, vehicle), Assignment.encoding(), assignment.encode())
        self._counters["assignments"] += 1
        event = "takes part" if active else "takes part no longer"
        _log.info(event, vehicle=vehicle, scenario=scenario.name, time_zero=_instant(time_zero))

    def _look_at_files(self, publications: Publications) -> None:
        for name, watched in self._watched.items():
            self._watched[name], decision = watching.take_in(watched, watching.look(watched))
            if isinstance(decision, Scenario):
                self._replace(decision, publications)
            elif isinstance(decision, Refusal):
                self._refused_documents[decision.reason] += 1
                # The detail shows a place below its line: as a field it would be one line full of escapes.
                _log.warning(f"document refused: {decision.detail}", scenario=name, reason=decision.reason)
            elif watched.behind and not self._watched[name].behind:
                _log.info("document as published again", scenario=name, version=watched.scenario.version)

    def _replace(self, scenario: Scenario, publications: Publications) -> None:
        """Publish a new version of a scenario, and the assignments anew whose time zero it changes."""
        before = self._scenarios[scenario.name]
        self._scenarios[scenario.name] = scenario
        # Withdrawn first: the new document with the old time zero would cut by what does not hold.
        moved = [
            (vehicle, time_zero)
            for vehicle, time_zero in self._assignments.items()
            if self._scenario_of(vehicle) is scenario
            and time_zero is not None
            and self._time_zero(vehicle, scenario) != time_zero
        ]
        for vehicle, time_zero in moved:
            self._put_assignment(vehicle, scenario, time_zero, publications, active=False)
            self._assignments[vehicle] = None
        self._publish_document(scenario, publications)
        # Where time zero had to wait for a vehicle's start before, it may be known now.
        for vehicle in {*self._assign, *self._starts} - {EVERY_VEHICLE}:
            if self._scenario_of(vehicle) is scenario:
                self._publish_assignment(vehicle, publications)
        _log.info("document published", scenario=scenario.name, version=scenario.version, before=before.version)

    def _status(self, now: int, started: int) -> ServiceStatus:
        # Only where time zero is the vehicle's own does it matter that its start was not seen.
        unseen = sum(
            1
            for vehicle in self._searched
            if self._starts[vehicle].time_zero is None
            and (scenario := self._scenario_of(vehicle)) is not None
            and scenario.time_zero is None
        )
        return ServiceStatus(
            kind=KIND,
            instance=self._instance,
            t=now,
            started=started,
            counters=dict(self._counters),
            gauges={
                "scenarios": len(self._scenarios),
                "vehicles": sum(time_zero is not None for time_zero in self._assignments.values()),
                "starts_not_seen": unseen,
                "documents_behind": sum(watched.behind for watched in self._watched.values()),
            },
            refused={**self._rejections.snapshot(), **self._refused_documents},
        )


def _instant(time_ns: int) -> str:
    """A stamp as an RFC 3339 instant in whole milliseconds."""
    seconds, rest = divmod(time_ns, 10**9)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{rest // 10**6:03d}Z"


def _flags(batch: StateBatch) -> list[int]:
    """Flags by sample, where the first sample of an agent's start begins a trajectory whether it says so or not."""
    begins = int(StateFlag.NEW_TRAJECTORY)
    return [f | begins if seq == 0 else f for f, seq in zip(batch.flags.tolist(), batch.seq.tolist(), strict=True)]
