"""The newest message of each key that a service publishes: cached for subscribers, kept for plain queries."""

from contextlib import ExitStack
from typing import Self

from fleet_bus.bus import Answers, Bus, Publisher


class Publications:
    """Publishers by key, each with the last message that was put on it; a context manager.

    A subscriber with history gets that message from the publisher's cache, which a plain query on the key does not
    reach: those below ``queryable`` (key expressions) are answered here.
    """

    def __init__(self, bus: Bus, *queryable: str) -> None:
        self._bus = bus
        self._queryable = queryable
        self._declared = ExitStack()
        self._publishers: dict[str, Publisher] = {}
        self._answers: Answers | None = None

    def __enter__(self) -> Self:
        self._answers = self._declared.enter_context(self._bus.answers(*self._queryable))
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._declared.close()

    def put(self, key: str, encoding: str, payload: bytes) -> None:
        """Publish; raise ``zenoh.ZError`` if the session is closed."""
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._declared.enter_context(self._bus.publisher(key, encoding, cache=1))
            self._publishers[key] = publisher
        if self._answers is not None:
            self._answers.keep(key, payload, encoding)
        publisher.put(payload)
