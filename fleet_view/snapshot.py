"""The fleet at one moment: a column for each thing that is known of vehicles, to sort and to pick rows from."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Event, EventKind, Label, ReachTube

if TYPE_CHECKING:
    from fleet_view.view import Service

LABELS: Final = tuple(Label)
#: Events that say why a tube is contradicted, or no longer cut.
AGAINST: Final = frozenset(
    {
        EventKind.CONTRADICTION, EventKind.MISS, EventKind.DATA_CONTRADICTED, EventKind.COVERAGE, EventKind.TWO_SOURCES,
        EventKind.PROFILE_CONTRADICTED,
    }
)  # fmt: skip


class Condition(IntEnum):
    """How a vehicle is, the worst first."""

    CONTRADICTED = 0  #: what was measured has refuted the label, or the side information
    STALE = 1  #: nothing has come for a while
    WAITING = 2  #: it has no tube
    OUT_OF_BAND = 3  #: more misses than the confidence explains
    UNCOVERED = 4
    CALIBRATED = 5
    GUARANTEED = 6


@dataclass(frozen=True, slots=True)
class VehicleRow:
    """One vehicle at one moment; None for what is not known.

    Attributes:
        condition: the worst that is to be said of it.
        label: that of its newest tube.
        stale: whether nothing has come for longer than it should.
        sample_age: seconds since its newest sample came; ``tube_age`` since its newest tube did.
        area: of the position set at the end of the horizon, squared position unit; ``area_free`` without side
            information.
        checked: one-step predictions checked in all, ``inside`` that held; ``recent`` and ``recent_inside`` among the
            newest; ``band``: how many misses among these the confidence explains.
        nominal: share that is to hold: 1 for ``guaranteed``, the profile's confidence for ``calibrated``.
        server: id of the server of its newest tube.
        why: what an operator should know first: why it is contradicted, stale or waits, else the notes of its tube.
        batch_seconds: what the batch with its newest tube took to compute.
    """

    vehicle: str
    condition: Condition
    label: Label | None
    stale: bool
    sample_age: float | None
    tube_age: float | None
    area: float | None
    area_free: float | None
    checked: int
    inside: int
    recent: int
    recent_inside: int
    band: int
    nominal: float | None
    server: str | None
    why: str
    batch_seconds: float | None

    @property
    def coverage(self) -> float | None:
        """Share of the newest checks that held."""
        return self.recent_inside / self.recent if self.recent else None

    @property
    def age(self) -> float | None:
        """Of the tube; of the sample where there is none."""
        return self.sample_age if self.tube_age is None else self.tube_age


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """Vehicles at ``now`` (s): ``names`` (K,) and columns (K,) of the same order.

    Attributes:
        columns: ``label`` (index into ``LABELS``, -1 for none), ``sample_at``, ``tube_at``, ``heard_at`` (s, -inf for
            never), ``area``, ``area_free``, ``nominal``, ``compute`` (NaN for none), ``checked``, ``inside``,
            ``recent``, ``recent_inside``, ``band``.
        condition: (K,) ``Condition`` of each.
        stale: (K,) bool.
        rank: (K,) place of each in the order of names.
    """

    now: float
    names: tuple[str, ...]
    columns: Mapping[str, NDArray[Any]]
    condition: NDArray[np.int8]
    stale: NDArray[np.bool_]
    rank: NDArray[np.intp]
    tubes: Mapping[str, ReachTube]
    waiting: Mapping[str, str]
    refused: Mapping[str, str]
    newest_event: Mapping[str, Event]
    services: Mapping[str, "Service"]
    service_stale_after: float

    def __len__(self) -> int:
        return len(self.names)

    def select(self, pattern: str | None) -> NDArray[np.intp]:
        """Indices of the vehicles whose name a pattern with ``*``, ``?`` and ``[…]`` fits; all for None."""
        if pattern is None:
            return np.arange(len(self.names), dtype=np.intp)
        return np.array([i for i, name in enumerate(self.names) if fnmatchcase(name, pattern)], dtype=np.intp)

    def order(self, indices: NDArray[np.intp], by: str) -> NDArray[np.intp]:
        """Indices in an order of ``SORTS``: the worst, oldest, largest or least covered first, then by name.

        Raises ``KeyError`` for another order.
        """
        keys = SORTS[by](self)
        return indices[np.lexsort((self.rank[indices], *(key[indices] for key in reversed(keys))))]

    def worst(self, indices: NDArray[np.intp], by: str, most: int) -> NDArray[np.intp]:
        """At most ``most`` of some vehicles, in an order: the first of it; where that is by name, the worst ones."""
        if by == "name" and len(indices) > most:
            return self.order(self.order(indices, "label")[:most], "name")
        return self.order(indices, by)[:most]

    def counts(self, indices: NDArray[np.intp]) -> dict[Condition, int]:
        """How many of some vehicles are in which condition, the worst first."""
        found = np.bincount(self.condition[indices], minlength=len(Condition))
        return {condition: int(found[condition]) for condition in Condition if found[condition]}

    def row(self, index: int) -> VehicleRow:
        """All that is known of one vehicle."""
        name = self.names[index]
        tube = self.tubes.get(name)
        columns = self.columns
        label = int(columns["label"][index])
        return VehicleRow(
            vehicle=name,
            condition=Condition(int(self.condition[index])),
            label=None if label < 0 else LABELS[label],
            stale=bool(self.stale[index]),
            sample_age=_known(self.now - columns["sample_at"][index]),
            tube_age=_known(self.now - columns["tube_at"][index]),
            area=_known(columns["area"][index]),
            area_free=_known(columns["area_free"][index]),
            checked=int(columns["checked"][index]),
            inside=int(columns["inside"][index]),
            recent=int(columns["recent"][index]),
            recent_inside=int(columns["recent_inside"][index]),
            band=int(columns["band"][index]),
            nominal=_known(self.nominal[index]),
            server=None if tube is None else tube.server,
            why=self._why(index, tube),
            batch_seconds=_known(columns["compute"][index]),
        )

    @property
    def nominal(self) -> NDArray[np.float64]:
        """(K,) share that is to hold, NaN where none is known."""
        guaranteed = self.columns["label"] == LABELS.index(Label.GUARANTEED)
        return np.where(guaranteed, 1.0, self.columns["nominal"])

    def _why(self, index: int, tube: ReachTube | None) -> str:
        name = self.names[index]
        parts = []
        event = self.newest_event.get(name)
        if self.condition[index] == Condition.CONTRADICTED and event is not None:
            parts.append(f"{event.kind}: {_told(event)}")
        if self.stale[index]:
            parts.append(self._silence(index, tube))
        elif name in self.waiting:
            parts.append(f"waits: {self.waiting[name]}")
        elif tube is None and name not in self.refused:
            parts.append("no tube yet" if self._serves() else "no tube: no reach server is up")
        if name in self.refused:
            parts.append(self.refused[name])
        columns = self.columns
        if columns["recent"][index] - columns["recent_inside"][index] > columns["band"][index]:
            missed = columns["recent"][index] - columns["recent_inside"][index]
            parts.append(f"{missed} of {columns['recent'][index]} missed, {columns['band'][index]} are explained")
        if tube is not None:
            parts += tube.notes
        return "; ".join(parts)

    def _silence(self, index: int, tube: ReachTube | None) -> str:
        silent = self.now - self.columns["sample_at"][index]
        tubes = self.now - self.columns["tube_at"][index]
        if tube is None:
            return "nothing comes" if not np.isfinite(silent) else f"no sample for {silent:.0f} s"
        # Samples go on: it is the server that is silent.
        if silent < tubes - 1.0:
            server = self.services.get(f"reach/{tube.server}")
            quiet = server is None or self.now - server.at > self.service_stale_after
            return f"server {tube.server} is silent" if quiet else f"samples come, no tube of {tube.server}"
        return "no samples come"

    def _serves(self) -> bool:
        return any(
            s.status.kind == "reach" and self.now - s.at <= self.service_stale_after for s in self.services.values()
        )


def _told(event: Event) -> str:
    """What an event is about, in few words where its details have them."""
    scenario, predicate = (event.details.get(name) for name in ("scenario", "predicate"))
    if event.kind is EventKind.CONTRADICTION and scenario:
        return f"{scenario} ({predicate})" if predicate else str(scenario)
    return event.message


def _age(snapshot: Snapshot) -> NDArray[np.float64]:
    at = snapshot.columns["tube_at"]
    return -(snapshot.now - np.where(np.isfinite(at), at, snapshot.columns["heard_at"]))


def _margin(snapshot: Snapshot) -> NDArray[np.float64]:
    """By how much the coverage lies above the nominal one; vehicles without either come last."""
    recent = np.maximum(snapshot.columns["recent"], 1)
    margin = snapshot.columns["recent_inside"] / recent - snapshot.nominal
    return np.where((snapshot.columns["recent"] > 0) & np.isfinite(margin), margin, np.inf)


def _largest(column: str) -> Callable[[Snapshot], tuple[NDArray[Any], ...]]:
    def keys(snapshot: Snapshot) -> tuple[NDArray[Any], ...]:
        values = snapshot.columns[column]
        return (np.where(np.isfinite(values), -values, np.inf),)

    return keys


#: By name what vehicles can be sorted by: keys (K,) of which the least comes first, the most important key first.
SORTS: Final[Mapping[str, Callable[[Snapshot], tuple[NDArray[Any], ...]]]] = {
    "label": lambda s: (s.condition,),
    "age": lambda s: (_age(s),),
    "area": _largest("area"),
    "coverage": lambda s: (_margin(s),),
    "name": lambda s: (),
}


def _known(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
