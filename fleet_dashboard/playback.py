"""Pause, and go back: the bar below the map."""

from collections.abc import Callable

from nicegui import events, ui

from fleet_dashboard.gateway import Gateway
from fleet_dashboard.timeline_view import clock
from fleet_dashboard.view import View

_PARTS = 1000


class Playback:
    """Sets where a view is in time. Of a recording (``live`` false) there is no now to go back to."""

    def __init__(self, gateway: Gateway, view: View, *, live: bool, changed: Callable[[], object]) -> None:
        self._gateway, self._view, self._live, self._changed = gateway, view, live, changed
        with ui.row().classes("fleet-bar w-full no-wrap"):
            self._button = ui.button(icon="pause", on_click=self._toggle).props("flat dense round aria-label=pause")
            self._button.mark("pause")
            self._slider = ui.slider(min=0, max=_PARTS, value=_PARTS).props('aria-label="time"').classes("grow q-mx-sm")
            # Only what a person does; the slider is moved by the page, too.
            self._slider.on("update:model-value", self._dragged, throttle=0.1)
            self._speed = ui.select([0.25, 0.5, 1, 2, 5, 10], value=1, on_change=self._sped).props("dense borderless")
            self._speed.set_visibility(not live)
            self._time = ui.label().classes("fleet-figure text-sm whitespace-nowrap")
            self._now = ui.button("live", on_click=self._go_live).props("dense unelevated size=sm")
            self._now.set_visibility(live)

    def _seek(self, t: int | None, speed: float) -> None:
        self._view.seek(t, speed, self._gateway.clock.time_ns())
        self._changed()

    def _toggle(self) -> None:
        view = self._view
        if view.position is None:
            self._seek(self._gateway.picture.t, 0.0)
        else:
            self._seek(view.position, 0.0 if view.speed else float(self._speed.value or 1))

    def _sped(self) -> None:
        if self._view.position is not None and self._view.speed:
            self._seek(self._view.position, float(self._speed.value or 1))

    def _go_live(self) -> None:
        self._seek(None, 0.0)

    def _dragged(self, event: events.GenericEventArguments) -> None:
        span = self._gateway.history.span()
        if span is None or not isinstance(event.args, int | float):
            return
        part = min(max(event.args / _PARTS, 0.0), 1.0)
        self._seek(span[0] + round(part * (span[1] - span[0])), 0.0)

    def refresh(self) -> None:
        """Show where the view is."""
        view, span = self._view, self._gateway.history.span()
        shown = self._gateway.picture.t if view.position is None else view.position
        playing = view.position is None or bool(view.speed)
        self._button.props(f"icon={'pause' if playing else 'play_arrow'}")
        if span is not None and span[1] > span[0]:
            self._slider.set_value(round(_PARTS * (shown - span[0]) / (span[1] - span[0])))
        behind = 0.0 if span is None or not self._live else (self._gateway.picture.t - shown) / 1e9
        past = view.position is not None and self._live
        self._time.set_text(f"{clock(shown)} (−{behind:.0f} s)" if past else clock(shown))
        self._now.props(f"color={'grey-6' if past else 'positive'}")
