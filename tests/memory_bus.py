"""A bus without a network, and a clock without time, for tests of what runs on them."""

import threading
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Self

from fleet_bus.pubsub import Received


class Time:
    """A ``Clock`` that goes on where somebody waits, at once, or where a test says so."""

    def __init__(self, now: float = 0.0, origin_ns: int = 10**18) -> None:
        self.now = now
        self._origin_ns = origin_ns
        #: Called after each wait, with the time (s): where a test lets things happen.
        self.on_wait: Callable[[float], object] | None = None

    def monotonic(self) -> float:
        return self.now

    def time_ns(self) -> int:
        return self._origin_ns + round(self.now * 1e9)

    def wait(self, event: threading.Event, seconds: float) -> bool:
        if not event.is_set():
            self.now += seconds
            if self.on_wait is not None:
                self.on_wait(self.now)
        return event.is_set()


def matches(expression: str, key: str) -> bool:
    """Whether a key expression, with ``*`` for one part of a key and ``**`` at its end for any, includes a key."""
    wanted, parts = expression.split("/"), key.split("/")
    if wanted[-1] == "**":
        wanted, parts = wanted[:-1], parts[: len(wanted) - 1]
    return len(wanted) == len(parts) and all(w in ("*", part) for w, part in zip(wanted, parts, strict=True))


@dataclass
class Network:
    """What buses have in common. Messages arrive at once, on the thread that puts them, in order, and none is lost."""

    time: Time = field(default_factory=Time)
    #: All that was put, in order, whoever put it, and keys of messages and of tokens that came; tests may clear both.
    puts: list[Received] = field(default_factory=list)
    log: list[str] = field(default_factory=list)
    #: Called after each message that is put.
    on_put: Callable[[], object] | None = None
    #: What every attempt to put a message raises.
    broken: Exception | None = None
    declared: list[str] = field(default_factory=list)
    closed: list[str] = field(default_factory=list)
    publishers: "list[MemoryPublisher]" = field(default_factory=list)
    subscribers: "dict[object, tuple[str, Callable[[Received], None]]]" = field(default_factory=dict)
    watchers: "dict[object, tuple[str, Callable[[str, bool], None]]]" = field(default_factory=dict)
    tokens: list[str] = field(default_factory=list)
    kept: "list[MemoryAnswers]" = field(default_factory=list)
    buses: int = 0

    def bus(self) -> "MemoryBus":
        """Another session."""
        self.buses += 1
        return MemoryBus(self, f"session {self.buses}")

    def deliver(self, received: Received) -> None:
        """Let a message arrive at all subscribers of its key, as it is."""
        for expression, callback in list(self.subscribers.values()):
            if matches(expression, received.key):
                callback(received)

    def token(self, key: str, alive: bool) -> None:
        """Let a token come or go."""
        for expression, callback in list(self.watchers.values()):
            if matches(expression, key):
                callback(key, alive)

    def ask(self, expression: str) -> list[tuple[str, bytes, str]]:
        """Key, payload and encoding of all that answers a plain query."""
        return [
            (key, *message)
            for answers in self.kept
            for key, message in answers.newest.items()
            if matches(expression, key) and any(matches(own, key) for own in answers.expressions)
        ]


@dataclass(eq=False)
class MemoryHandle:
    network: Network
    key: str
    undo: Callable[[], object] = bool
    open: bool = True

    def __post_init__(self) -> None:
        self.network.declared.append(self.key)

    def close(self) -> None:
        if self.open:
            self.open = False
            self.network.closed.append(self.key)
            self.undo()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()


class MemoryPublisher(MemoryHandle):
    def __init__(self, network: Network, key: str, encoding: str, cache: int, source: str) -> None:
        super().__init__(network, key, lambda: network.publishers.remove(self))
        self.encoding, self.source = encoding, source
        self.cache: deque[Received] = deque(maxlen=cache)
        network.publishers.append(self)

    def put(self, payload: bytes) -> None:
        message = Received(self.key, payload, self.encoding, None, self.source, arrived_ns=self.network.time.time_ns())
        if self.network.broken is not None:
            raise self.network.broken
        self.cache.append(message)
        self.network.puts.append(message)
        self.network.log.append(self.key)
        self.network.deliver(message)
        if self.network.on_put is not None:
            self.network.on_put()

    def cached(self, most: int) -> list[Received]:
        """The newest messages, as they arrive now."""
        now = self.network.time.time_ns()
        return [replace(message, arrived_ns=now) for message in list(self.cache)[-most:]]


class MemoryAnswers(MemoryHandle):
    def __init__(self, network: Network, expressions: Iterable[str]) -> None:
        self.expressions = tuple(expressions)
        super().__init__(network, " ".join(self.expressions), lambda: network.kept.remove(self))
        self.newest: dict[str, tuple[bytes, str]] = {}
        network.kept.append(self)

    def keep(self, key: str, payload: bytes, encoding: str) -> None:
        self.newest[key] = payload, encoding


class MemoryBus:
    """A ``Bus`` in memory. All that is declared goes with it."""

    def __init__(self, network: Network, session_id: str) -> None:
        self.network = network
        self.session_id = session_id
        self._handles: list[MemoryHandle] = []
        self.open = True

    def _keep(self, handle: MemoryHandle) -> None:
        self._handles = [*(h for h in self._handles if h.open), handle]

    def publisher(self, key: str, encoding: str, *, cache: int, patient: bool = False) -> MemoryPublisher:
        publisher = MemoryPublisher(self.network, key, encoding, cache, self.session_id)
        self._keep(publisher)
        return publisher

    def subscriber(
        self,
        key_expression: str,
        callback: Callable[[Received], None],
        *,
        history: int,
        late_publishers: bool = False,
    ) -> MemoryHandle:
        token = object()
        handle = MemoryHandle(self.network, key_expression, lambda: self.network.subscribers.pop(token))
        self.network.subscribers[token] = key_expression, callback
        self._keep(handle)
        for publisher in list(self.network.publishers):
            if history and matches(key_expression, publisher.key):
                for message in publisher.cached(history):
                    callback(message)
        return handle

    def query(self, key: str, *, max_samples: int, timeout: float) -> list[Received]:
        asked = [publisher for publisher in list(self.network.publishers) if matches(key, publisher.key)]
        return [message for publisher in asked for message in publisher.cached(max_samples)]

    def alive(self, key: str) -> MemoryHandle:
        def go() -> None:
            self.network.tokens.remove(key)
            self.network.token(key, False)

        handle = MemoryHandle(self.network, key, go)
        self._keep(handle)
        self.network.tokens.append(key)
        self.network.log.append(key)
        self.network.token(key, True)
        return handle

    def watch_alive(self, key_expression: str, callback: Callable[[str, bool], None]) -> MemoryHandle:
        token = object()
        handle = MemoryHandle(self.network, key_expression, lambda: self.network.watchers.pop(token))
        self.network.watchers[token] = key_expression, callback
        self._keep(handle)
        for key in self.network.tokens:
            if matches(key_expression, key):
                callback(key, True)
        return handle

    def answers(self, *key_expressions: str) -> MemoryAnswers:
        answers = MemoryAnswers(self.network, key_expressions)
        self._keep(answers)
        return answers

    def close(self) -> None:
        self.open = False
        for handle in self._handles:
            handle.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()
