"""What has been shown in the last minutes: pictures to go back to, and series to plot."""

from bisect import bisect_right
from threading import Lock
from typing import Final

import numpy as np

from fleet_dashboard.picture import Floats, Picture, Singles

SPAN_SECONDS: Final = 300.0
BUDGET_BYTES: Final = 192 * 2**20
_LEAST_INTERVAL: Final = 0.1


class History:
    """Pictures of the last ``span`` seconds in ``budget`` bytes; where they do not fit, fewer a second are kept."""

    def __init__(self, span: float = SPAN_SECONDS, budget: int = BUDGET_BYTES) -> None:
        self._span_ns = span * 1e9
        self._budget = budget
        self._interval_ns = _LEAST_INTERVAL * 1e9
        self._lock = Lock()
        self._times: list[int] = []
        self._pictures: list[Picture] = []
        self.nbytes = 0

    def add(self, picture: Picture) -> bool:
        """Keep a picture if it is its turn; whether it was. Times must not decrease."""
        with self._lock:
            if self._times and picture.t - self._times[-1] < self._interval_ns * 0.9:
                return False
            self._times.append(picture.t)
            self._pictures.append(picture)
            self.nbytes += picture.nbytes
            gone = bisect_right(self._times, picture.t - self._span_ns)
            if gone:
                self._drop(list(range(gone, len(self._times))))
            while self.nbytes > self._budget and len(self._times) > 2:
                # The newest stays, and every second one of the others: the span stays, the steps become longer.
                self._interval_ns *= 2
                self._drop(sorted({*range(0, len(self._times), 2), len(self._times) - 1}))
            return True

    def _drop(self, kept: list[int]) -> None:
        self._times = [self._times[i] for i in kept]
        self._pictures = [self._pictures[i] for i in kept]
        self.nbytes = sum(picture.nbytes for picture in self._pictures)

    def at(self, t: int) -> Picture | None:
        """The picture in force at ``t`` (ns): the newest not after it, else the oldest; None if there is none."""
        with self._lock:
            if not self._times:
                return None
            return self._pictures[max(0, bisect_right(self._times, t) - 1)]

    def span(self) -> tuple[int, int] | None:
        """Times (ns) of the oldest and newest picture."""
        with self._lock:
            return (self._times[0], self._times[-1]) if self._times else None


class Series:
    """Figures of each vehicle and of the fleet, one a second, the newest ``length`` of them."""

    #: Figures of a vehicle.
    VEHICLE: Final = ("area", "area_free", "latency", "coverage")
    #: Figures of the fleet.
    FLEET: Final = (
        "area", "area_free", "latency_p50", "latency_p99", "coverage", "samples", "tubes", "vehicles", "stale",
    )  # fmt: skip

    def __init__(self, length: int = 300) -> None:
        self._length = length
        self._count = 0
        self._times = np.zeros(length)
        self._fleet = np.full((length, len(self.FLEET)), np.nan)
        self._vehicles = np.full((16, length, len(self.VEHICLE)), np.nan, dtype=np.float32)

    def add(self, picture: Picture, samples: float, tubes: float) -> None:
        """Note a picture's figures, and how many samples and tubes a second came before it."""
        slot = self._count % self._length
        if len(picture) > len(self._vehicles):
            grown = np.full((2 * len(picture), *self._vehicles.shape[1:]), np.nan, dtype=np.float32)
            grown[: len(self._vehicles)] = self._vehicles
            self._vehicles = grown
        fresh = ~picture.stale() & (picture.steps > 0)
        columns = [np.where(fresh, getattr(picture, name), np.nan) for name in self.VEHICLE]
        self._vehicles[:, slot] = np.nan
        with np.errstate(over="ignore"):
            self._vehicles[: len(picture), slot] = np.stack(columns, axis=1)
        latency = picture.latency[fresh & np.isfinite(picture.latency)]
        p50, p99 = np.quantile(latency, (0.5, 0.99)) if len(latency) else (np.nan, np.nan)
        self._times[slot] = picture.t / 1e9
        self._fleet[slot] = (
            _mean(picture.area[fresh]), _mean(picture.area_free[fresh]), p50, p99, _mean(picture.coverage[fresh]),
            samples, tubes, len(picture), np.count_nonzero(picture.stale()),
        )  # fmt: skip
        self._count += 1

    def _order(self) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
        kept = min(self._count, self._length)
        return np.arange(self._count - kept, self._count) % self._length

    def fleet(self) -> tuple[Floats, Floats]:
        """Unix seconds (T,) and figures (T, F) of the fleet, oldest first."""
        order = self._order()
        return self._times[order], self._fleet[order]

    def at(self, t: int) -> dict[str, float]:
        """Figures of the fleet by name in force at ``t`` (ns); NaN before the first."""
        times, fleet = self.fleet()
        place = int(np.searchsorted(times, t / 1e9, side="right")) - 1
        return dict(zip(self.FLEET, fleet[place].tolist() if place >= 0 else [np.nan] * len(self.FLEET), strict=True))

    def vehicle(self, row: int) -> tuple[Floats, Singles]:
        """Unix seconds (T,) and figures (T, F) of the vehicle of a row, oldest first."""
        order = self._order()
        if row >= len(self._vehicles):
            return self._times[order], np.full((len(order), len(self.VEHICLE)), np.nan, dtype=np.float32)
        return self._times[order], self._vehicles[row][order]


def _mean(values: Floats | Singles) -> float:
    known = values[np.isfinite(values)]
    with np.errstate(over="ignore"):
        return float(np.mean(known)) if len(known) else float("nan")
