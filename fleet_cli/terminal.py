"""What commands that show something live have in common: output that may be a pipe, keys, tables that fit."""

import io
import json
import math
import os
import select
import sys
import termios
import threading
import time
import tty
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, Final, Self

from rich.cells import cell_len
from rich.console import Console, RenderableType
from rich.style import StyleType
from rich.table import Table
from rich.text import Text

from fleet_bus.errors import FleetError

#: Least width of a column that takes what the others leave.
LEAST_REST: Final = 30


class ReaderGoneError(Exception):
    """Nobody reads the output any more: there is nothing left to do."""


def printable(text: str) -> str:
    """A text that came over the bus, in one line, without anything that a terminal would obey."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)


class Output:
    """Lines on stdout, each flushed, for people and programs alike.

    Raises ``ReaderGoneError`` once the reader has closed the pipe, ``FleetError`` if stdout takes nothing else.
    """

    def __init__(self) -> None:
        self.terminal = sys.stdout.isatty()
        if isinstance(sys.stdout, io.TextIOWrapper):
            # A terminal may know less than what stands in messages.
            sys.stdout.reconfigure(errors="replace")
        self._poll: select.poll | None = None
        try:
            descriptor = sys.stdout.fileno()
        except OSError:
            return
        if not self.terminal:
            self._poll = select.poll()
            self._poll.register(descriptor, 0)

    def text(self, text: str) -> None:
        """Write a text as it is."""
        try:
            sys.stdout.write(text)
            sys.stdout.flush()
        except BrokenPipeError:
            self._give_up()
            raise ReaderGoneError from None
        except OSError as error:
            self._give_up()
            raise FleetError(f"stdout takes no more: {error.strerror or error}") from None

    def json(self, document: Mapping[str, Any]) -> None:
        """Write a JSON object as one line; numbers that are none become null."""
        self.text(json.dumps(finite(document), allow_nan=False, ensure_ascii=False) + "\n")

    def check(self) -> None:
        """Raise ``ReaderGoneError`` if the reader of a pipe is gone, also where there is nothing to write."""
        if self._poll is not None and any(
            event & (select.POLLERR | select.POLLNVAL) for _, event in self._poll.poll(0)
        ):
            self._give_up()
            raise ReaderGoneError

    def _give_up(self) -> None:
        # What is left in the buffer would raise once more when the process ends.
        with open(os.devnull, "w", encoding="utf-8") as nowhere:  # noqa: PTH123 - a device
            os.dup2(nowhere.fileno(), sys.stdout.fileno())


def finite(value: Any) -> Any:
    """A document as JSON can hold it: null for NaN and infinities."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return value


class Keys:
    """Waits for time to pass, for a signal, or for the key q, while its ``with`` block lasts."""

    def __init__(self, stop: threading.Event) -> None:
        self._stop = stop
        self._closing = ExitStack()
        self._descriptor: int | None = None

    def __enter__(self) -> Self:
        try:
            descriptor = sys.stdin.fileno()
            # Who is in the background would be stopped for it.
            if os.isatty(descriptor) and os.tcgetpgrp(descriptor) == os.getpgrp():
                before = termios.tcgetattr(descriptor)
                self._closing.callback(termios.tcsetattr, descriptor, termios.TCSADRAIN, before)
                tty.setcbreak(descriptor)
                self._descriptor = descriptor
        except (OSError, ValueError, AttributeError, termios.error):
            self._descriptor = None
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._closing.close()

    def left(self, seconds: float) -> bool:
        """Whether to leave; waits for it, ``seconds`` at most."""
        end = time.monotonic() + seconds
        while (rest := end - time.monotonic()) > 0:
            if self._descriptor is None:
                return self._stop.wait(rest)
            if self._stop.is_set():
                return True
            if not select.select([self._descriptor], [], [], min(rest, 0.05))[0]:
                continue
            pressed = os.read(self._descriptor, 64)
            if not pressed:
                self._descriptor = None
            elif b"q" in pressed or b"Q" in pressed:
                return True
        return self._stop.is_set()


@dataclass(frozen=True, slots=True)
class Column:
    """A column: its head, and how readily it is given up where there is no room (0: never)."""

    head: str
    dispensable: int = 0
    right: bool = False
    #: Takes what the others leave, shortened.
    rest: bool = False


def fitted(columns: Sequence[Column], rows: Sequence[Sequence[str]], styles: Sequence[StyleType], width: int) -> Table:
    """A table no wider than ``width``: what is most dispensable is left out until the others fit."""
    widths = [max(cell_len(c.head), *(cell_len(row[i]) for row in rows), 0) for i, c in enumerate(columns)]
    least = [min(w, LEAST_REST) if c.rest else w for c, w in zip(columns, widths, strict=True)]
    kept = list(range(len(columns)))
    while sum(least[i] + 1 for i in kept) > width:
        out = max(kept, key=lambda i: (columns[i].dispensable, i))
        if columns[out].dispensable == 0:
            break
        kept.remove(out)
    table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False, header_style="bold")
    taken = sum(widths[i] + 1 for i in kept if not columns[i].rest)
    for i in kept:
        table.add_column(
            columns[i].head,
            justify="right" if columns[i].right else "left",
            no_wrap=True,
            overflow="ellipsis",
            width=max(1, min(widths[i], width - taken)) if columns[i].rest else widths[i],
        )
    for row, style in zip(rows, styles, strict=True):
        table.add_row(*(Text(row[i]) for i in kept), style=style)
    return table


def seconds(value: float | None) -> str:
    """An age for people."""
    if value is None:
        return "–"
    if value < 10:
        return f"{value:.2f} s"
    if value < 120:
        return f"{value:.0f} s"
    return f"{value / 60:.0f} min" if value < 7200 else f"{value / 3600:.0f} h"


def number(value: float | None, unit: str = "") -> str:
    """A number for people: three digits, with a prefix where it is large."""
    if value is None or not math.isfinite(value):
        return "–"
    for prefix, size in (("G", 1e9), ("M", 1e6), ("k", 1e3)):
        if abs(value) >= size:
            return f"{value / size:.3g} {prefix}{unit}"
    return f"{value:.3g} {unit}".rstrip()


def clock_time(t: int) -> str:
    """Local time of day of Unix nanoseconds."""
    return time.strftime("%H:%M:%S", time.localtime(t / 1e9))


def as_text(
    renderable: RenderableType, *, width: int | None = None, terminal: bool = False, whole: bool = False
) -> str:
    """What is drawn, with colours for a terminal only; ``whole``: lines are as long as they are."""
    console = Console(force_terminal=terminal, width=width, highlight=False, no_color=None if terminal else True)
    with console.capture() as captured:
        console.print(renderable, soft_wrap=whole)
    drawn = captured.get()
    return drawn if terminal else "".join(f"{line.rstrip()}\n" for line in drawn.splitlines())
