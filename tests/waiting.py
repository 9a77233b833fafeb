"""Waiting for something to become true, with a deadline instead of a guess."""

import time
from collections.abc import Callable
from threading import Event
from typing import Final

#: Seconds after which what was waited for is taken never to come: far more than a busy machine needs.
DEADLINE: Final = 60.0


def wait_until(
    predicate: Callable[[], object], timeout: float = DEADLINE, *, meanwhile: Callable[[], object] = bool
) -> None:
    """Return once ``predicate()`` is true, calling ``meanwhile`` until then; fail after ``timeout`` s."""
    never = Event()
    deadline = time.monotonic() + timeout
    while not predicate():
        assert time.monotonic() < deadline, f"not true within {timeout} s"
        meanwhile()
        never.wait(0.005)
