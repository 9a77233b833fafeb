"""The server that Foxglove connects to: reads the bus once, shows the newest of each vehicle at a stated rate."""

import logging
import socket
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Final, Self

import foxglove
import structlog

from fleet_bus import keys
from fleet_bus.bus import Bus
from fleet_bus.clock import SYSTEM, Clock
from fleet_bus.errors import MessageError, SessionError
from fleet_bus.pubsub import Received
from fleet_bus.rejections import Rejections
from fleet_foxglove import topics
from fleet_foxglove.messages import ALL_TOPICS, LASTING, DrawRegions, Scene, schema_of
from fleet_foxglove.topics import SceneMessage

_log = structlog.get_logger(__name__)

#: Messages that wait for one client. Of a client that takes none the oldest are dropped, and nobody waits for it.
BACKLOG: Final = 4096
#: Rare messages, and senders of frequent ones, that wait for the next turn; what is more is refused.
MOST_WAITING: Final = 20_000
#: Log entries kept while nobody looks, and seconds after which a latecomer gets what lasts.
KEPT_LOGS: Final = 200
AGAIN_SECONDS: Final = 1.0
#: Seconds for which states may be ahead of their profile before that is told.
PROFILE_SECONDS: Final = 3.0
#: Seconds within which a server that was stopped gives its port back.
PORT_SECONDS: Final = 2.0


class _Forward(logging.Handler):
    """Lets what Foxglove's SDK says go where the log of this process goes, which holds up nobody."""

    def emit(self, record: logging.LogRecord) -> None:
        level = "warning" if record.levelno >= logging.WARNING else "debug"
        getattr(_log, level)("foxglove says", message=record.getMessage()[:300])


def _is_free(host: str, port: int) -> bool:
    """Whether a server could listen there. Not by connecting, which would itself leave the port taken for a while."""
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as tried:
        try:
            tried.bind((host, port))
        except OSError:
            return False
    return True


@contextmanager
def _forwarded() -> Iterator[None]:
    logger, handler = logging.getLogger("foxglove"), _Forward()
    propagated, logger.propagate = logger.propagate, False
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagated


class Bridge:
    """Shows a bus to any number of clients of Foxglove, from ``with`` on until its end. They can change nothing.

    Attributes:
        rejections: what was refused, by reason.
        thinned: messages that a newer one of the same sender replaced before their turn came.
    """

    def __init__(
        self,
        bus: Bus,
        *,
        host: str = "127.0.0.1",
        port: int = 8765,
        rate: float = 10.0,
        draw_regions: DrawRegions | None = None,
        clock: Clock = SYSTEM,
    ) -> None:
        self._bus = bus
        self._at = host, port
        self._period = 1.0 / rate
        self._clock = clock
        self._scene = Scene(draw_regions)
        self._lock = threading.Lock()
        self._rare: deque[Received] = deque()
        self._newest: dict[tuple[str, str], Received] = {}
        self._lasting: dict[tuple[str, str], SceneMessage] = {}
        self._again = -float("inf")
        self._unseen: deque[SceneMessage] = deque(maxlen=KEPT_LOGS)
        self._channels: dict[str, foxglove.Channel] = {}
        self._unknown_since: dict[str, float] = {}
        self._server: foxglove.websocket.WebSocketServer | None = None
        self._open = ExitStack()
        self.rejections = Rejections()
        self.thinned = 0

    def __enter__(self) -> Self:
        with ExitStack() as opening:
            opening.enter_context(_forwarded())
            server = self._start_server()
            opening.callback(self._stop_server, server)
            # Profiles first: states mean nothing without them.
            for expression in (keys.ALL_PROFILES, keys.ALL_DOCUMENTS, keys.ALL_EVENTS, keys.ALL_SERVICE_EVENTS):
                opening.enter_context(self._bus.subscriber(expression, self._keep, history=32))
            for expression in (keys.ALL_STATES, keys.ALL_TUBES):
                opening.enter_context(self._bus.subscriber(expression, self._replace, history=1))
            self._server = server
            self._open = opening.pop_all()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._open.close()

    @property
    def port(self) -> int:
        """Port that is listened on."""
        assert self._server is not None
        return self._server.port

    def run(self, stop: threading.Event) -> None:
        """Take a turn at the stated rate until ``stop`` is set; a turn that takes longer than that delays the next."""
        due = self._clock.monotonic() + self._period
        while not self._clock.wait(stop, max(due - self._clock.monotonic(), 0.0)):
            self.turn()
            # What was missed is not made up for: what came meanwhile is shown in one turn.
            due = max(due + self._period, self._clock.monotonic())

    def turn(self) -> None:
        """Show what has come since the last turn: what is rare in order, of what is frequent the newest."""
        with self._lock:
            rare, self._rare = self._rare, deque()
            newest, self._newest = self._newest, {}
        wanted = LASTING | {topics.LOG} | {topic for topic, channel in self._channels.items() if channel.has_sinks()}
        # States before tubes, since a tube's arrow stands in the frame that a state places.
        for received in (*rare, *sorted(newest.values(), key=lambda r: r.key.endswith("/tube"))):
            try:
                for message in self._scene.scene_messages(received, wanted):
                    self._show(message, received.key)
            except MessageError as error:
                if error.reason != "no_profile" or self._unknown_for(received.key) > PROFILE_SECONDS:
                    self.rejections.count(error, received.key)
        self._show_again()

    def _unknown_for(self, key: str) -> float:
        """Seconds since the first state on ``key`` that had no profile: two keys come in any order."""
        now = self._clock.monotonic()
        return now - self._unknown_since.setdefault(key, now)

    def _show(self, message: SceneMessage, key: str) -> None:
        channel = self._channels[message.topic]
        if message.topic in LASTING:
            self._lasting[message.topic, key if message.topic == topics.REGIONS else ""] = message
        if message.topic == topics.LOG and not channel.has_sinks():
            self._unseen.append(message)
        else:
            channel.log(message.payload, log_time=message.t_ns)

    def _show_again(self) -> None:
        log = self._channels[topics.LOG]
        while self._unseen and log.has_sinks():
            message = self._unseen.popleft()
            log.log(message.payload, log_time=message.t_ns)
        now = self._clock.monotonic()
        if now >= self._again:
            self._again = now + AGAIN_SECONDS
            for message in self._lasting.values():
                self._channels[message.topic].log(message.payload, log_time=message.t_ns)

    def _keep(self, received: Received) -> None:
        with self._lock:
            if len(self._rare) < MOST_WAITING:
                self._rare.append(received)
                return
        self.rejections.count(MessageError("overflow", "too many messages wait to be shown"), received.key)

    def _replace(self, received: Received) -> None:
        # By source, too: what a stranger puts on a key must not hide what the vehicle's server says.
        sender = received.key, received.source
        with self._lock:
            known = sender in self._newest
            if known or len(self._newest) < MOST_WAITING:
                self._newest[sender] = received
                self.thinned += known
                return
        self.rejections.count(MessageError("overflow", "too many senders at once"), received.key)

    def _stop_server(self, server: foxglove.websocket.WebSocketServer) -> None:
        """Stop the server, and wait until its port is free again, which ``stop`` does not."""
        port = server.port
        server.stop()
        nobody = threading.Event()
        until = self._clock.monotonic() + PORT_SECONDS
        while not _is_free(self._at[0], port) and self._clock.monotonic() < until:
            self._clock.wait(nobody, 0.01)

    def _start_server(self) -> foxglove.websocket.WebSocketServer:
        host, port = self._at
        # One of its own, so that nothing else in the process is shown, and two bridges do not show each other's. Kept,
        # since neither server nor channels hold it, and without it all channels are closed.
        self._context = context = foxglove.Context()
        for topic in sorted(ALL_TOPICS):
            name, encoding, data, message_encoding = schema_of(topic)
            schema = foxglove.Schema(name=name, encoding=encoding, data=data)
            self._channels[topic] = foxglove.Channel(
                topic, schema=schema, message_encoding=message_encoding, context=context
            )
        try:
            # No capabilities: clients can publish nothing, set nothing and call nothing.
            return foxglove.start_server(
                name="fleet-reach",
                host=host,
                port=port,
                capabilities=[],
                context=context,
                message_backlog_size=BACKLOG,
            )
        except RuntimeError as error:
            if "in use" in str(error):
                raise SessionError(
                    f"port {port} of {host} is in use: end what listens there (another `fleet foxglove`?), or choose "
                    "another --port; 0 takes a free one"
                ) from None
            raise SessionError(f"nothing can listen on {host}, port {port}: {error}") from None
