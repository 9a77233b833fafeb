"""The side-info service: publishes scenarios, and which vehicle takes part in which from when on."""

import time
from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from threading import Event
from typing import Final

import structlog
import zenoh

from fleet_bus import keys
from fleet_bus.errors import KeyIdError, MessageError, ScenarioError
from fleet_bus.messages import Assignment, ScenarioDocument, ServiceStatus, StateBatch, StateFlag, decode_states
from fleet_bus.pubsub import (
    CachedPublisher,
    Received,
    declare_alive,
    declare_cached_publisher,
    declare_recovering_subscriber,
    query_cache,
)
from fleet_bus.rejections import Rejections
from side_info.scenario import Scenario
from side_info.starts import VehicleStart

KIND: Final = "side-info"
EVERY_VEHICLE: Final = "*"

_TICK: Final = 0.02
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
    Of the samples in the caches of vehicles, ``history`` each are asked for at the start.
    ``clock_offset`` (s) bounds how far the clocks of vehicles and scenarios differ; it goes into assignments.

    Raises ``ScenarioError`` for an assignment to a scenario that is not loaded or for two of one name,
    ``KeyIdError`` for an id that cannot be in a key.
    """

    def __init__(
        self,
        session: zenoh.Session,
        scenarios: Sequence[Scenario],
        assign: Mapping[str, str],
        instance: str,
        *,
        clock_offset: float = 0.0,
        history: int = 4096,
        clock: Callable[[], int] = time.time_ns,
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
        keys.service(KIND, instance)
        self._session = session
        self._assign = dict(assign)
        self._instance = instance
        self._clock_offset = clock_offset
        self._history = history
        self._clock = clock
        self._arrived: deque[Received] = deque()
        self._rejections = Rejections()
        self._starts: defaultdict[str, VehicleStart] = defaultdict(VehicleStart)
        self._searched: set[str] = set()
        self._assignments: dict[str, tuple[int, CachedPublisher]] = {}
        self._states = 0
        self._published = 0

    def run(self, stop: Event) -> None:
        """Serve until ``stop`` is set; raise ``zenoh.ZError`` if the session is closed under it."""
        with ExitStack() as declared:
            for scenario in self._scenarios.values():
                document = ScenarioDocument(scenario=scenario.name, version=scenario.version, text=scenario.text)
                publisher = declared.enter_context(
                    self._publisher(keys.document(scenario.name), ScenarioDocument.encoding())
                )
                publisher.put(document.encode())
            status = declared.enter_context(
                self._publisher(keys.service_status(KIND, self._instance), ServiceStatus.encoding())
            )
            for vehicle in self._assign:
                if vehicle != EVERY_VEHICLE:
                    self._publish(vehicle, declared)
            declared.enter_context(
                declare_recovering_subscriber(self._session, keys.ALL_STATES, self._receive, history=self._history)
            )
            declared.enter_context(declare_alive(self._session, keys.service(KIND, self._instance)))
            started = next_status = self._clock()
            while True:
                self._take_in(declared)
                now = self._clock()
                # A clock that was set back must not silence the status.
                if not next_status - _STATUS_PERIOD_NS < now < next_status:
                    status.put(self._status(now, started).encode())
                    next_status = now + _STATUS_PERIOD_NS
                if stop.wait(_TICK):
                    return

    def _publisher(self, key: str, encoding: str) -> CachedPublisher:
        return declare_cached_publisher(self._session, key, encoding, cache=1)

    def _receive(self, received: Received) -> None:
        if len(self._arrived) < _ARRIVED_LIMIT:
            self._arrived.append(received)
        else:
            self._rejections.count(MessageError("overflow", f"more than {_ARRIVED_LIMIT} wait"), received.key)

    def _take_in(self, declared: ExitStack) -> None:
        """Process what has arrived since the last time."""
        arrived = [self._arrived.popleft() for _ in range(len(self._arrived))]
        for vehicle, samples in self._decode(arrived).items():
            start = self._starts[vehicle]
            start.see(samples)
            if start.seen and start.time_zero is None and vehicle not in self._searched:
                self._searched.add(vehicle)
                self._search(vehicle)
            self._publish(vehicle, declared)

    def _decode(self, arrived: list[Received]) -> dict[str, list[tuple[int, int]]]:
        """Stamps and flags by vehicle, in the order of arrival, of those that take part in a scenario."""
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
            row for batch in batches for row in zip(batch.index.tolist(), batch.t.tolist(), _flags(batch), strict=True)
        ]
        self._states += len(rows)
        samples: defaultdict[str, list[tuple[int, int]]] = defaultdict(list)
        for index, t, flags in sorted(rows):
            samples[wanted[index][0]].append((t, flags))
        return samples

    def _search(self, vehicle: str) -> None:
        """Look for the start of a vehicle in its cache: it was under way when its first sample came here."""
        cached = query_cache(self._session, keys.state(vehicle), max_samples=_WHOLE_CACHE, timeout=_QUERY_TIMEOUT)
        start = self._starts[vehicle]
        start.see(self._decode(cached).get(vehicle, []))
        if start.time_zero is None:
            _log.warning("start not seen: not assigned until a trajectory begins", vehicle=vehicle)

    def _scenario_of(self, vehicle: str) -> Scenario | None:
        name = self._assign.get(vehicle, self._assign.get(EVERY_VEHICLE))
        return None if name is None else self._scenarios[name]

    def _publish(self, vehicle: str, declared: ExitStack) -> None:
        """Publish the assignment of a vehicle if its time zero is known and not yet published."""
        scenario = self._scenario_of(vehicle)
        if scenario is None:
            return
        time_zero = self._starts[vehicle].time_zero if scenario.time_zero is None else scenario.time_zero
        if time_zero is None:
            return
        before, publisher = self._assignments.get(vehicle, (None, None))
        if before == time_zero:
            return
        if publisher is None:
            publisher = declared.enter_context(
                self._publisher(keys.assignment(scenario.name, vehicle), Assignment.encoding())
            )
        assignment = Assignment(
            scenario=scenario.name, vehicle=vehicle, time_zero=time_zero, clock_offset=self._clock_offset
        )
        publisher.put(assignment.encode())
        self._assignments[vehicle] = (time_zero, publisher)
        self._published += 1

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
            counters={"states": self._states, "assignments": self._published},
            gauges={
                "scenarios": len(self._scenarios),
                "vehicles": len(self._assignments),
                "starts_not_seen": unseen,
            },
            refused=self._rejections.snapshot(),
        )


def _flags(batch: StateBatch) -> list[int]:
    """Flags by sample, where the first sample of an agent's start begins a trajectory whether it says so or not."""
    begins = int(StateFlag.NEW_TRAJECTORY)
    return [f | begins if seq == 0 else f for f, seq in zip(batch.flags.tolist(), batch.seq.tolist(), strict=True)]
