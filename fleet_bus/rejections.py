"""Counting what is refused, and saying so at most once a second."""

import time
from collections import Counter
from collections.abc import Callable
from threading import Lock

import structlog

from fleet_bus.errors import MessageError

_log = structlog.get_logger(__name__)


class Rejections:
    """Counters of refused messages by reason; safe to use from any thread."""

    def __init__(self, clock: Callable[[], float] = time.monotonic, interval: float = 1.0) -> None:
        self._clock = clock
        self._interval = interval
        self._lock = Lock()
        self._counts: Counter[str] = Counter()
        self._next_log = -float("inf")
        self._unlogged = 0

    def count(self, error: MessageError, key: str, times: int = 1) -> None:
        """Count refusals of one kind; log the first and then at most one a second, with how many were not logged."""
        with self._lock:
            self._counts[error.reason] += times
            self._unlogged += times
            now = self._clock()
            if now < self._next_log:
                return
            self._next_log = now + self._interval
            refused, self._unlogged = self._unlogged, 0
        _log.warning("message refused", key=key[:120], reason=error.reason, detail=error.detail, refused=refused)

    def snapshot(self) -> dict[str, int]:
        """Refusals so far, by reason."""
        with self._lock:
            return dict(self._counts)
