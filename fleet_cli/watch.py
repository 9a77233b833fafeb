"""``fleet watch``: vehicles, services and events at a glance, the worst first."""

from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rich.console import Group, RenderableType
from rich.text import Text

from fleet_bus.errors import UsageError
from fleet_bus.messages import Event
from fleet_cli.live import Moment, bus_line, refused_lines
from fleet_cli.terminal import Column, clock_time, fitted, printable, seconds
from fleet_view import FleetView, Snapshot, VehicleRow
from fleet_view.snapshot import AGAINST, SORTS, Condition

#: Events below the table, where there is room.
EVENTS: Final = 6
#: Vehicles that are shown at least, whatever else there is to say.
LEAST_ROWS: Final = 3

COLUMNS: Final = (
    Column("vehicle"),
    Column("label"),
    Column("age", dispensable=1, right=True),
    Column("sample", dispensable=6, right=True),
    Column("area", dispensable=2, right=True),
    Column("uncut", dispensable=5, right=True),
    Column("coverage", dispensable=3, right=True),
    Column("server", dispensable=4),
    Column("remark", rest=True),
)

_STYLES: Final[Mapping[Condition, str]] = {
    Condition.CONTRADICTED: "red", Condition.STALE: "dim", Condition.WAITING: "yellow", Condition.OUT_OF_BAND: "yellow",
}  # fmt: skip


class WatchScreen:
    """Draws a view; of its vehicles those whose name the pattern ``only`` fits, in the order ``sort``.

    Raises ``UsageError`` for an order that there is none of.
    """

    def __init__(self, view: FleetView, *, sort: str = "label", only: str | None = None) -> None:
        if sort not in SORTS:
            raise UsageError(f"--sort {sort!r:.40}: choose one of {', '.join(SORTS)}")
        self._view = view
        self._sort = sort
        self._only = only
        self._told = 0

    def draw(self, moment: Moment, width: int, height: int | None) -> RenderableType:
        """See ``Screen``."""
        snapshot = self._view.snapshot(moment.now)
        indices = snapshot.select(self._only)
        head = [*bus_line(moment), self._summary(snapshot, indices), *self._services(moment.now)]
        foot = refused_lines(self._view)
        events = self._events()[-EVENTS:]
        rows = len(indices)
        if height is not None:
            # The head of the table, and the line that says how many are not shown.
            room = height - len(head) - len(foot) - 2
            events = events[max(0, len(events) - max(0, room - LEAST_ROWS - 1)) :]
            rows = min(rows, max(1, room - len(events) - bool(events)))
        chosen = snapshot.worst(indices, self._sort, rows)
        parts: list[RenderableType] = list(head)
        if len(indices):
            shown = [snapshot.row(index) for index in chosen.tolist()]
            parts.append(fitted(COLUMNS, [_cells(row) for row in shown], [_style(row) for row in shown], width))
        if len(chosen) < len(indices):
            parts.append(Text(f"… and {len(indices) - len(chosen)} more vehicles", style="dim"))
        parts += ([Text("events", style="bold")] if events else []) + [event_text(event) for event in events]
        return Group(*parts, *foot)

    def lines(self, moment: Moment) -> Iterable[Mapping[str, Any]]:
        """See ``Screen``."""
        snapshot = self._view.snapshot(moment.now)
        indices = snapshot.select(self._only)
        counts = {str(c.name).lower(): n for c, n in snapshot.counts(indices).items()}
        stale = set(self._view.stale_services(moment.now))
        yield {
            "type": "fleet", "t": moment.t, "vehicles": len(indices), "conditions": counts,
            "router": not moment.lost, "servers": sum(
                service.status.kind == "reach" and name not in stale for name, service in self._view.services.items()
            ),
            "refused": {reason: known.count for reason, known in self._view.refused.items()},
            "skipped": self._view.skipped,
        }  # fmt: skip
        for name, service in sorted(self._view.services.items()):
            yield {
                "type": "service", "t": moment.t, "kind": service.status.kind, "instance": service.status.instance,
                "age": moment.now - service.at, "stale": name in stale, "waiting": len(service.status.waiting),
                "problems": service.status.problems,
            }  # fmt: skip
        for index in snapshot.order(indices, self._sort).tolist():
            yield {"type": "vehicle", "t": moment.t, **vehicle_document(snapshot.row(index))}
        new = self._view.told - self._told
        self._told = self._view.told
        for event in list(self._view.events)[-new:] if new else []:
            if self._only is None or (event.vehicle is not None and fnmatchcase(event.vehicle, self._only)):
                yield event_document(event)

    def _summary(self, snapshot: Snapshot, indices: NDArray[np.intp]) -> Text:
        if not len(snapshot):
            return Text("no vehicles yet: start one with `fleet agent`, or `fleet demo`", style="bold")
        if not len(indices):
            return Text(f"none of {len(snapshot)} vehicles is called {self._only}", style="bold")
        text = Text(f"{len(indices)} vehicle{'s' * (len(indices) != 1)}", style="bold")
        separator = ": "
        for condition, count in snapshot.counts(indices).items():
            text.append(separator)
            text.append(f"{count} {condition.name.lower().replace('_', ' ')}", style=_STYLES.get(condition, ""))
            separator = ", "
        return text

    def _services(self, now: float) -> list[Text]:
        stale = set(self._view.stale_services(now))
        lines = []
        if not any(s.status.kind == "reach" and name not in stale for name, s in self._view.services.items()):
            lines.append(Text("no server is up: start one with `fleet reach`", style="bold red"))
        if self._view.services:
            text = Text("services: ", no_wrap=True, overflow="ellipsis")
            for place, (name, service) in enumerate(sorted(self._view.services.items())):
                text.append(", " if place else "")
                if name in stale:
                    text.append(f"{name} stale {now - service.at:.0f} s", style="dim")
                else:
                    text.append(name)
                more = int(service.status.gauges.get("waiting", 0)) - len(service.status.waiting)
                if more > 0:
                    text.append(f" ({more} more wait than it names)", style="yellow")
            lines.append(text)
            lines += [
                Text(f"{name}: {printable(problem)}", style="yellow", no_wrap=True, overflow="ellipsis")
                for name, service in sorted(self._view.services.items())
                if name not in stale
                for problem in service.status.problems[:3]
            ]
        return lines

    def _events(self) -> list[Event]:
        events = self._view.events_of(self._only)
        return sorted(events, key=lambda event: event.t)


def _cells(row: VehicleRow) -> Sequence[str]:
    return (
        row.vehicle,
        "no tube" if row.label is None else str(row.label),
        f"stale {row.age:.0f} s" if row.stale and row.age is not None else seconds(row.tube_age),
        seconds(row.sample_age),
        "–" if row.area is None else f"{row.area:.3g}",
        "–" if row.area_free is None else f"{row.area_free:.3g}",
        _coverage(row),
        printable(row.server or "–"),
        printable(row.why),
    )


def _coverage(row: VehicleRow) -> str:
    if row.coverage is None:
        return "–"
    nominal = "" if row.nominal is None else f" / {100 * row.nominal:g}"
    # Rounded down: 100 says that all of them held.
    return f"{np.floor(1000 * row.coverage) / 10:g}{nominal} %"


def _style(row: VehicleRow) -> str:
    style = _STYLES.get(row.condition, "")
    return f"{style} dim" if row.stale and style != "dim" else style


def event_text(event: Event, *, whole: bool = False) -> Text:
    """An event in one line, cut off where there is no room unless it is wanted ``whole``."""
    who = event.vehicle or event.source
    text = Text() if whole else Text(no_wrap=True, overflow="ellipsis")
    text.append(f"{clock_time(event.t)} ", style="dim")
    text.append(f"{who} ", style="bold")
    text.append(str(event.kind), style="red" if event.kind in AGAINST else "yellow")
    text.append(f" {printable(event.message)}")
    return text


def event_document(event: Event) -> dict[str, Any]:
    """An event as a JSON object."""
    return {
        "type": "event", "t": event.t, "time": datetime.fromtimestamp(event.t / 1e9, UTC).isoformat(), "kind":
        str(event.kind), "vehicle": event.vehicle, "source": event.source, "message": event.message, "details":
        dict(event.details),
    }  # fmt: skip


def vehicle_document(row: VehicleRow) -> dict[str, Any]:
    """A vehicle as a JSON object."""
    return {
        "vehicle": row.vehicle, "condition": row.condition.name.lower(), "label": row.label and str(row.label),
        "stale": row.stale, "tube_age": row.tube_age, "sample_age": row.sample_age, "area": row.area,
        "area_free": row.area_free, "coverage": row.coverage, "nominal": row.nominal, "checked": row.checked,
        "inside": row.inside, "recent": row.recent, "recent_inside": row.recent_inside, "band": row.band,
        "server": row.server, "why": row.why,
    }  # fmt: skip
