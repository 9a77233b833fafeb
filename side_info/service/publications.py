"""The newest message of each key that a service publishes: cached for subscribers, kept for plain queries."""

from contextlib import ExitStack
from threading import Lock
from typing import Self

import structlog
import zenoh

from fleet_bus.pubsub import CachedPublisher, declare_cached_publisher

_log = structlog.get_logger(__name__)


class Publications:
    """Publishers by key, each with the last message that was put on it; a context manager.

    A subscriber with history gets that message from the publisher's cache, which a plain query on the key does not
    reach: those below ``queryable`` (key expressions) are answered here.
    """

    def __init__(self, session: zenoh.Session, *queryable: str) -> None:
        self._session = session
        self._queryable = queryable
        self._declared = ExitStack()
        self._publishers: dict[str, CachedPublisher] = {}
        self._lock = Lock()
        self._newest: dict[str, tuple[zenoh.KeyExpr, bytes, str, zenoh.Timestamp]] = {}

    def __enter__(self) -> Self:
        with ExitStack() as opening:
            for key_expression in self._queryable:
                # Not complete: another service may publish other scenarios, and a query is to reach both.
                queryable = self._session.declare_queryable(key_expression, self._answer, complete=False)
                opening.callback(queryable.undeclare)
            self._declared = opening.pop_all()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._declared.close()

    def put(self, key: str, encoding: str, payload: bytes) -> None:
        """Publish; raise ``zenoh.ZError`` if the session is closed."""
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._declared.enter_context(declare_cached_publisher(self._session, key, encoding, cache=1))
            self._publishers[key] = publisher
        with self._lock:
            self._newest[key] = zenoh.KeyExpr(key), payload, encoding, self._session.new_timestamp()
        publisher.put(payload)

    def _answer(self, query: zenoh.Query) -> None:
        # Raised here, an error would be printed by Zenoh's thread, once for each query that somebody sends.
        try:
            with self._lock:
                newest = list(self._newest.values())
            for key, payload, encoding, timestamp in newest:
                if query.key_expr.intersects(key):
                    query.reply(key, payload, encoding=encoding, timestamp=timestamp)
        except zenoh.ZError as error:
            _log.debug("query not answered", key=str(query.key_expr)[:120], error=str(error))
