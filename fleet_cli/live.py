"""The loop of ``fleet watch`` and ``fleet top``: read the bus, draw, again; live, as plain tables, or as JSON lines."""

import shutil
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

import zenoh
from rich.console import Console, RenderableType
from rich.live import Live
from rich.text import Text

from fleet_bus.clock import SYSTEM
from fleet_bus.sessions import Role, open_session
from fleet_cli.terminal import Keys, Output, ReaderGoneError, as_text, printable
from fleet_view import Feed, FleetView

#: Seconds between two pictures, live and as plain lines, and between two readings of what has arrived.
LIVE: Final = 0.5
PLAIN: Final = 1.0
READ: Final = 0.1


@dataclass(frozen=True, slots=True)
class Moment:
    """When a picture is of: ``now`` (s) by the view's clock, ``t`` in Unix ns; ``routers`` that do not answer."""

    now: float
    t: int
    lost: tuple[str, ...] = ()


class Screen(Protocol):
    """What there is to see."""

    def draw(self, moment: Moment, width: int, height: int | None) -> RenderableType:
        """Picture for people, at most ``height`` lines where that is given."""

    def lines(self, moment: Moment) -> Iterable[Mapping[str, Any]]:
        """JSON objects for programs."""


def follow(
    view: FleetView, screen: Screen, routers: Sequence[str], stop: threading.Event, *, once: bool, json: bool
) -> None:
    """Show a fleet until told to stop, or once, after the first second.

    Raises ``SessionError`` if no router answers.
    """
    output = Output()
    try:
        with open_session(Role.VIEWER, routers, stop=stop) as session, Feed(view).connect(session) as feed:

            def moment() -> Moment:
                lost = () if connected(session) else tuple(routers)
                return Moment(SYSTEM.monotonic(), SYSTEM.time_ns(), lost)

            # A terminal that cannot move its cursor gets what a pipe gets.
            if output.terminal and not Console().is_dumb_terminal and not once and not json:
                _live(feed, screen, stop, moment)
            else:
                _plain(feed, screen, stop, moment, output, once=once, json=json)
    except ReaderGoneError:
        return


def connected(session: zenoh.Session) -> bool:
    """Whether a session has a router."""
    return bool(list(session.info.routers_zid()))


def _live(feed: Feed, screen: Screen, stop: threading.Event, moment: Any) -> None:
    console = Console(highlight=False)
    next_picture = 0.0
    with Keys(stop) as keys, Live(console=console, screen=True, auto_refresh=False) as display:
        while True:
            feed.take_in()
            if time.monotonic() >= next_picture:
                next_picture = time.monotonic() + LIVE
                width, height = console.size
                display.update(screen.draw(moment(), width, height), refresh=True)
            if keys.left(READ):
                return


def _plain(
    feed: Feed, screen: Screen, stop: threading.Event, moment: Any, output: Output, *, once: bool, json: bool
) -> None:
    next_picture = time.monotonic() + PLAIN
    with Keys(stop) as keys:
        while not keys.left(READ):
            feed.take_in()
            output.check()
            if time.monotonic() < next_picture:
                continue
            next_picture += PLAIN
            if json:
                for line in screen.lines(moment()):
                    output.json(line)
            else:
                width = shutil.get_terminal_size().columns
                output.text(as_text(screen.draw(moment(), width, None), width=width, terminal=output.terminal))
            if once:
                return


def bus_line(moment: Moment) -> list[Text]:
    """What is to be said where the router is out of sight."""
    if not moment.lost:
        return []
    return [Text(f"no router answers at {', '.join(moment.lost)}: trying on; this is from before", style="bold red")]


def refused_lines(view: FleetView) -> list[Text]:
    """What could not be read, by reason."""
    lines = [
        Text(f"{known.count} refused ({reason}), the last on {printable(known.key) or 'some key'}: "
             f"{printable(known.detail)}", style="yellow", no_wrap=True, overflow="ellipsis")
        for reason, known in sorted(view.refused.items())
    ]  # fmt: skip
    if view.skipped:
        lines.append(Text(f"{view.skipped} tubes not looked at: newer ones had come", style="yellow"))
    if view.crowded_out:
        lines.append(Text(f"{view.crowded_out} messages of more vehicles than can be kept", style="yellow"))
    return lines
