"""``fleet top``: what each vehicle costs in bytes, messages and computing time, and the bus in all."""

from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rich.console import Group, RenderableType
from rich.text import Text

from fleet_bus import keys
from fleet_bus.errors import UsageError
from fleet_cli.live import Moment, bus_line, refused_lines
from fleet_cli.terminal import Column, fitted, number, printable, seconds
from fleet_view import FleetView, Snapshot
from fleet_view.batches import Compute

COLUMNS: Final = (
    Column("vehicle"),
    Column("samples/s", right=True),
    Column("tubes/s", right=True),
    Column("B/s", right=True),
    Column("bytes", dispensable=2, right=True),
    Column("B/tube", dispensable=4, right=True),
    Column("µs/batch", dispensable=1, right=True),
    Column("µs/tube", dispensable=3, right=True),
    Column("age", right=True),
    Column("server", dispensable=5),
)
#: By name the field of a vehicle's figures by which the largest comes first; names have an order of their own.
SORTS: Final = {"bytes": "bytes_per_second", "rate": "rate", "time": "batch_seconds", "age": "tube_age", "name": ""}

Figures = dict[str, Any]


class TopScreen:
    """Draws the traffic of a view; of its vehicles those whose name the pattern ``only`` fits.

    Raises ``UsageError`` for an order that there is none of.
    """

    def __init__(self, view: FleetView, *, sort: str = "bytes", only: str | None = None) -> None:
        if sort not in SORTS:
            raise UsageError(f"--sort {sort!r:.40}: choose one of {', '.join(SORTS)}")
        self._view = view
        self._sort = sort
        self._only = only

    def draw(self, moment: Moment, width: int, height: int | None) -> RenderableType:
        """See ``Screen``."""
        snapshot = self._view.snapshot(moment.now)
        figures, servers = self._figures(snapshot), self._view.compute(moment.now)
        head = [*bus_line(moment), *self._totals(moment)]
        foot = refused_lines(self._view)
        order = self._order(snapshot, figures)
        rows = len(order) if height is None else max(1, height - len(head) - len(foot) - 2)
        parts: list[RenderableType] = list(head)
        shown = [_figures_of(snapshot, figures, servers, index) for index in order[:rows].tolist()]
        if shown:
            styles = ["dim" if vehicle["stale"] else "" for vehicle in shown]
            parts.append(fitted(COLUMNS, [_cells(vehicle) for vehicle in shown], styles, width))
        elif len(snapshot):
            parts.append(Text(f"none of {len(snapshot)} vehicles is called {self._only}", style="bold"))
        else:
            parts.append(Text("no vehicles yet: start one with `fleet agent`, or `fleet demo`", style="bold"))
        if len(order) > rows:
            parts.append(Text(f"… and {len(order) - rows} more vehicles", style="dim"))
        return Group(*parts, *foot)

    def lines(self, moment: Moment) -> Iterable[Mapping[str, Any]]:
        """See ``Screen``."""
        snapshot = self._view.snapshot(moment.now)
        total = self._view.traffic.total(moment.now)
        yield {
            "type": "total", "t": moment.t, "router": not moment.lost, "vehicles": len(snapshot),
            "messages_per_second": total.messages_per_second, "bytes_per_second": total.bytes_per_second,
            "messages": total.messages, "bytes": total.bytes,
            "refused": {reason: known.count for reason, known in self._view.refused.items()},
            "skipped": self._view.skipped,
        }  # fmt: skip
        for kind, flow in self._view.traffic.by_kind(moment.now).items():
            yield {
                "type": "kind", "t": moment.t, "kind": kind, "messages_per_second": flow.messages_per_second,
                "bytes_per_second": flow.bytes_per_second, "messages": flow.messages, "bytes": flow.bytes,
            }  # fmt: skip
        for server, compute in sorted(self._view.compute(moment.now).items()):
            yield {
                "type": "server", "t": moment.t, "server": server, "batch_seconds": compute.batch,
                "tubes_per_batch": compute.tubes, "tube_seconds": compute.tube,
            }  # fmt: skip
        figures, servers = self._figures(snapshot), self._view.compute(moment.now)
        for index in self._order(snapshot, figures).tolist():
            yield {"type": "vehicle", "t": moment.t, **_figures_of(snapshot, figures, servers, index)}

    def _totals(self, moment: Moment) -> list[Text]:
        total = self._view.traffic.total(moment.now)
        lines = [
            Text(f"bus: {number(total.messages_per_second)} messages/s, {number(total.bytes_per_second, 'B')}/s; "
                 f"{total.messages} messages, {number(total.bytes, 'B')} in all", style="bold")
        ]  # fmt: skip
        kinds = [
            f"{kind} {number(flow.messages_per_second)}/s {number(flow.bytes_per_second, 'B')}/s"
            for kind, flow in self._view.traffic.by_kind(moment.now).items()
            if flow.messages_per_second
        ]
        if kinds:
            lines.append(Text(", ".join(kinds), no_wrap=True, overflow="ellipsis"))
        for server, compute in sorted(self._view.compute(moment.now).items()):
            if np.isfinite(compute.batch):
                lines.append(
                    Text(f"server {printable(server)}: {1e6 * compute.batch:.0f} µs a batch of "
                         f"{compute.tubes:.3g} tubes, {1e6 * compute.tube:.0f} µs a tube")
                )  # fmt: skip
        return lines

    def _figures(self, snapshot: Snapshot) -> Mapping[str, NDArray[Any]]:
        """Columns of what is counted, by name."""
        traffic, now = self._view.traffic, snapshot.now
        states, states_all = traffic.flows([keys.state(name) for name in snapshot.names], now)
        tubes, tubes_all = traffic.flows([keys.tube(name) for name in snapshot.names], now)
        return {
            "samples_per_second": states[:, 0], "tubes_per_second": tubes[:, 0],
            "bytes_per_second": states[:, 1] + tubes[:, 1], "rate": states[:, 0] + tubes[:, 0],
            "bytes": states_all[:, 1] + tubes_all[:, 1],
            "bytes_per_tube": tubes_all[:, 1] / np.where(tubes_all[:, 0] > 0, tubes_all[:, 0], np.nan),
            "batch_seconds": snapshot.columns["compute"], "tube_age": now - snapshot.columns["tube_at"],
        }  # fmt: skip

    def _order(self, snapshot: Snapshot, figures: Mapping[str, NDArray[Any]]) -> NDArray[np.intp]:
        indices = snapshot.select(self._only)
        keys_ = [snapshot.rank[indices]]
        if self._sort != "name":
            values = figures[SORTS[self._sort]][indices].astype(float)
            keys_.append(np.where(np.isfinite(values), -values, np.inf))
        return indices[np.lexsort(tuple(keys_))]


def _figures_of(
    snapshot: Snapshot, figures: Mapping[str, NDArray[Any]], servers: Mapping[str, Compute], index: int
) -> Figures:
    row = snapshot.row(index)
    compute = servers.get(row.server or "")
    return {
        "vehicle": row.vehicle, "stale": row.stale,
        **{name: figures[name][index].item() for name in
           ("samples_per_second", "tubes_per_second", "bytes_per_second", "bytes", "bytes_per_tube")},
        "batch_seconds": row.batch_seconds,
        "tube_seconds": None if compute is None or row.batch_seconds is None else row.batch_seconds / compute.tubes,
        "tube_age": row.tube_age, "sample_age": row.sample_age, "server": row.server,
    }  # fmt: skip


def _cells(vehicle: Figures) -> tuple[str, ...]:
    def microseconds(value: float | None) -> str:
        return "–" if value is None or not np.isfinite(value) else f"{1e6 * value:.0f}"

    age = vehicle["tube_age"]
    return (
        vehicle["vehicle"],
        f"{vehicle['samples_per_second']:.1f}",
        f"{vehicle['tubes_per_second']:.1f}",
        number(vehicle["bytes_per_second"]),
        number(vehicle["bytes"]),
        number(vehicle["bytes_per_tube"]),
        microseconds(vehicle["batch_seconds"]),
        microseconds(vehicle["tube_seconds"]),
        f"stale {age:.0f} s" if vehicle["stale"] and age is not None else seconds(age),
        printable(vehicle["server"] or "–"),
    )
