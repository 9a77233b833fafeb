"""Ctrl-C and SIGTERM during long work whose finished parts are kept."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Self


class Interruption:
    """SIGINT and SIGTERM raise ``KeyboardInterrupt`` in this block: once, and not while they are held.

    Compiled code may turn it into another exception, or lose it: ask ``is_cause_of`` about every exception, and
    ``asked`` after each part of the work. A signal after the first changes nothing, so that what was finished can be
    written. Outside of the main thread, where Python handles no signals, the block does nothing.

    Attributes:
        asked: whether a signal came.
    """

    def __init__(self) -> None:
        self.asked = False
        self._holds = 0
        self._raised = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._come)
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._raised = True
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def is_cause_of(self, error: BaseException) -> bool:
        """Whether the work ended by a signal rather than by a fault: one came, or a ``KeyboardInterrupt`` led to
        ``error``. From then on nothing more is raised."""
        self.asked = self.asked or any(isinstance(one, KeyboardInterrupt) for one in _chain(error))
        self._raised = self._raised or self.asked
        return self.asked

    @contextmanager
    def held(self) -> Iterator[None]:
        """Let nothing come between; a signal that came is raised at the end."""
        self._holds += 1
        try:
            yield
        finally:
            self._holds -= 1
        if self.asked:
            self._raise()

    def _come(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        self._raise()

    def _raise(self) -> None:
        if not self._raised and not self._holds:
            self._raised = True
            raise KeyboardInterrupt


def _chain(error: BaseException) -> Iterator[BaseException]:
    """The exception, and those that led to it."""
    seen: set[int] = set()
    waiting: list[BaseException | None] = [error]
    while waiting:
        one = waiting.pop()
        if one is not None and id(one) not in seen:
            seen.add(id(one))
            yield one
            waiting += [one.__cause__, one.__context__]
