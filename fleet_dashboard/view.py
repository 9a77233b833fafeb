"""What one client looks at, and what it has been told already."""

import json
import math
import secrets
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Any, Final

from fleet_dashboard.frames import Viewport, encode
from fleet_dashboard.gateway import Gateway
from fleet_dashboard.picture import Picture

#: Views that are kept for clients that come back.
_MOST_VIEWS: Final = 500
_FARTHEST: Final = 1e9


@dataclass(slots=True)
class View:
    """One client's view. The page sets what is chosen there, the browser its viewport."""

    key: str = field(default_factory=lambda: secrets.token_urlsafe(12))
    viewport: Viewport | None = None
    follow: str | None = None
    sets: bool = True
    #: Where the client is in the past (ns), None for now; and how fast it goes on from there.
    position: int | None = None
    speed: float = 0.0
    _moved: int = 0
    _told: int = 0
    _regions: int = -1
    _active: str = ""

    def hear(self, text: str) -> None:
        """Take in what the browser says: ``{"view": [x, y, x, y], "pixels": p}``, or null as its view if it has none
        yet.

        What cannot be is left alone.
        """
        try:
            said = json.loads(text)
            if said["view"] is None:
                self.viewport = None
                return
            x_low, y_low, x_high, y_high = (float(number) for number in said["view"])
            pixels = float(said["pixels"])
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            return
        numbers = (x_low, y_low, x_high, y_high)
        near = all(math.isfinite(n) and abs(n) <= _FARTHEST for n in numbers)
        if near and x_low < x_high and y_low < y_high and math.isfinite(pixels) and pixels > 0:
            self.viewport = Viewport(*numbers, pixels)

    def seek(self, t: int | None, speed: float, now: int) -> None:
        """Look at ``t`` (ns), None for now, going on at ``speed`` times real time; ``now`` (ns) by the gateway's
        clock."""
        self.position, self.speed, self._moved = t, speed, now

    def picture(self, gateway: Gateway) -> Picture:
        """The picture that this client looks at, after its way through the past went on."""
        if self.position is None:
            return gateway.picture
        now = gateway.clock.time_ns()
        self.position += round(self.speed * max(0, now - self._moved))
        self._moved = now
        span = gateway.history.span()
        if span is not None and not span[0] <= self.position <= span[1]:
            self.position = min(max(self.position, span[0]), span[1])
        return gateway.history.at(self.position) or gateway.picture

    def frame(self, gateway: Gateway, picture: Picture) -> bytes:
        """The frame of a picture for this client."""
        row = gateway.table.find(self.follow) if self.follow is not None else None
        follow = -1 if row is None else row
        return encode(picture, self.viewport, sets=self.sets, past=self.position is not None, follow=follow)

    def news(self, gateway: Gateway, picture: Picture) -> str | None:
        """What the browser has not been told: ids of new rows, regions, and which are active now; None if nothing."""
        said: dict[str, Any] = {}
        known = len(gateway.table.ids)
        if known > self._told:
            said["first"], said["ids"] = self._told, gateway.table.ids[self._told : known]
            self._told = known
        if gateway.regions.number != self._regions:
            self._regions = gateway.regions.number
            said["regions"] = [
                {"scenario": scenario, "name": name, "segments": border.ravel().tolist(), "at": regions.anchors[name]}
                for scenario, regions in sorted(gateway.regions.all().items())
                for name, border in regions.borders.items()
            ]
        active = sorted(active_regions(gateway, picture))
        text = json.dumps(active)
        if text != self._active:
            self._active = text
            said["active"] = active
        return json.dumps(said) if said else None

    def forget(self) -> None:
        """Tell everything again: the browser has connected anew."""
        self._told, self._regions, self._active = 0, -1, ""


def active_regions(gateway: Gateway, picture: Picture) -> set[tuple[str, str]]:
    """Scenario and region whose predicates cut a tube of a picture."""
    acting = picture.acting
    return {
        (scenario, name)
        for scenario, regions in gateway.regions.all().items()
        for name, predicates in regions.predicates.items()
        if any((scenario, predicate) in acting for predicate in predicates)
    }


class Views:
    """Views by key, the latest used; a browser that comes back after a restart gets a new one."""

    def __init__(self) -> None:
        self._views: OrderedDict[str, View] = OrderedDict()

    def new(self) -> View:
        """A view of its own for a client."""
        view = View()
        self._views[view.key] = view
        while len(self._views) > _MOST_VIEWS:
            self._views.popitem(last=False)
        return view

    def find(self, key: str) -> View:
        """The view of a key, or one that is not kept."""
        view = self._views.get(key)
        if view is None:
            return View()
        self._views.move_to_end(key)
        return view

    def close(self, view: View) -> None:
        """A client is gone for good."""
        self._views.pop(view.key, None)
