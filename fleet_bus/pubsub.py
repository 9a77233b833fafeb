"""Putting and getting: Zenoh entities behind one small surface.

The only module that touches ``zenoh.ext``'s Advanced entities, which Zenoh marks unstable. Callbacks run on
Zenoh's network thread: a slow one throttles every subscriber of its session, so they append to a ring and
return. Zenoh calls them for a while after it was told to stop; here none begins once ``close`` has returned.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from threading import Event, RLock
from typing import Final, Protocol, Self, TypeVar

import structlog
import zenoh
from zenoh import ext

_log = structlog.get_logger(__name__)
_T = TypeVar("_T")

# Where a publisher on a key answers for its cache; hidden from wildcards over the key itself.
_CACHES: Final = "@adv/**"


@dataclass(frozen=True, slots=True)
class Received:
    """One sample from the bus."""

    key: str
    payload: bytes
    encoding: str
    timestamp_ns: int | None
    """When it was put, by the publisher's hybrid logical clock, in Unix nanoseconds; for latencies on one machine only,
    since one clock that is ahead moves those of all others."""
    source: str = ""
    """Id of the session that put it, as its publisher says; empty where it does not, as with a plain put."""
    arrived_ns: int = 0
    """When it came here, by this machine's clock, in Unix nanoseconds; 0 where that is not known."""


class _Handle(Protocol):
    def undeclare(self) -> object: ...


class _Gate:
    """Lets calls of a callback through until it is shut; ``shut`` waits for the one that is under way."""

    def __init__(self) -> None:
        # May be shut out of the callback itself.
        self._lock = RLock()
        self._open = True

    def shut(self) -> None:
        with self._lock:
            self._open = False

    def guard(self, callback: Callable[[_T], None]) -> Callable[[_T], None]:
        def passed(item: _T) -> None:
            with self._lock:
                if self._open:
                    callback(item)

        return passed


class Declared:
    """Something declared on a session, until ``close`` or the end of its ``with`` block."""

    def __init__(self, session: zenoh.Session, handle: _Handle, gate: _Gate | None = None) -> None:
        # A session that is garbage-collected takes back all that was declared on it.
        self._session = session
        self._handle: _Handle | None = handle
        self._gate = gate

    def close(self) -> None:
        """Take the declaration back: its callback is not called any more. Closing again does nothing."""
        if self._gate is not None:
            self._gate.shut()
        handle, self._handle = self._handle, None
        if handle is not None:
            handle.undeclare()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()


class CachedPublisher(Declared):
    """A publisher whose last samples can be had from it again."""

    def __init__(self, session: zenoh.Session, publisher: ext.AdvancedPublisher) -> None:
        super().__init__(session, publisher)
        self._publisher = publisher

    def put(self, payload: bytes) -> None:
        """Send ``payload`` to whoever listens and keep it in the cache; ``zenoh.ZError`` once closed.

        From one thread: where two overtake each other, readers without recovery lose what comes out of order.
        """
        self._publisher.put(payload)


def declare_cached_publisher(
    session: zenoh.Session,
    key: str,
    encoding: str,
    *,
    cache: int,
    heartbeat: float = 1.0,
    priority: zenoh.Priority = zenoh.Priority.DATA_HIGH,
    congestion: zenoh.CongestionControl = zenoh.CongestionControl.DROP,
) -> CachedPublisher:
    """Publisher on ``key`` that keeps its last ``cache`` samples (at least 1) for latecomers and recovery.

    Under congestion a sample is dropped rather than waited for, since one stuck subscriber would freeze all
    others; a recovering subscriber sees the gap at the next sample, or at the next ``heartbeat`` (seconds),
    and fetches what it missed.
    """
    # Periodic, because a sporadic heartbeat announces each change once: in an outage it is lost, and with it
    # what was put last. One a second suffices: it only ever finds the last samples, any other gap shows at
    # the next.
    publisher = ext.declare_advanced_publisher(
        session,
        key,
        encoding=encoding,
        priority=priority,
        congestion_control=congestion,
        cache=ext.CacheConfig(cache),
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=heartbeat, sporadic_heartbeat=None),
        publisher_detection=True,
    )
    return CachedPublisher(session, publisher)


def declare_recovering_subscriber(
    session: zenoh.Session,
    key_expression: str,
    callback: Callable[[Received], None],
    *,
    history: int,
    late_publishers: bool = False,
) -> Declared:
    """Subscriber that begins with ``history`` cached samples of each publisher and fetches what it misses.

    Each publisher's samples arrive once and in order, as far back as its cache reaches: what was put while
    the router was away comes by itself, within a second of its return. ``history`` is no hard cap, and 0 not even a
    wish: without history the next heartbeat of a publisher that is silent fetches all of its cache. Whoever wants
    nothing old must tell by what is in the samples. What a router thins or refuses to pass on is fetched as well, so
    that only the decoder bounds sizes and rates.

    A ``delete`` comes, live as a sample without payload and of Zenoh's own encoding, and so it comes out of a cache:
    readers refuse it by its encoding.

    Of a publisher that connects later, what it put before arrives only if it is silent when it connects
    (within a heartbeat, all of its cache); else it begins with its next sample, and ``query_cache`` has what
    came before. ``late_publishers`` gets the silent ones at once and no more than ``history`` of each, but
    watches a liveliness token per publisher, and 1000 tokens add 56 µs to every message of the session: for
    few publishers only.
    """
    gate = _Gate()
    wanted = ext.HistoryConfig(max_samples=history, detect_late_publishers=late_publishers)
    subscriber = ext.declare_advanced_subscriber(
        session,
        key_expression,
        _delivering(key_expression, callback, gate),
        history=wanted if history else None,
        recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
    )
    return Declared(session, subscriber, gate)


def query_cache(session: zenoh.Session, key: str, *, max_samples: int, timeout: float) -> list[Received]:
    """The newest ``max_samples`` cached samples of each publisher on ``key``, oldest first for each.

    Waits until all have answered, ``timeout`` seconds at most: a frozen publisher costs all of it, until its
    lease is over. Who has not answered by then, or has no cache, is not in the list. A publisher that answers over
    two routers that are linked is heard once. Not for use in a callback.
    """
    received: list[Received] = []
    known: set[tuple[str, int]] = set()
    done = Event()

    def keep(reply: zenoh.Reply) -> None:
        if reply.ok is None:
            return
        source = reply.ok.source_info
        if source is not None:
            number = str(source.source_id), source.source_sn
            if number in known:
                return
            known.add(number)
        received.append(_received(reply.ok))

    # A callback and not a channel: in the publisher's own session a channel would be full before it is read.
    session.get(
        f"{key}/{_CACHES}?_max={max_samples}",
        zenoh.handlers.Callback(_guarded(key, keep), done.set),
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
        accept_replies=zenoh.ReplyKeyExpr.ANY,
        timeout=timeout,
    )
    done.wait(timeout + 1.0)
    return list(received)


def subscribe(session: zenoh.Session, key_expression: str, callback: Callable[[Received], None]) -> Declared:
    """Subscriber to what is put from now on; what is lost stays lost.

    What a publisher puts over two routers that are linked comes twice.
    """
    gate = _Gate()
    subscriber = session.declare_subscriber(key_expression, _delivering(key_expression, callback, gate))
    return Declared(session, subscriber, gate)


def declare_alive(session: zenoh.Session, key: str) -> Declared:
    """Liveliness token on ``key``: seen by ``watch_alive`` until closed, or 2 s after its process freezes."""
    return Declared(session, session.liveliness().declare_token(key))


def watch_alive(session: zenoh.Session, key_expression: str, callback: Callable[[str, bool], None]) -> Declared:
    """Subscriber that calls ``callback(key, alive)`` for each token that is there, comes or goes.

    When the router goes, every token is gone at once, and comes back with it: gone means out of sight. For
    many tokens give it a session of its own, since 1000 of them add 56 µs to every data message of their
    session.
    """

    def changed(token: zenoh.Sample) -> None:
        callback(str(token.key_expr), token.kind == zenoh.SampleKind.PUT)

    gate = _Gate()
    guarded = gate.guard(_guarded(key_expression, changed))
    return Declared(session, session.liveliness().declare_subscriber(key_expression, guarded, history=True), gate)


def _received(sample: zenoh.Sample) -> Received:
    timestamp, info = sample.timestamp, sample.source_info
    source = "" if info is None else str(info.source_id.zid)
    return Received(
        str(sample.key_expr),
        sample.payload.to_bytes(),
        str(sample.encoding),
        None if timestamp is None else timestamp.get_time_as_ntp64().as_nanos(),
        source,
        time.time_ns(),
    )


def _delivering(
    key_expression: str, callback: Callable[[Received], None], gate: _Gate
) -> Callable[[zenoh.Sample], None]:
    def deliver(sample: zenoh.Sample) -> None:
        callback(_received(sample))

    return gate.guard(_guarded(key_expression, deliver))


def _guarded(key_expression: str, callback: Callable[[_T], None]) -> Callable[[_T], None]:
    """``callback``, but what it raises is logged, at most once a second; Zenoh would print every time."""
    next_log = -float("inf")

    def guarded(item: _T) -> None:
        nonlocal next_log
        try:
            callback(item)
        except Exception:
            now = time.monotonic()
            if now >= next_log:
                next_log = now + 1.0
                _log.exception("callback failed", key=key_expression)

    return guarded
