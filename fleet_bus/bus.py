"""What servers, services and agents ask of the bus, as something that can be handed in.

``fleet_bus.zenoh_bus`` answers over Zenoh; names and promises are those of ``fleet_bus.pubsub``.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol, Self

if TYPE_CHECKING:
    from fleet_bus.pubsub import Received


class Handle(Protocol):
    """Something declared on the bus, until ``close`` or the end of its ``with`` block."""

    def close(self) -> None:
        """Take it back; closing again does nothing."""

    def __enter__(self) -> Self:
        """Itself."""

    def __exit__(self, *exc_info: object) -> None:
        """Close it."""


class Publisher(Handle, Protocol):
    """Puts messages on one key and keeps the last ones for latecomers."""

    def put(self, payload: bytes) -> None:
        """Send a message, from one thread at a time."""


class Answers(Handle, Protocol):
    """The newest message of each key, for plain queries."""

    def keep(self, key: str, payload: bytes, encoding: str) -> None:
        """Answer with this message from now on where somebody asks for ``key``."""


class Bus(Handle, Protocol):
    """One session on the bus. Callbacks come on a thread of the bus, one at a time each."""

    @property
    def session_id(self) -> str:
        """What receivers see as ``Received.source``."""

    def publisher(self, key: str, encoding: str, *, cache: int, patient: bool = False) -> Publisher:
        """Publisher that keeps its last ``cache`` messages; ``patient``: under congestion it waits for the oldest
        message on its way, where others drop theirs."""

    def subscriber(
        self,
        key_expression: str,
        callback: "Callable[[Received], None]",
        *,
        history: int,
        late_publishers: bool = False,
    ) -> Handle:
        """Subscriber that begins with ``history`` cached messages of each publisher, of ``late_publishers``, too, and
        fetches what it misses."""

    def query(self, key: str, *, max_samples: int, timeout: float) -> "list[Received]":
        """The newest ``max_samples`` cached messages of each publisher on ``key``, oldest first for each, waiting
        ``timeout`` seconds at most; not for use in a callback."""

    def alive(self, key: str) -> Handle:
        """Token that ``watch_alive`` sees until it is closed, or its process is out of sight."""

    def watch_alive(self, key_expression: str, callback: Callable[[str, bool], None]) -> Handle:
        """Subscriber that calls ``callback(key, alive)`` for each token that is there, comes or goes."""

    def answers(self, *key_expressions: str) -> Answers:
        """Answers plain queries below some key expressions."""
