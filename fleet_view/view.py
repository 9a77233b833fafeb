"""What is known of the fleet from the messages that came: fed with decoded ones and when they came, asked any time."""

import re
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus import keys
from fleet_bus.errors import KeyIdError, MessageError
from fleet_bus.messages import Event, Label, ReachTube, ServiceStatus, VehicleProfile
from fleet_view.batches import Batches, Compute
from fleet_view.rows import Rows
from fleet_view.snapshot import AGAINST, LABELS, Condition, Snapshot
from fleet_view.traffic import Traffic

#: The note of a tube whose side information was refuted.
REFUTED: Final = "side information contradicted"
#: Services that are remembered at most.
MOST_SERVICES: Final = 1000

_FILL: Final = {
    "label": np.int8(-1), "sample_at": -np.inf, "tube_at": -np.inf, "heard_at": -np.inf, "area": np.nan,
    "area_free": np.nan, "nominal": np.nan, "interval": 0.0, "compute": np.nan, "checked": 0, "inside": 0, "recent": 0,
    "recent_inside": 0, "band": 0, "refuted": False,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Service:
    """The newest status of a service, and when (s) it came."""

    status: ServiceStatus
    at: float


@dataclass(frozen=True, slots=True)
class Refused:
    """How many messages were refused for one reason, and the newest of them: its key, what was wrong, when (s)."""

    count: int
    key: str
    detail: str
    at: float


class FleetView:
    """Vehicles, services, events and traffic, as far as messages tell.

    All times are seconds of one clock that never goes back, handed in with each message and each question. Memory is
    bounded: ``most_vehicles`` vehicles, ``most_events`` events; vehicles and services of which nothing has come for
    ``forget_after`` seconds are forgotten. A service is stale after ``stale_after`` seconds without a status, a vehicle
    as long after its newest tube (its newest message where it has none), or after three of its sample times.

    Attributes:
        traffic: messages and bytes by key.
        events: the newest ones, in the order in which they came.
        services: by ``kind/instance``.
        refused: messages that could not be read, by reason.
        told: how many events came in all.
        skipped: messages that were counted but not looked at, since newer ones of their key had come.
    """

    def __init__(
        self,
        *,
        stale_after: float = 3.0,
        forget_after: float = 600.0,
        window: float = 10.0,
        most_events: int = 1000,
        most_vehicles: int = 20_000,
    ) -> None:
        self.stale_after = stale_after
        self.forget_after = forget_after
        self.traffic = Traffic(window)
        self.events: deque[Event] = deque(maxlen=most_events)
        self.services: dict[str, Service] = {}
        self.refused: dict[str, Refused] = {}
        self.skipped = 0
        self.told = 0
        self._window = window
        self._rows = Rows({name: np.asarray(value) for name, value in _FILL.items()}, most_vehicles)
        self._tubes: dict[str, ReachTube] = {}
        self._batches: dict[str, Batches] = {}
        self._waiting: dict[str, tuple[str, str]] = {}
        self._refused: dict[str, tuple[float, str]] = {}
        self._names: tuple[tuple[str, ...], NDArray[np.intp]] = (), np.zeros(0, dtype=np.intp)
        self._next_sweep = -np.inf

    @property
    def crowded_out(self) -> int:
        """Messages of vehicles beyond ``most_vehicles``."""
        return self._rows.refused

    def samples(self, vehicles: Sequence[str], times: Sequence[float]) -> None:
        """A sample of each of some vehicles came, each at its time; history is not to be told of."""
        for vehicle, now in zip(vehicles, times, strict=True):
            self._heard(vehicle, now, "sample_at")

    def tube(self, tube: ReachTube, now: float, vehicle: str | None = None) -> None:
        """A tube came; ``vehicle`` is that of its key, by default its own."""
        name = tube.vehicle if vehicle is None else vehicle
        self._batches_of(tube.server).tube(tube.compute_seconds, now)
        row = self._heard(name, now, "tube_at")
        if row is None:
            return
        self._tubes[name] = tube
        rows, audit = self._rows, tube.audit
        rows["label"][row] = LABELS.index(tube.label)
        rows["area"][row], rows["area_free"][row] = (a[-1] if len(a) else np.nan for a in (tube.area, tube.area_free))
        rows["compute"][row] = tube.compute_seconds
        rows["refuted"][row] = REFUTED in tube.notes
        for column in ("checked", "inside", "recent", "recent_inside", "band"):
            rows[column][row] = getattr(audit, column)

    def profile(self, vehicle: str, profile: VehicleProfile, now: float) -> None:
        """The profile of a vehicle came."""
        row = self._heard(vehicle, now)
        if row is not None:
            self._rows["nominal"][row] = profile.confidence
            self._rows["interval"][row] = profile.sample_time

    def event(self, event: Event) -> None:
        """An event came."""
        self.events.append(event)
        self.told += 1

    def status(self, status: ServiceStatus, now: float) -> None:
        """The status of a service came."""
        name = f"{status.kind}/{status.instance}"
        if name not in self.services and len(self.services) >= MOST_SERVICES:
            return
        self.services[name] = Service(status, now)
        if status.kind != "reach":
            return
        gone = [v for v, (server, _) in self._waiting.items() if server == name and v not in status.waiting]
        for vehicle in gone:
            del self._waiting[vehicle]
        for vehicle, why in status.waiting.items():
            if self._heard(vehicle, now) is not None:
                self._waiting[vehicle] = name, why

    def count(self, key: str, size: int, now: float) -> None:
        """A message of ``size`` bytes came on a key, whatever is in it."""
        self.traffic.count(key, size, now)

    def refuse(self, error: MessageError, key: str, now: float) -> None:
        """A message on a key could not be read."""
        known = self.refused.get(error.reason)
        self.refused[error.reason] = Refused(1 + (known.count if known else 0), key, error.detail, now)
        try:
            vehicle = keys.vehicle_of(key)
        except KeyIdError:
            return
        kind = key.rpartition("/")[2]
        if kind in ("state", "tube", "profile") and self._heard(vehicle, now) is not None:
            self._refused[vehicle] = now, f"{kind} refused ({error.reason}): {error.detail}"

    def skip(self, count: int) -> None:
        """Tubes were not looked at, since newer ones had come."""
        self.skipped += count
        for batches in self._batches.values():
            batches.gap()

    def compute(self, now: float) -> dict[str, Compute]:
        """By server, how long its batches took over the window."""
        return {server: batches.compute(now) for server, batches in self._batches.items()}

    def events_of(self, pattern: str | None = None) -> list[Event]:
        """The events of vehicles whose name a pattern fits, in the order in which they came; all for None."""
        if pattern is None:
            return list(self.events)
        return [e for e in self.events if e.vehicle is not None and fnmatchcase(e.vehicle, pattern)]

    def newest_tube(self, vehicle: str) -> ReachTube | None:
        """The newest tube of a vehicle."""
        return self._tubes.get(vehicle)

    def stale_services(self, now: float) -> list[str]:
        """``kind/instance`` of the services that have been silent for too long."""
        return [name for name, service in self.services.items() if now - service.at > self.stale_after]

    def snapshot(self, now: float) -> Snapshot:
        """All vehicles at ``now``."""
        self._sweep(now)
        used = self._rows.used()
        columns = {name: self._rows[name][used] for name in _FILL}
        names, rank = self._named(used)
        has_tube = columns["label"] >= 0
        silent = now - np.where(has_tube, columns["tube_at"], columns["heard_at"])
        stale = silent > np.maximum(self.stale_after, 3 * columns["interval"])
        waiting = self._waits(now)
        waits = ~has_tube
        if waiting:
            waits |= np.fromiter((name in waiting for name in names), dtype=bool, count=len(names))
        missing = columns["recent"] - columns["recent_inside"] > columns["band"]
        contradicted = (columns["label"] == LABELS.index(Label.CONTRADICTED)) | columns["refuted"]
        condition = np.select(
            [contradicted, stale, waits, missing, columns["label"] == LABELS.index(Label.UNCOVERED),
             columns["label"] == LABELS.index(Label.CALIBRATED)],
            [Condition.CONTRADICTED, Condition.STALE, Condition.WAITING, Condition.OUT_OF_BAND, Condition.UNCOVERED,
             Condition.CALIBRATED],
            Condition.GUARANTEED,
        )  # fmt: skip
        told = {e.vehicle: e for e in self.events if e.vehicle is not None and e.kind in AGAINST}
        return Snapshot(
            now, names, columns, condition.astype(np.int8), stale, rank, self._tubes, waiting, self._unreadable(now),
            told, self.services, self.stale_after,
        )  # fmt: skip

    def _heard(self, vehicle: str, now: float, column: str = "heard_at") -> int | None:
        row = self._rows.row(vehicle)
        if row is not None:
            self._rows[column][row] = self._rows["heard_at"][row] = now
        return row

    def _batches_of(self, server: str) -> Batches:
        if server not in self._batches and len(self._batches) >= MOST_SERVICES:
            self._batches.clear()
        return self._batches.setdefault(server, Batches(self._window))

    def _waits(self, now: float) -> dict[str, str]:
        """By vehicle why it waits, as far as the server that says so is up and no tube has come since."""
        found = {}
        for vehicle, (name, why) in self._waiting.items():
            service, row = self.services.get(name), self._rows.find(vehicle)
            if service is None or row is None or now - service.at > self.stale_after:
                continue
            if self._rows["tube_at"][row] < service.at:
                found[vehicle] = why
        return found

    def _unreadable(self, now: float) -> dict[str, str]:
        """By vehicle what of it could not be read, of late and after its newest tube."""
        return {
            vehicle: text
            for vehicle, (at, text) in self._refused.items()
            if now - at <= self._window and self._rows["tube_at"][self._rows.find(vehicle) or 0] < at
        }

    def _named(self, used: NDArray[np.intp]) -> tuple[tuple[str, ...], NDArray[np.intp]]:
        names = tuple(self._rows.names[index] or "" for index in used.tolist())
        if names != self._names[0]:
            order = sorted(range(len(names)), key=lambda i: natural(names[i]))
            rank = np.empty(len(names), dtype=np.intp)
            rank[order] = np.arange(len(names))
            self._names = names, rank
        return self._names

    def _sweep(self, now: float) -> None:
        """Forget what has been gone for long; looked for once a second."""
        if now < self._next_sweep:
            return
        self._next_sweep = now + 1.0
        used = self._rows.used()
        gone = used[now - self._rows["heard_at"][used] > self.forget_after]
        self._forget([self._rows.names[index] or "" for index in gone.tolist()])
        for name in [n for n, service in self.services.items() if now - service.at > self.forget_after]:
            del self.services[name]

    def _forget(self, vehicles: Iterable[str]) -> None:
        names = list(vehicles)
        self._rows.forget(names)
        for held in (self._tubes, self._waiting, self._refused):
            for name in names:
                held.pop(name, None)
        self.traffic.forget(key for name in names for key in keys_of(name))


def keys_of(vehicle: str) -> tuple[str, ...]:
    """The keys on which messages of and about a vehicle come, but for its assignments."""
    return tuple(make(vehicle) for make in (keys.state, keys.truth, keys.profile, keys.tube, keys.event))


def natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """What names are sorted by, so that ``car10`` comes after ``car9``."""
    return tuple((0, int(part), "") if part.isdigit() else (1, 0, part) for part in re.split(r"(\d+)", name) if part)
