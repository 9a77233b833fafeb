"""From bytes to samples by vehicle: decoding, refusing, and keeping samples until their profile has come."""

from collections import defaultdict, deque
from dataclasses import dataclass
from itertools import repeat
from threading import Lock
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus import keys
from fleet_bus.errors import KeyIdError, MessageError
from fleet_bus.messages import StateBatch, decode_states
from fleet_bus.pubsub import Received
from fleet_bus.rejections import Rejections

#: States that may wait for the engine; at 125 bytes each about a gigabyte.
MAX_WAITING: Final = 4_000_000


@dataclass(frozen=True, slots=True, eq=False)
class VehicleBatch:
    """Samples of equal layout; ``vehicles`` names the vehicle of each row, ``sessions`` the session that sent it, and
    ``arrived_ns`` (B,) when it came (Unix ns), where that is known."""

    vehicles: tuple[str, ...]
    states: StateBatch
    sessions: tuple[str, ...] | None = None
    arrived_ns: NDArray[np.int64] | None = None

    def by_writer(self) -> dict[tuple[str, str, int], list[int]]:
        """Rows by (vehicle, session, epoch), in the order in which these came."""
        found: defaultdict[tuple[str, str, int], list[int]] = defaultdict(list)
        sessions = self.sessions or repeat("")
        for row, writer in enumerate(zip(self.vehicles, sessions, self.states.epoch.tolist(), strict=False)):
            found[writer].append(row)
        return found


class Ingest:
    """The queue between the network thread, which only appends, and the engine, which takes all there is."""

    def __init__(self, rejections: Rejections, limit: int = MAX_WAITING) -> None:
        self._rejections = rejections
        self._limit = limit
        self._queue: deque[Received] = deque()
        self._lock = Lock()
        self.received = 0

    def put(self, received: Received) -> None:
        """Append one message; beyond the limit it is refused and counted (overflow)."""
        with self._lock:
            self.received += 1
            full = len(self._queue) >= self._limit
            if not full:
                self._queue.append(received)
        if full:
            self._rejections.count(MessageError("overflow", f"{self._limit} states wait already"), received.key)

    @property
    def queued(self) -> int:
        """Messages that wait to be taken."""
        return len(self._queue)

    def take(self) -> list[tuple[str, Received]]:
        """Everything that has come since, with its vehicle; what has a key that names none is counted."""
        with self._lock:
            taken, self._queue = self._queue, deque()
        found: list[tuple[str, Received]] = []
        for received in taken:
            try:
                found.append((keys.vehicle_of(received.key), received))
            except KeyIdError as unusable:
                self._rejections.count(MessageError("key", str(unusable)), received.key)
        return found

    def drain(self) -> list[VehicleBatch]:
        """Everything that has come since, decoded; what cannot be accepted is counted by reason."""
        return decoded(self.take(), self._rejections)


def decoded(taken: list[tuple[str, Received]], rejections: Rejections) -> list[VehicleBatch]:
    """Samples with their vehicles in batches of equal layout; what cannot be accepted is counted by reason.

    Which batches come out, and in which order, depends on nothing but the samples and their order.
    """
    batches, refused = decode_states([r.payload for _, r in taken], [r.encoding for _, r in taken])
    for index, error in refused:
        rejections.count(error, taken[index][1].key)
    found: list[VehicleBatch] = []
    for batch in batches:
        rows = [taken[i] for i in batch.index.tolist()]
        arrived = np.array([received.arrived_ns for _, received in rows], dtype=np.int64)
        known = arrived if arrived.all() else None
        names = tuple(vehicle for vehicle, _ in rows)
        found.append(VehicleBatch(names, batch, tuple(received.source for _, received in rows), known))
    return found
