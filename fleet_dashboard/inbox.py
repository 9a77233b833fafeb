"""Messages between the bus, which must not wait, and the next picture."""

from collections import deque
from threading import Lock
from typing import Final, NamedTuple

from fleet_bus.errors import MessageError
from fleet_bus.pubsub import Received
from fleet_bus.rejections import Rejections

#: Messages that wait at most, and vehicles whose tubes do.
MOST_WAITING: Final = 50_000
#: Tubes of one vehicle that wait: the newest sound one counts.
MOST_TUBES: Final = 8


class Waiting(NamedTuple):
    """What has come: tubes of each vehicle, oldest first, how many there were, states, and other messages."""

    tubes: list[deque[Received]]
    tubes_came: int
    states: list[Received]
    others: list[Received]


class Inbox:
    """What has come since the last look, in bounded memory; safe to use from any thread."""

    def __init__(self, rejections: Rejections) -> None:
        self._rejections = rejections
        self._lock = Lock()
        self._tubes: dict[str, deque[Received]] = {}
        self._tubes_came = 0
        self._states: list[Received] = []
        self._others: list[Received] = []

    def put(self, received: Received) -> None:
        """Keep a message; one more than there is room for is counted as overflow."""
        with self._lock:
            if received.key.endswith("/tube"):
                self._tubes_came += 1
                stack = self._tubes.get(received.key)
                if stack is None and len(self._tubes) < MOST_WAITING:
                    stack = self._tubes[received.key] = deque(maxlen=MOST_TUBES)
                if stack is not None:
                    stack.append(received)
                    return
            else:
                kept = self._states if received.key.endswith("/state") else self._others
                if len(kept) < MOST_WAITING:
                    kept.append(received)
                    return
        self._rejections.count(MessageError("overflow", "more came than the page could read"), received.key)

    def take(self) -> Waiting:
        """All of it, which is here no more."""
        with self._lock:
            found = Waiting(list(self._tubes.values()), self._tubes_came, self._states, self._others)
            self._tubes, self._tubes_came, self._states, self._others = {}, 0, [], []
        return found
