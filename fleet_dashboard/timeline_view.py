"""Obligations through time, and the list of events."""

from datetime import datetime
from html import escape
from typing import Any, Final

from nicegui import ui

from fleet_bus.messages import Event
from fleet_dashboard.gateway import Gateway
from fleet_dashboard.theme import COLOURS
from fleet_dashboard.timeline import ALARMS, Fate, Transition

#: Rows that are drawn: those with a contradiction first, then those that changed last.
MOST_ROWS: Final = 30
MOST_LISTED: Final = 200


def bars(
    found: dict[tuple[str, str], list[Transition]], start: int, now: int
) -> tuple[list[str], list[tuple[int, int, int, Transition]]]:
    """Names of the rows, and bars (row, from, to, what) in ns between ``start`` and ``now``: the last fate goes on."""
    order = sorted(found, key=lambda key: (found[key][-1].fate is not Fate.CONTRADICTED, -found[key][-1].t, key))[
        :MOST_ROWS
    ]
    drawn = []
    for row, key in enumerate(order):
        transitions = found[key]
        ends = [*(later.t for later in transitions[1:]), now]
        for transition, end in zip(transitions, ends, strict=True):
            if end >= start:
                drawn.append((row, max(transition.t, start), max(end, start), transition))
    return [f"{vehicle} · {obligation}" for vehicle, obligation in order], drawn


class TimelineView:
    """Bars of obligations: pending, witnessed, contradicted."""

    def __init__(self, gateway: Gateway, vehicle: str | None = None) -> None:
        self._gateway, self._vehicle = gateway, vehicle
        with ui.row().classes("gap-4 text-xs q-px-sm"):
            for name in Fate:
                with ui.row().classes("items-center gap-0"):
                    ui.element("span").classes("fleet-dot").style(f"background:{COLOURS[name]}")
                    ui.label(name)
        self._none = ui.label("No scenario or requirement of a vehicle has been heard of.").classes(
            "fleet-quiet q-pa-sm"
        )
        self.chart = ui.echart(
            {
                "animation": False,
                "grid": {"left": 8, "right": 24, "top": 8, "bottom": 28, "containLabel": True},
                "xAxis": {"type": "time", "axisLabel": {"hideOverlap": True, "color": "#8a95a1"}},
                "yAxis": {
                    "type": "category", "inverse": True, "data": [], "axisLabel": {"color": "#8a95a1", "fontSize": 11},
                    "axisTick": {"show": False},
                },
                "tooltip": {"trigger": "item", "confine": True},
                "series": [],
            }
        ).classes("w-full")  # fmt: skip
        self._shown: object = None

    def refresh(self, start: int, now: int) -> None:
        """Show what was known at ``now`` (ns) of the time since ``start`` (ns)."""
        found = self._gateway.obligations.until(now)
        if self._vehicle is not None:
            found = {key: value for key, value in found.items() if key[0] == self._vehicle}
        names, drawn = bars(found, start, now)
        self._none.set_visibility(not names)
        self.chart.set_visibility(bool(names))
        self.chart.style(f"height:{60 + 26 * max(1, len(names))}px")
        options: dict[str, Any] = self.chart.options
        options["yAxis"]["data"] = names
        options["xAxis"] |= {"min": start / 1e6, "max": now / 1e6}
        options["series"] = [
            {
                "type": "line", "symbol": "rect" if what.fate is Fate.CONTRADICTED else "none", "symbolSize": 12,
                # A row is named and not numbered; the tooltip of ECharts takes markup.
                "name": escape(f"{what.fate} since {clock(what.t)}: {what.verdict}"[:160]),
                "data": [[begin / 1e6, names[row]], [end / 1e6, names[row]]],
                "lineStyle": {"width": 12, "color": COLOURS[what.fate], "cap": "butt"},
                "itemStyle": {"color": COLOURS[what.fate]}, "triggerLineEvent": True,
                "tooltip": {"formatter": "{a}"},
            }
            for row, begin, end, what in drawn
        ]  # fmt: skip
        self.chart.update()


class EventList:
    """The newest events as text."""

    def __init__(self, gateway: Gateway, vehicle: str | None = None) -> None:
        self._gateway, self._vehicle = gateway, vehicle
        self.list = ui.column().classes("w-full gap-0")
        self._shown: object = None

    def refresh(self, now: int) -> None:
        """Show events up to ``now`` (ns)."""
        found = self._gateway.events.until(now, self._vehicle)
        what = (self._gateway.events.count, len(found))
        if what == self._shown:
            return
        self._shown = what
        self.list.clear()
        with self.list:
            if not found:
                ui.label("No event so far.").classes("fleet-quiet q-pa-sm")
            for when, event in found[:MOST_LISTED]:
                _event(when, event)
            if len(found) > MOST_LISTED:
                ui.label(f"and {len(found) - MOST_LISTED} older ones").classes("fleet-quiet q-pa-sm")


def _event(when: int, event: Event) -> None:
    alarm = event.kind in ALARMS
    with ui.row().classes("w-full no-wrap items-start gap-2 q-px-sm q-py-xs text-sm"):
        ui.icon("error" if alarm else "info", size="18px").style(
            f"color:{COLOURS['contradicted' if alarm else 'pending']};margin-top:2px"
        )
        ui.label(clock(when)).classes("fleet-quiet fleet-figure")
        with ui.column().classes("gap-0 grow"):
            with ui.row().classes("gap-2"):
                ui.label(str(event.kind)).classes("font-medium")
                if event.vehicle is not None:
                    ui.link(event.vehicle, f"/vehicle/{event.vehicle}")
            ui.label(event.message).classes("fleet-quiet break-words")


def clock(t: int) -> str:
    """Time of day of ``t`` (ns), local."""
    return datetime.fromtimestamp(t / 1e9).strftime("%H:%M:%S")
