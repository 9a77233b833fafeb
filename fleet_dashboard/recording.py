"""A recording, shown as if one had been there: fed through a gateway once, and looked at in its history."""

import threading
from collections.abc import Callable, Iterable
from typing import Final

from fleet_bus.errors import FleetError
from fleet_bus.pubsub import Received
from fleet_dashboard.gateway import TICK, Gateway
from fleet_dashboard.history import History, Series
from fleet_dashboard.regions import Regions

#: A recording longer than that has its beginning left out, s.
MOST_SECONDS: Final = 24 * 3600.0
#: Figures of a recording that are plotted: one a second.
MOST_FIGURES: Final = 3600
_TICK_NS: Final = round(TICK * 1e9)
#: A gap in a recording is not filled with pictures: so many show that it begins.
_MOST_TICKS: Final = 40


def load(
    messages: Iterable[Received],
    *,
    draw: Callable[[str], Regions] | None = None,
    stop: threading.Event | None = None,
    history: History | None = None,
) -> Gateway:
    """A gateway whose history is that of the messages, in the order of their arrival.

    Raises ``FleetError`` if there are none. Told to stop, it ends with what came until then.
    """
    history = History(span=MOST_SECONDS) if history is None else history
    gateway = Gateway(draw=draw, history=history, series=Series(MOST_FIGURES))
    now = 0
    for message in messages:
        if stop is not None and stop.is_set():
            break
        if not now:
            now = message.arrived_ns
        ticks = 0
        while message.arrived_ns > now + _TICK_NS:
            now += _TICK_NS
            gateway.tick(now)
            ticks += 1
            if ticks == _MOST_TICKS:
                now = message.arrived_ns
        gateway.feed(message)
    if not now:
        raise FleetError("the recording has no message that the page could show")
    gateway.tick(now + _TICK_NS)
    return gateway
