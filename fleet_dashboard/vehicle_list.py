"""The list of all vehicles: what each one's sets are worth, and why it has none."""

import math
import re
from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final

import numpy as np
from nicegui import events, ui

from fleet_bus.messages import Label
from fleet_dashboard.gateway import Gateway
from fleet_dashboard.picture import ASTRAY, LABELS, NO_TUBE, STALE, Mark, Picture
from fleet_dashboard.theme import COLOURS

#: Cells are text and never markup: ids, servers and reasons come from outside.
_COLUMNS: Final[list[dict[str, Any]]] = [
    {"field": "id", "headerName": "vehicle", "pinned": "left", "width": 92},
    {"field": "label", "headerName": "label", "width": 102},
    {"field": "age", "headerName": "age s", "width": 64},
    {"field": "area", "headerName": "area m²", "width": 80},
    {"field": "cut", "headerName": "cut %", "width": 70},
    {"field": "coverage", "headerName": "coverage %", "width": 98},
    {"field": "why", "headerName": "note", "flex": 1, "minWidth": 140, "tooltipField": "why"},
    {"field": "nominal", "headerName": "nominal %", "width": 94},
    {"field": "latency", "headerName": "latency ms", "width": 96},
    {"field": "server", "headerName": "server", "width": 90},
]


def rows(gateway: Gateway, picture: Picture) -> list[dict[str, Any]]:
    """A row for each vehicle of a picture, with numbers that are not known as None."""
    # Of the past it is not known.
    waiting = gateway.services.waiting() if picture is gateway.picture else {}
    servers = gateway.table.servers
    age = picture.age()
    with np.errstate(all="ignore"):
        cut = np.where(picture.area_free > 0, 100 * (1 - picture.area / picture.area_free), np.nan)
    # Below a second an age is the time between two samples, which is nobody's concern.
    columns = [
        np.where(age < 1, 0.0, age).round(0), picture.area, cut.round(0), 100 * picture.coverage, 100 * picture.nominal,
        1e3 * picture.latency,
    ]  # fmt: skip
    figures = zip(*(map(_number, column.tolist()) for column in columns), strict=True)
    found = []
    for id_, label, marks, server, (a, area, away, coverage, nominal, latency) in zip(
        picture.ids, picture.label.tolist(), picture.marks.tolist(), picture.server.tolist(), figures, strict=False
    ):
        parts = [waiting.get(id_, "")] if label == NO_TUBE else []
        if marks & ASTRAY:
            parts += [broken.words for broken in gateway.obligations.contradicted(id_, picture.t)]
        parts.append((Mark(marks) & ~ASTRAY).words)
        why = "; ".join(filter(None, parts))
        found.append(
            {
                "id": id_, "label": LABELS[label], "stale": bool(marks & STALE),
                "astray": bool(marks & ASTRAY), "age": a, "area": area, "cut": away,
                "coverage": coverage, "nominal": nominal, "latency": latency, "server": servers[server], "why": why,
            }
        )  # fmt: skip
    return sorted(found, key=_order)


def _order(row: dict[str, Any]) -> tuple[int, list[tuple[int, str]]]:
    """What is wrong first, then by name, numbers in names as numbers."""
    rank = 0 if row["astray"] else 1 if row["label"] == Label.CONTRADICTED else 2 if row["stale"] else 3
    return rank, _natural(row["id"])


@lru_cache(maxsize=20_000)
def _natural(id_: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"(\d+)", id_)]


def _number(value: float) -> float | None:
    return float(f"{value:.4g}") if math.isfinite(value) else None


class VehicleList:
    """The list as an element; ``pick`` is called with the id of the vehicle that is chosen."""

    def __init__(self, gateway: Gateway, pick: Callable[[str], None]) -> None:
        self._gateway = gateway
        with ui.row().classes("w-full items-center no-wrap gap-2 q-pb-sm"):
            search = ui.input(placeholder="search vehicle, label, server, note").props(
                "dense outlined clearable hide-bottom-space"
            )
            search.classes("grow").on_value_change(self._search)
            self._count = ui.label().classes("fleet-quiet text-xs whitespace-nowrap")
        by_label = {name: COLOURS[name] for name in LABELS}
        columns = [
            {
                **column,
                ":cellStyle": f"(p) => ({{color: p.data.stale ? '{COLOURS['stale']}' : {by_label}[p.value] || ''}})",
            }
            if column["field"] == "label"
            else column
            for column in _COLUMNS
        ]  # fmt: skip
        self.grid = ui.aggrid(
            {
                "columnDefs": columns,
                "defaultColDef": {"sortable": True, "resizable": True, "suppressMovable": True},
                "rowData": [],
                ":getRowId": "(p) => p.data.id",
                ":getRowStyle": "(p) => p.data.astray ? {background: '#dd512722'} : p.data.stale ? {opacity: 0.6} : {}",
                "rowHeight": 30,
                "headerHeight": 32,
                "rowSelection": {"mode": "singleRow", "checkboxes": False, "enableClickSelection": True},
                "overlayNoRowsTemplate": "no vehicle has been heard of yet",
            },
            theme="balham",
            auto_size_columns=False,
        ).classes("w-full grow")
        self._pick = pick
        self.grid.on("cellClicked", self._clicked, ["rowId"])

    def _search(self, event: events.ValueChangeEventArguments[str | None]) -> None:
        self.grid.run_grid_method("setGridOption", "quickFilterText", event.value or "")

    def _clicked(self, event: events.GenericEventArguments) -> None:
        row = event.args.get("rowId")
        if isinstance(row, str):
            self._pick(row)

    def refresh(self, picture: Picture) -> None:
        """Show a picture."""
        found = rows(self._gateway, picture)
        self.grid.run_grid_method("setGridOption", "rowData", found)
        self._count.set_text(f"{len(found)} vehicles")
