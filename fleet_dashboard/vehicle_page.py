"""The page of one vehicle."""

from collections.abc import Sequence

from nicegui import ui

from fleet_bus.errors import MessageError
from fleet_dashboard import concerns
from fleet_dashboard.fleet_map import FleetMap
from fleet_dashboard.gateway import Gateway
from fleet_dashboard.labels import meaning_dialog
from fleet_dashboard.page import frame
from fleet_dashboard.picture import LABELS, Mark
from fleet_dashboard.plots import vehicle_plots
from fleet_dashboard.theme import COLOURS
from fleet_dashboard.timeline_view import EventList, TimelineView
from fleet_dashboard.vehicle_facts import (
    Row,
    audit_rows,
    input_rows,
    profile_rows,
    state_of,
    state_rows,
    tube_of,
    tube_rows,
)
from fleet_dashboard.view import Views


class Facts:
    """A card with rows of text, renewed where they changed."""

    def __init__(self, title: str) -> None:
        with ui.card().props("flat bordered").classes("w-full gap-1 q-pa-md"):
            ui.label(title).classes("font-medium")
            self._grid = (
                ui.element("div")
                .classes("w-full text-sm grid gap-x-4 gap-y-1")
                .style("grid-template-columns: repeat(3, minmax(0, 1fr))")
            )
        self._texts: list[ui.label] = []

    def show(self, rows: Sequence[Row], none: str) -> None:
        """Show rows, or why there are none."""
        cells = [cell for row in (rows or [(none, "", "")]) for cell in row]
        if len(cells) != len(self._texts):
            self._grid.clear()
            kinds = ("fleet-quiet", "fleet-figure break-words", "fleet-quiet break-words")
            with self._grid:
                self._texts = [ui.label().classes(kinds[i % 3]) for i in range(len(cells))]
        for label, text in zip(self._texts, cells, strict=True):
            label.set_text(text)


class VehiclePage:
    """One client's page of one vehicle, live."""

    def __init__(self, gateway: Gateway, views: Views, vehicle: str) -> None:
        self._gateway, self._vehicle = gateway, vehicle
        view = views.new()
        view.follow = vehicle
        ui.context.client.on_delete(lambda: views.close(view))
        frame(vehicle)
        ui.dark_mode(None)
        dialog = meaning_dialog()
        with ui.header().classes("items-center no-wrap q-py-none h-12 gap-3").style("background:#16202b"):
            ui.button(icon="arrow_back", on_click=lambda: ui.navigate.to("/")).props(
                "flat round dense color=white aria-label='the fleet'"
            )
            ui.label(vehicle).classes("text-base font-medium ellipsis")
            self._label = ui.badge().on("click", dialog.open).classes("cursor-pointer")
            self._state = ui.label().classes("text-sm opacity-80 ellipsis")
        self._banner = ui.label().classes("fleet-banner").props("role=alert")
        with (
            ui.element("div")
            .classes("w-full grid gap-3 q-pa-md")
            .style("grid-template-columns: repeat(auto-fit, minmax(min(100%, 380px), 1fr)); align-items: start")
        ):
            with ui.column().classes("gap-3 min-w-0"):
                with ui.card().props("flat bordered").classes("w-full q-pa-none flex").style("height:340px"):
                    FleetMap(view, follow=vehicle)
                self._state_facts, self._inputs = Facts("State"), Facts("Inputs")
                self._audit = Facts("Audit: one-step predictions held against what was measured")
            with ui.column().classes("gap-3 min-w-0"):
                self._tube, self._profile = Facts("Newest tube"), Facts("Profile, and where each bound is from")
            with ui.column().classes("gap-3 min-w-0"):
                with ui.card().props("flat bordered").classes("w-full gap-0 q-pa-sm"):
                    self._plots = vehicle_plots()
                with ui.card().props("flat bordered").classes("w-full gap-0 q-pa-sm"):
                    self._timeline = TimelineView(gateway, vehicle)
                with ui.card().props("flat bordered").classes("w-full gap-0 q-pa-sm"):
                    self._events = EventList(gateway, vehicle)
        self.refresh()
        ui.timer(1.0, self.refresh)

    def refresh(self) -> None:
        """Show the newest."""
        gateway, vehicle = self._gateway, self._vehicle
        picture = gateway.picture
        row = gateway.table.find(vehicle)
        profile = gateway.profiles.get(vehicle)
        problems = concerns.problems(gateway)
        if row is None or row >= len(picture):
            problems = [*problems, f"nothing has been heard of {vehicle}"]
            self._label.set_text("not known")
            self._state.set_text("")
        else:
            label, marks = LABELS[picture.label[row]], Mark(int(picture.marks[row]))
            self._label.set_text(label)
            self._label.style(f"background:{COLOURS[label]} !important")
            why = gateway.services.waiting().get(vehicle, "")
            self._state.set_text("; ".join(filter(None, (marks.words, why))))
            self._plots.refresh(*gateway.series.vehicle(row))
        self._banner.set_text(" · ".join(problems))
        self._banner.set_visibility(bool(problems))
        self._facts(profile is None)
        now = picture.t
        self._timeline.refresh(now - 60_000_000_000, now)
        self._events.refresh(now)

    def _facts(self, unknown: bool) -> None:
        gateway, vehicle = self._gateway, self._vehicle
        profile = gateway.profiles.get(vehicle)
        try:
            sample, refused = state_of(gateway, vehicle), ""
        except MessageError as error:
            sample, refused = None, str(error)
        nothing = refused or "no sample has come"
        self._state_facts.show([] if sample is None else state_rows(sample, profile), nothing)
        self._inputs.show([] if sample is None else input_rows(sample, profile), nothing)
        tube, wrong = tube_of(gateway, vehicle)
        nothing = f"it cannot be read: {wrong}" if wrong else "no tube has come"
        self._tube.show([] if tube is None else tube_rows(tube), nothing)
        self._audit.show([] if tube is None else audit_rows(tube, profile), nothing)
        self._profile.show([] if profile is None else profile_rows(profile), "no profile has come")
