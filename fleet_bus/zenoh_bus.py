"""The bus over Zenoh."""

import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from threading import Lock
from typing import Self

import structlog
import zenoh

from fleet_bus import pubsub
from fleet_bus.bus import Bus
from fleet_bus.pubsub import CachedPublisher, Declared, Received
from fleet_bus.sessions import Role, open_session

_log = structlog.get_logger(__name__)


class ZenohBus:
    """A Zenoh session as a ``Bus``; closing it closes the session. See ``fleet_bus.pubsub`` for what each one does."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session

    @property
    def session_id(self) -> str:
        """Id of the session."""
        return str(self.session.zid())

    def publisher(self, key: str, encoding: str, *, cache: int, patient: bool = False) -> CachedPublisher:
        """See ``Bus``."""
        congestion = zenoh.CongestionControl.BLOCK_FIRST if patient else zenoh.CongestionControl.DROP
        return pubsub.declare_cached_publisher(self.session, key, encoding, cache=cache, congestion=congestion)

    def subscriber(
        self,
        key_expression: str,
        callback: Callable[[Received], None],
        *,
        history: int,
        late_publishers: bool = False,
    ) -> Declared:
        """See ``Bus``."""
        return pubsub.declare_recovering_subscriber(
            self.session, key_expression, callback, history=history, late_publishers=late_publishers
        )

    def query(self, key: str, *, max_samples: int, timeout: float) -> list[Received]:
        """See ``Bus``; raises ``zenoh.ZError`` if the session is closed."""
        return pubsub.query_cache(self.session, key, max_samples=max_samples, timeout=timeout)

    def alive(self, key: str) -> Declared:
        """See ``Bus``."""
        return pubsub.declare_alive(self.session, key)

    def watch_alive(self, key_expression: str, callback: Callable[[str, bool], None]) -> Declared:
        """See ``Bus``."""
        return pubsub.watch_alive(self.session, key_expression, callback)

    def answers(self, *key_expressions: str) -> "ZenohAnswers":
        """See ``Bus``."""
        return ZenohAnswers(self.session, *key_expressions)

    def close(self) -> None:
        """Close the session, with all that was declared on it."""
        self.session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()


class ZenohAnswers:
    """The newest message of each key, which plain queries get: these do not reach the caches of publishers."""

    def __init__(self, session: zenoh.Session, *key_expressions: str) -> None:
        self._session = session
        self._lock = Lock()
        self._newest: dict[str, tuple[zenoh.KeyExpr, bytes, str, zenoh.Timestamp]] = {}
        with ExitStack() as opening:
            for key_expression in key_expressions:
                # Not complete: another service may publish other keys below, and a query is to reach both.
                queryable = session.declare_queryable(key_expression, self._answer, complete=False)
                opening.callback(queryable.undeclare)
            self._declared = opening.pop_all()

    def keep(self, key: str, payload: bytes, encoding: str) -> None:
        """See ``Answers``; raises ``zenoh.ZError`` if the session is closed."""
        with self._lock:
            self._newest[key] = zenoh.KeyExpr(key), payload, encoding, self._session.new_timestamp()

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

    def close(self) -> None:
        """Answer no more."""
        self._declared.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()


def as_bus(session: zenoh.Session | Bus) -> Bus:
    """The bus of a Zenoh session; a bus as it is."""
    return ZenohBus(session) if isinstance(session, zenoh.Session) else session


def open_bus(role: Role, routers: Sequence[str], stop: threading.Event | None = None) -> ZenohBus:
    """The bus of a session that is opened for it; raises as ``open_session`` does."""
    return ZenohBus(open_session(role, routers, stop=stop))
