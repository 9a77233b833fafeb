"""The page of the fleet."""

from collections import Counter
from pathlib import Path
from typing import Final

from nicegui import events, ui

from fleet_dashboard import concerns
from fleet_dashboard.fleet_map import FleetMap
from fleet_dashboard.gateway import Gateway
from fleet_dashboard.labels import meaning_dialog
from fleet_dashboard.picture import LABELS, NO_TUBE, Picture
from fleet_dashboard.playback import Playback
from fleet_dashboard.plots import fleet_plots
from fleet_dashboard.services_view import ServicesView
from fleet_dashboard.theme import COLOURS
from fleet_dashboard.timeline_view import EventList, TimelineView, clock
from fleet_dashboard.vehicle_list import VehicleList
from fleet_dashboard.view import Views

#: Seconds between two looks at figures, and at lists and plots.
_QUICK: Final = 0.5
_SLOW: Final = 1.0
#: Vehicles beyond which the list is renewed less often.
_MANY: Final = 300


def frame(title: str) -> None:
    """What every page has: style, colours, title."""
    ui.add_css(Path(__file__).with_name("style.css"))
    ui.colors(primary="#2f6fb0", positive="#1a7f62", negative="#b3380f")
    ui.page_title(title)


class FleetPage:
    """One client's page."""

    def __init__(self, gateway: Gateway, views: Views, *, source: str, live: bool) -> None:
        self._gateway, self._live = gateway, live
        self._view = views.new()
        if not live:
            span = gateway.history.span()
            self._view.seek(0 if span is None else span[0], 1.0, gateway.clock.time_ns())
        ui.context.client.on_delete(lambda: views.close(self._view))
        frame("fleet")
        self._header(source)
        with ui.element("div").classes("fleet-main"):
            with ui.element("div").classes("fleet-left"):
                self._banner = ui.label().classes("fleet-banner").props("role=alert")
                self._banner.set_visibility(False)
                self._alarm = ui.label().classes("fleet-banner fleet-alarm cursor-pointer").props("role=alert")
                self._alarm.on("click", lambda: self._tabs.set_value("events"))
                self._alarm.set_visibility(False)
                self._past = ui.label().classes("fleet-banner fleet-past")
                self._past.set_visibility(False)
                self._map_and_tools()
                self._playback = Playback(gateway, self._view, live=live, changed=self.quick)
            with ui.element("div").classes("fleet-right"):
                self._panels()
        ui.timer(_QUICK, self.quick)
        ui.timer(_SLOW, self.slow)

    def _header(self, source: str) -> None:
        dialog = meaning_dialog()
        dark = ui.dark_mode(None)
        with ui.header().classes("items-center no-wrap q-py-none h-12 gap-4").style("background:#16202b"):
            ui.icon("hub", size="22px")
            ui.label("fleet").classes("text-base font-medium")
            ui.label(source).classes("text-xs opacity-60 fleet-wide ellipsis")
            ui.space()
            self._figures = ui.label().classes("fleet-figure text-sm ellipsis")
            with ui.button(icon="help_outline", on_click=dialog.open).props("flat round dense color=white"):
                ui.tooltip("what a label means")
            with ui.button(icon="contrast", on_click=lambda: _turn(dark)).props("flat round dense color=white"):
                ui.tooltip("light, dark")

    def _map_and_tools(self) -> None:
        with ui.element("div").classes("fleet-wrap"):
            self.map = FleetMap(self._view)
            self.map.on("pick", lambda event: self.pick(_id(event)))
            with ui.element("div").classes("fleet-legend"):
                self._legend = {}
                for label in LABELS:
                    with ui.row().classes("items-center no-wrap gap-0") as line:
                        ui.element("span").classes("fleet-dot").style(f"background:{COLOURS[label]}")
                        text = ui.label(label).classes("fleet-figure")
                    self._legend[label] = (line, text)
                self._stale = ui.label().classes("fleet-quiet")
                self._cut = ui.label().classes("fleet-figure fleet-quiet").mark("cut")
            with ui.element("div").classes("fleet-tools"):
                for icon, told, act in (
                    ("add", "zoom in", lambda: self.map.zoom(1.5)),
                    ("remove", "zoom out", lambda: self.map.zoom(1 / 1.5)),
                    ("fit_screen", "see everything", self._fit),
                ):
                    with ui.button(icon=icon, on_click=act).props(
                        f"dense size=sm color=blue-grey-8 aria-label='{told}'"
                    ):
                        ui.tooltip(told).props("anchor='center left' self='center right'")
                self._switch("route", "side information: regions, and what it cuts away", True, self._inform)
                self._switch("hexagon", "sets", True, self._sets)
                self._switch("label", "names", True, lambda on: self.map.show("names", on))

    def _switch(self, icon: str, told: str, value: bool, act: object) -> None:
        def turn() -> None:
            state["on"] = not state["on"]
            button.props(f"color={'primary' if state['on'] else 'blue-grey-4'}")
            act(state["on"])  # type: ignore[operator]

        state = {"on": value}
        button = ui.button(icon=icon, on_click=turn).props(
            f"dense size=sm color=primary aria-label='{told.partition(':')[0]}'"
        )
        with button:
            ui.tooltip(told).props("anchor='center left' self='center right'")

    def _panels(self) -> None:
        with (
            ui.tabs()
            .props("dense align=left no-caps inline-label outside-arrows mobile-arrows")
            .classes("w-full") as tabs
        ):
            for name, icon in (
                ("vehicles", "list"), ("timeline", "view_timeline"), ("events", "notifications"),
                ("plots", "show_chart"), ("services", "dns"),
            ):  # fmt: skip
                ui.tab(name, icon=icon)
        self._tabs = tabs
        with ui.row().classes("w-full items-center no-wrap gap-2 q-px-sm q-py-xs") as self._chosen:
            self._chosen_id = ui.label().classes("font-medium")
            self._chosen_text = ui.label().classes("fleet-quiet ellipsis grow")
            ui.button("details", on_click=self._details).props("flat dense no-caps")
            ui.button(icon="close", on_click=lambda: self.pick(None)).props("flat dense round size=sm")
        self._chosen.set_visibility(False)
        with (
            ui.tab_panels(tabs, value="vehicles", animated=False).classes("w-full grow").style("background:transparent")
        ):
            with ui.tab_panel("vehicles").classes("column no-wrap h-full"):
                self.list = VehicleList(self._gateway, self.pick)
            with ui.tab_panel("timeline"):
                self._timeline = TimelineView(self._gateway)
            with ui.tab_panel("events"):
                self._events = EventList(self._gateway)
            with ui.tab_panel("plots"):
                self._plots = fleet_plots()
            with ui.tab_panel("services"):
                self._services = ServicesView(self._gateway)
        tabs.on_value_change(self.slow)

    # What a person does

    def pick(self, vehicle: str | None) -> None:
        """Choose a vehicle and follow it, or none."""
        if vehicle is not None and self._gateway.table.find(vehicle) is None:
            return
        self._view.follow = vehicle
        self.map.follow(vehicle)
        self.quick()

    def _details(self) -> None:
        if self._view.follow is not None:
            ui.navigate.to(f"/vehicle/{self._view.follow}")

    def _fit(self) -> None:
        self.pick(None)
        self.map.fit()

    def _inform(self, on: bool) -> None:
        self._informed = on
        self.map.show("info", on)
        self.quick()

    def _sets(self, on: bool) -> None:
        self._view.sets = on

    # What goes on

    _informed = True
    _turns = 0

    def quick(self) -> None:
        """Renew figures, banners and the bar."""
        gateway, picture = self._gateway, self._view.picture(self._gateway)
        self._playback.refresh()
        problems = concerns.problems(gateway) if self._live and self._view.position is None else []
        self._banner.set_text(" · ".join(problems[:4]))
        self._banner.set_visibility(bool(problems))
        alarms = concerns.alarms(gateway, picture)
        self._alarm.set_text(" · ".join(alarms))
        self._alarm.set_visibility(bool(alarms))
        past = self._live and self._view.position is not None
        self._past.set_text(f"paused: this is how it was at {clock(picture.t)}")
        self._past.set_visibility(past)
        rates = gateway.series.at(picture.t)
        stale = int(picture.stale().sum())
        self._figures.set_text(
            f"{len(picture)} vehicles"
            + (f" · {rates['samples']:.0f} samples/s · {rates['tubes']:.0f} tubes/s" if rates["vehicles"] >= 0 else "")
        )
        counts = Counter(picture.label.tolist())
        for code, label in enumerate(LABELS):
            line, text = self._legend[label]
            text.set_text(f"{label} {counts[code]}")
            line.set_visibility(counts[code] > 0 or code < NO_TUBE)
            # A phone has no room for what there is none of.
            line.classes(**{"remove" if counts[code] else "add": "fleet-wide"})
        self._stale.set_text(f"stale {stale}" if stale else "")
        self._cut.set_text(_cut_away(picture, self._informed))
        self._choice(picture)

    def _choice(self, picture: Picture) -> None:
        followed = self._view.follow
        row = None if followed is None else self._gateway.table.find(followed)
        self._chosen.set_visibility(row is not None)
        if followed is None or row is None or row >= len(picture):
            return
        area, free = picture.area[row], picture.area_free[row]
        shown = area if self._informed else free
        self._chosen_id.set_text(followed)
        self._chosen_text.set_text(
            f"{LABELS[picture.label[row]]} · area {shown:.3g} m²"
            + (f" · cut away {100 * (1 - area / free):.0f} %" if self._informed and free > 0 else "")
        )

    def slow(self) -> None:
        """Renew the panel that is seen."""
        picture = self._view.picture(self._gateway)
        self._turns += 1
        match self._tabs.value:
            case "vehicles" if len(picture) <= _MANY or self._turns % 3 == 0:
                self.list.refresh(picture)
            case "timeline":
                span = self._gateway.history.span()
                start = picture.t - 60_000_000_000 if span is None else min(span[0], picture.t - 10_000_000_000)
                self._timeline.refresh(start, picture.t)
            case "events":
                self._events.refresh(picture.t)
            case "plots":
                self._plots.refresh(*self._gateway.series.fleet())
            case "services":
                self._services.refresh()


def _cut_away(picture: Picture, informed: bool) -> str:
    """How much side information cuts away from the last steps, as far as it is published: areas alone."""
    fresh = ~picture.stale() & (picture.steps > 0)
    area, free = float(picture.area[fresh].sum()), float(picture.area_free[fresh].sum())
    if not free > 0:
        return ""
    if not informed:
        return f"area without side information: {free:.4g} m²"
    return f"area {area:.4g} m², cut away {100 * (1 - area / free):.0f} %"


def _id(event: events.GenericEventArguments) -> str | None:
    id_ = event.args.get("id") if isinstance(event.args, dict) else None
    return id_ if isinstance(id_, str) else None


def _turn(dark: ui.dark_mode) -> None:
    dark.value = {None: True, True: False, False: None}[dark.value]
    ui.notify({None: "as the system is", True: "dark", False: "light"}[dark.value], timeout=800)
