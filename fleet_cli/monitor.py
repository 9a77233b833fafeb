"""What a viewer of the demo sees on the bus, and what follows from it: coverage, areas, latencies."""

from collections import Counter, defaultdict, deque
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import zenoh

from fleet_bus import Role, keys, open_session
from fleet_bus.errors import FleetError, KeyIdError, MessageError
from fleet_bus.messages import Assignment, Event, ReachTube, ServiceStatus, StateFlag, StateSample, VehicleProfile
from fleet_bus.pubsub import Received, declare_recovering_subscriber, subscribe
from fleet_bus.rejections import Rejections
from reach_server.data.regressors import wrap
from reach_server.sets.kernels import membership

#: (vehicle, epoch, seq)
SampleKey = tuple[str, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Something received and when it was put (Unix ns)."""

    message: Any
    put_ns: int | None


class Monitor:
    """A viewer session that keeps states, truths, tubes, events and status of a fleet."""

    def __init__(self, routers: Sequence[str]) -> None:
        self._routers = routers
        self._arrived: deque[Received] = deque()
        self._open = ExitStack()
        self.rejections = Rejections()
        self.profiles: dict[str, VehicleProfile] = {}
        self.assignments: dict[str, Assignment] = {}
        self.states: dict[SampleKey, Seen] = {}
        self.truths: dict[SampleKey, StateSample] = {}
        self.tubes: dict[SampleKey, Seen] = {}
        self.newest: dict[str, ReachTube] = {}
        self.counts: defaultdict[str, Counter[str]] = defaultdict(Counter)
        self.events: list[Event] = []
        self.status: dict[str, ServiceStatus] = {}

    def __enter__(self) -> Self:
        with ExitStack() as opening:
            session: zenoh.Session = opening.enter_context(open_session(Role.VIEWER, self._routers))
            # Rare messages come from caches, so that nothing depends on who was started first.
            for expression in (keys.ALL_PROFILES, keys.ALL_ASSIGNMENTS, keys.ALL_EVENTS, keys.ALL_STATUS):
                opening.enter_context(
                    declare_recovering_subscriber(session, expression, self._arrived.append, history=32)
                )
            for expression in (keys.ALL_STATES, keys.ALL_TRUTHS, keys.ALL_TUBES):
                opening.enter_context(subscribe(session, expression, self._arrived.append))
            self._open = opening.pop_all()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._open.close()

    def take_in(self) -> None:
        """Process what has arrived since the last time."""
        while self._arrived:
            received = self._arrived.popleft()
            try:
                self._handle(received)
            except MessageError as error:
                self.rejections.count(error, received.key)
            except KeyIdError as error:
                self.rejections.count(MessageError("key", str(error)), received.key)

    def _handle(self, received: Received) -> None:
        chunks = received.key.split("/")
        kind = chunks[-1] if chunks[0] != "spec" else chunks[2]
        if kind == "status":
            status = ServiceStatus.decode(received.payload, received.encoding)
            self.status[f"{status.kind}/{status.instance}"] = status
            return
        vehicle = keys.vehicle_of(received.key)
        if kind == "tube":
            tube = ReachTube.decode(received.payload, received.encoding)
            self.tubes[vehicle, tube.epoch, tube.seq] = Seen(tube, received.timestamp_ns)
            self.newest[vehicle] = tube
            self.counts[vehicle]["tubes"] += 1
        elif kind in ("state", "truth"):
            sample = StateSample.decode(received.payload, received.encoding)
            if kind == "truth":
                self.truths[vehicle, sample.epoch, sample.seq] = sample
            else:
                self.states[vehicle, sample.epoch, sample.seq] = Seen(sample, received.timestamp_ns)
                if not sample.flags & StateFlag.HISTORY:
                    self.counts[vehicle]["samples"] += 1
        elif kind == "profile":
            self.profiles[vehicle] = VehicleProfile.decode(received.payload, received.encoding)
        elif kind == "assignment":
            self.assignments[vehicle] = Assignment.decode(received.payload, received.encoding)
        elif kind == "event":
            self.events.append(Event.decode(received.payload, received.encoding))

    def coverage(self) -> dict[str, "VehicleCoverage"]:
        """For each vehicle, how many true states lay in the published set of their instant, by step."""
        by_vehicle: defaultdict[str, list[SampleKey]] = defaultdict(list)
        for key in sorted(self.tubes):
            by_vehicle[key[0]].append(key)
        return {vehicle: self._coverage_of(vehicle, found) for vehicle, found in by_vehicle.items()}

    def coverage_from(self, vehicle: str, t: int) -> "VehicleCoverage":
        """Coverage of the tubes of one vehicle from samples not before ``t`` (ns)."""
        return self._coverage_of(
            vehicle, [k for k in sorted(self.tubes) if k[0] == vehicle and self.tubes[k].message.t >= t]
        )

    def _coverage_of(self, vehicle: str, found: list[SampleKey]) -> "VehicleCoverage":
        tubes: list[ReachTube] = [self.tubes[key].message for key in found]
        horizon = min((len(tube.times) for tube in tubes), default=0)
        checked = np.zeros((len(tubes), horizon), dtype=bool)
        inside = np.zeros((len(tubes), horizon), dtype=bool)
        area = np.array([tube.area[:horizon] for tube in tubes]).reshape(len(tubes), horizon)
        area_free = np.array([tube.area_free[:horizon] for tube in tubes]).reshape(len(tubes), horizon)
        profile = self.profiles.get(vehicle)
        angles = np.flatnonzero(profile.angles) if profile is not None else ()
        for h in range(horizon):
            rows = [
                i
                for i, (_, epoch, seq) in enumerate(found)
                if (truth := self.truths.get((vehicle, epoch, seq + h + 1))) is not None
                and truth.t == tubes[i].times[h]
            ]
            if not rows:
                continue
            states = np.stack([self.truths[vehicle, found[i][1], found[i][2] + h + 1].x for i in rows])
            checked[rows, h] = True
            inside[rows, h] = contains([tubes[i] for i in rows], h, states, angles)
        return VehicleCoverage(checked, inside, area, area_free)

    def latencies(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Seconds from the put of each state to the put of its tube."""
        seconds = [
            (tube.put_ns - state.put_ns) / 1e9
            for key, tube in self.tubes.items()
            if (state := self.states.get(key)) is not None and tube.put_ns is not None and state.put_ns is not None
        ]
        return np.array(seconds)


@dataclass(frozen=True, slots=True, eq=False)
class VehicleCoverage:
    """By tube and step (K, N): whether the truth was known, whether it lay inside, areas with and without cuts."""

    checked: np.ndarray[Any, np.dtype[np.bool_]]
    inside: np.ndarray[Any, np.dtype[np.bool_]]
    area: np.ndarray[Any, np.dtype[np.float64]]
    area_free: np.ndarray[Any, np.dtype[np.float64]]


def contains(
    tubes: Sequence[ReachTube], step: int, x: np.ndarray[Any, np.dtype[np.float64]], angles: Sequence[int] | Any
) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Whether states (K, n) lie in all three published descriptions of a step: zonotope, box and outline."""
    if not tubes:
        raise FleetError("contains needs at least one tube")
    center = np.stack([tube.center[step] for tube in tubes])
    generators = np.stack([tube.generators[step] for tube in tubes])
    hull = np.stack([tube.hull[step] for tube in tubes])
    outline = np.stack([tube.outline[step] for tube in tubes])
    relative = x - center
    for i in angles:
        relative[:, i] = wrap(relative[:, i])
    boxed = ((hull[:, 0] <= relative) & (relative <= hull[:, 1])).all(axis=1)
    first, second = tubes[0].position
    point = relative[:, [first, second]]
    edge = np.roll(outline, -1, axis=1) - outline
    away = point[:, None] - outline
    # A point in a convex counter-clockwise polygon lies to the left of every edge.
    left = edge[..., 0] * away[..., 1] - edge[..., 1] * away[..., 0]
    slack = 1e-9 * np.abs(outline).max(axis=(1, 2)) ** 2
    outlined = (left >= -slack[:, None]).all(axis=1)
    none = np.zeros((0, generators.shape[2]))
    held = membership.contains(np.zeros_like(center), generators, none, np.zeros(0), relative)
    return np.asarray(boxed & outlined & held)
