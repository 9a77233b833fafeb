"""The newest of each vehicle, a row each, in arrays that grow."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import StateFlag, VehicleProfile
from fleet_bus.messages.state import StateBatch
from fleet_bus.pubsub import Received
from fleet_dashboard.picture import MOST_EXTENT, NO_TUBE, SILENT_SECONDS, Mark, Picture
from fleet_dashboard.tube_batch import TubeBatch

#: Vehicles that are kept: who invents ids shall not fill the memory.
MOST_VEHICLES: Final = 20_000
#: Samples of a vehicle whose arrival is remembered until their tube comes.
_REMEMBERED: Final = 16
_SILENT_NS: Final = round(SILENT_SECONDS * 1e9)


def _columns(rows: int, steps: int, corners: int) -> dict[str, NDArray[Any]]:
    """Empty rows: what is not known is NaN, -1 or 0."""
    nan, single = np.full(rows, np.nan), np.full(rows, np.nan, dtype=np.float32)
    whole = np.zeros(rows, dtype=np.int64)
    return {
        "position": np.full((rows, 2), np.nan), "heading": single.copy(), "sampled": whole.copy(),
        "tubed": whole.copy(),
        "label": np.full(rows, NO_TUBE, dtype=np.uint8), "area": nan.copy(), "area_free": nan.copy(),
        "coverage": single.copy(), "nominal": single.copy(), "latency": single.copy(), "compute": single.copy(),
        "server": np.zeros(rows, dtype=np.uint16), "steps": np.zeros(rows, dtype=np.uint16),
        "center": np.zeros((rows, steps, 2)),
        "outline": np.zeros((rows, steps, corners, 2), dtype=np.float32),
        "low": np.full((rows, 2), np.inf), "high": np.full((rows, 2), -np.inf),
        "profiled": np.zeros(rows, dtype=bool),
        "astray": np.zeros(rows, dtype=np.uint8), "roles": np.full((rows, 3), -1), "epoch": whole.copy(),
        "seq": whole - 1,
        "seen_seq": np.full((rows, _REMEMBERED), -1), "seen_at": np.zeros((rows, _REMEMBERED), dtype=np.int64),
    }  # fmt: skip


#: Columns that a picture has as they are; low and high are widened by the vehicle, and marks are made anew.
_SHOWN: Final = (
    "position", "heading", "sampled", "tubed", "label", "area", "area_free", "coverage", "nominal", "latency",
    "compute", "server", "steps", "center", "outline",
)  # fmt: skip


class VehicleTable:
    """Rows of vehicles; a vehicle keeps its row."""

    def __init__(self) -> None:
        self.ids: list[str] = []
        #: Names of servers; a row's ``server`` is a place in it, 0 for none.
        self.servers: list[str] = [""]
        self._servers: dict[str, int] = {"": 0}
        self._rows: dict[str, int] = {}
        self._steps, self._corners = 1, 4
        self._data = _columns(16, self._steps, self._corners)

    def row(self, vehicle: str) -> int:
        """The row of a vehicle, a new one if need be; -1 for one more than ``MOST_VEHICLES``."""
        row = self._rows.get(vehicle)
        if row is None:
            if len(self.ids) >= MOST_VEHICLES:
                return -1
            row = self._rows[vehicle] = len(self.ids)
            self.ids.append(vehicle)
            if len(self.ids) > len(self._data["label"]):
                self._grow(2 * len(self.ids), self._steps, self._corners)
        return row

    def find(self, vehicle: str) -> int | None:
        """The row of a vehicle, None if nothing has come from it."""
        return self._rows.get(vehicle)

    def _grow(self, rows: int, steps: int, corners: int) -> None:
        grown = _columns(rows, steps, corners)
        for name, old in self._data.items():
            grown[name][tuple(slice(size) for size in old.shape)] = old
        if corners > self._corners:
            # The last corner is repeated, which changes nothing of a polygon.
            old = self._data["outline"]
            grown["outline"][: len(old), : self._steps, self._corners :] = old[:, :, -1:]
        self._data, self._steps, self._corners = grown, steps, corners

    def profile(self, vehicle: str, profile: VehicleProfile) -> bool:
        """Note which states of a vehicle are its position and heading, and the rate that is asked for; whether it has a
        row."""
        row, roles = self.row(vehicle), profile.roles
        if row < 0:
            return False
        names = profile.state_names
        self._data["roles"][row] = -1
        if roles.position is not None:
            self._data["roles"][row, :2] = [names.index(name) for name in roles.position]
        if roles.heading is not None:
            self._data["roles"][row, 2] = names.index(roles.heading)
        self._data["nominal"][row] = 1.0 if profile.guaranteed else profile.confidence
        self._data["profiled"][row] = True
        return True

    def astray(self, vehicle: str, marks: Mark) -> None:
        """Note what a vehicle does that it should not: ``Mark.LEFT`` and ``Mark.VIOLATES``, or neither."""
        row = self.row(vehicle)
        if row >= 0:
            self._data["astray"][row] = marks

    def states(self, rows: NDArray[np.intp], batch: StateBatch, arrived: NDArray[np.int64]) -> None:
        """Take samples in: ``rows`` (B,), -1 for those to be left out, and when they ``arrived`` (B,) in ns. Of a
        vehicle the last of them counts."""
        live = ((batch.flags & np.uint32(StateFlag.HISTORY)) == 0) & (rows >= 0)
        rows, x, arrived = rows[live], batch.x[live], arrived[live]
        seq = batch.seq[live].astype(np.int64)
        data = self._data
        data["seen_seq"][rows, seq % _REMEMBERED] = seq
        data["seen_at"][rows, seq % _REMEMBERED] = arrived
        # Later ones are written last; numpy does not promise which of several wins, so that only one is left.
        rows, last = np.unique(rows[::-1], return_index=True)
        x, arrived = x[::-1][last], arrived[::-1][last]
        data["sampled"][rows] = np.maximum(data["sampled"][rows], arrived)
        roles = data["roles"][rows]
        known = (roles[:, :2] >= 0).all(axis=1) & (roles < x.shape[1]).all(axis=1)
        chosen = np.take_along_axis(x[known], np.maximum(roles[known], 0), axis=1)
        data["position"][rows[known]] = chosen[:, :2]
        data["heading"][rows[known]] = np.where(roles[known, 2] >= 0, chosen[:, 2], np.nan).astype(np.float32)

    def tubes(self, batch: TubeBatch, arrived: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Take tubes in, of each vehicle one, ``arrived`` (B,) in ns; which of them were taken (B,): those that are not
        older than what was there, of vehicles that have a row."""
        rows = np.array([self.row(vehicle) for vehicle in batch.vehicles], dtype=np.intp)
        steps, corners = batch.outline.shape[1:3]
        if steps > self._steps or corners > self._corners:
            self._grow(len(self._data["label"]), max(steps, self._steps), max(corners, self._corners))
        data = self._data
        # An epoch that is less belongs to an agent that has been replaced, or to a recording that begins again.
        newer = (rows >= 0) & ((batch.epoch != data["epoch"][rows]) | (batch.seq >= data["seq"][rows]))
        servers = [self._server(fields["sv"]) for fields in batch.fields]
        rows, chosen = rows[newer], np.flatnonzero(newer)
        data["epoch"][rows], data["seq"][rows] = batch.epoch[chosen], batch.seq[chosen]
        data["tubed"][rows] = arrived[chosen]
        data["label"][rows] = batch.label[chosen]
        data["area"][rows], data["area_free"][rows] = batch.area[chosen], batch.area_free[chosen]
        data["compute"][rows] = batch.compute[chosen]
        data["server"][rows] = np.array(servers, dtype=np.uint16)[chosen]
        data["steps"][rows] = steps
        data["center"][rows, :steps] = batch.center[chosen]
        data["outline"][rows, :steps, :corners] = batch.outline[chosen]
        data["outline"][rows, :steps, corners:] = batch.outline[chosen][:, :, -1:]
        for axis in (0, 1):
            # One coordinate after the other: numpy is slow where the innermost axis is short.
            vertices = batch.center[chosen, :, axis, None] + batch.outline[chosen, :, :, axis]
            vertices = vertices.reshape(len(chosen), steps * corners)
            data["low"][rows, axis], data["high"][rows, axis] = vertices.min(axis=1), vertices.max(axis=1)
        recent = batch.audit[chosen, 3]
        with np.errstate(invalid="ignore", divide="ignore"):
            data["coverage"][rows] = np.where(recent > 0, batch.audit[chosen, 4] / recent, np.nan)
        slot = batch.seq[chosen] % _REMEMBERED
        known = data["seen_seq"][rows, slot] == batch.seq[chosen]
        latency = (arrived[chosen] - data["seen_at"][rows, slot]) / 1e9
        data["latency"][rows] = np.where(known & (latency >= 0), latency, np.nan)
        return np.asarray(newer)

    def _server(self, name: str) -> int:
        place = self._servers.get(name)
        if place is None:
            # Who invents names of servers is shown as one without a name.
            if len(self.servers) > 1000:
                return 0
            place = self._servers[name] = len(self.servers)
            self.servers.append(name)
        return place

    def picture(self, number: int, t: int, silent_servers: Sequence[str] = ()) -> Picture:
        """What is true at ``t`` (ns), where some servers are silent."""
        count = len(self.ids)
        shown = {name: self._data[name][:count].copy() for name in _SHOWN}
        low, high = self._data["low"][:count].copy(), self._data["high"][:count].copy()
        position = shown["position"]
        lost = np.isnan(position[:, 0]) & (shown["steps"] > 0)
        position[lost] = shown["center"][lost, 0]
        marks = self._data["astray"][:count].copy()
        sampled, tubed = shown["sampled"], shown["tubed"]
        marks[(sampled > 0) & (t - sampled > _SILENT_NS)] |= np.uint8(Mark.SILENT)
        marks[(tubed > 0) & (t - tubed > _SILENT_NS)] |= np.uint8(Mark.TUBE_OLD)
        silent = [self._servers[name] for name in silent_servers if name in self._servers]
        marks[np.isin(shown["server"], silent) & (tubed > 0)] |= np.uint8(Mark.SERVER_SILENT)
        marks[~self._data["profiled"][:count]] |= np.uint8(Mark.NO_PROFILE)
        with np.errstate(over="ignore", invalid="ignore"):
            large = ~((high - low).max(axis=1, initial=0) <= MOST_EXTENT) & (shown["steps"] > 0)
        marks[large] |= np.uint8(Mark.TOO_LARGE)
        placed = np.isfinite(position).all(axis=1)
        marks[~placed] |= np.uint8(Mark.NO_POSE)
        low[large], high[large] = np.inf, -np.inf
        low[placed] = np.minimum(low[placed], position[placed])
        high[placed] = np.maximum(high[placed], position[placed])
        return Picture(number, t, self.ids, marks=marks, low=low, high=high, acting=frozenset(), **shown)


def arrivals(messages: Sequence[Received], index: NDArray[np.intp]) -> NDArray[np.int64]:
    """When some of the messages arrived, ns."""
    return np.array([messages[i].arrived_ns for i in index.tolist()], dtype=np.int64)
