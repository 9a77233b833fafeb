"""The recorder: everything on the bus, as it comes, into the parts of a recording."""

import threading
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from typing import Final, NamedTuple, Self

import structlog

from fleet_bus import keys
from fleet_bus.bus import Bus
from fleet_bus.clock import SYSTEM, Clock
from fleet_bus.errors import MessageError
from fleet_bus.messages import ServiceStatus
from fleet_bus.pubsub import Received
from fleet_bus.rejections import Rejections
from fleet_recorder import layout
from fleet_recorder.files import Folder
from fleet_recorder.layout import Recorded
from fleet_recorder.parts import Parts, Rules, Scene

_log = structlog.get_logger(__name__)

KIND: Final = "recorder"

#: Everything below these keys is recorded: what services say, and what scenarios are in force.
ALL_SPEC: Final = "spec/**"
ALL_SERVICES: Final = "svc/**"
ALL_TOKENS: Final = (keys.ALL_ALIVE, "svc/*/*")

TICK_SECONDS: Final = 0.1
STATUS_SECONDS: Final = 1.0
#: Samples asked of each agent's cache at the start; more than any window holds.
HISTORY: Final = 100_000
#: Events, and what else is put below ``svc/``, that are asked of each cache.
RARE: Final = 32
#: What may wait to be written: bytes of payloads, with what a message costs beside its payload.
QUEUE_BYTES: Final = 128 << 20
OVERHEAD: Final = 512


class Summary(NamedTuple):
    """What a recorder has done.

    ``received`` messages came, ``recorded`` of them are in files, ``lost`` are not, ``waiting`` are on their way;
    ``bytes`` of the ``files`` together, and how many old files were ``removed``.
    """

    received: int
    recorded: int
    lost: int
    waiting: int
    bytes: int
    files: int
    removed: int


class Recorder:
    """Records what comes over the buses that ``connect`` opens, between ``with``; ``run`` writes until told to stop.

    Its token on ``svc/recorder/<instance>`` tells servers to put what a recorder needs of them, anew for each file.
    Three sessions: *bulk* carries states and tubes, *rare* all else, *tokens* what is alive (tokens in a session slow
    down its data). Callbacks append to a queue of at most ``queue_bytes``; what finds it full is counted and told.
    ``extra`` is asked at the beginning of each file for messages that it needs to stand on its own and that nobody puts
    by itself: they are recorded as if they had come. ``scene`` as for ``Parts``.

    Raises what ``connect`` raises.
    """

    def __init__(
        self,
        folder: Folder,
        rules: Rules,
        connect: Callable[[], Bus],
        *,
        instance: str = "recorder-1",
        clock: Clock = SYSTEM,
        extra: Callable[[], Iterable[Received]] | None = None,
        scene: Callable[[], Scene] | None = None,
        queue_bytes: int = QUEUE_BYTES,
        parts: Callable[..., Parts] = Parts,
    ) -> None:
        keys.service(KIND, instance)
        self.instance = instance
        self.rejections = Rejections(clock.monotonic)
        self.parts = parts(
            folder, rules, clock=clock, scene=scene, details={"recorder": instance}, rejections=self.rejections,
            opened=self._begin_part,
        )  # fmt: skip
        self._folder = folder
        self._connect = connect
        self._clock = clock
        self._extra = extra
        self._limit = queue_bytes
        self._lock = threading.Lock()
        self._queue: deque[Recorded] = deque()
        self._queued_bytes = 0
        self._sequence = 0
        self._parts_begun = 0
        self._ended = False
        self._overflowed = 0
        self._started = clock.time_ns()
        self._next_status = clock.monotonic()
        self._open = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as opening:
            declare = opening.enter_context
            bulk, rare, tokens = (declare(self._connect()) for _ in range(3))
            status = keys.service_status(KIND, self.instance)
            self._status = declare(rare.publisher(status, ServiceStatus.encoding(), cache=1))
            for expression, history in ((keys.ALL_TUBES, 1), (keys.ALL_TRUTHS, 1), (keys.ALL_STATES, HISTORY)):
                declare(bulk.subscriber(expression, self.put, history=history))
            declare(rare.subscriber(keys.ALL_EVENTS, self.put, history=RARE))
            for expression in ALL_TOKENS:
                declare(tokens.watch_alive(expression, self._put_token))
            # What is said about samples and tubes begins after these, and ends before them.
            for expression in (keys.ALL_PROFILES, ALL_SPEC, ALL_SERVICES):
                declare(rare.subscriber(expression, self.put, history=RARE, late_publishers=True))
            self._tokens = tokens
            # What servers put for a recorder that comes is put for one that can hear it.
            self._token = tokens.alive(keys.service(KIND, self.instance))
            opening.callback(self._close_token)
            self._open = opening.pop_all()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._ended = True
        try:
            self._open.close()
        finally:
            self._write(at_once=True)
            self.parts.close()
            if self._queue:
                self._overflowed += len(self._queue)
                _log.warning("messages that still waited are lost", lost=len(self._queue), why=self.parts.trouble)
                self._queue.clear()

    def put(self, received: Received) -> None:
        """Take a message that has come; from any thread."""
        cost = len(received.payload) + OVERHEAD
        with self._lock:
            sequence = self._sequence
            self._sequence += 1
            if fits := self._queued_bytes + cost <= self._limit:
                self._queued_bytes += cost
                self._queue.append(Recorded(received, sequence, received.arrived_ns))
            else:
                self._overflowed += 1
        if not fits:
            why = self.parts.trouble or "they come faster than they can be written"
            error = MessageError("overflow", f"more than {self._limit >> 20} MiB wait to be recorded: {why}")
            self.rejections.count(error, received.key)

    def _put_token(self, key: str, alive: bool) -> None:
        self.put(layout.token(key, alive, self._clock.time_ns()))

    def _begin_part(self) -> None:
        """Let what a file needs to stand on its own be put anew, where it is not the first."""
        self._parts_begun += 1
        if self._ended:
            return
        if self._parts_begun > 1:
            try:
                self._renew_token()
            # The rest of the bus is recorded all the same.
            except Exception:
                _log.exception("servers were not asked for what a new file needs")
        if self._extra is None:
            return
        try:
            for received in self._extra():
                self.put(received)
        except Exception:
            _log.exception("what a file needs to stand on its own could not be had")

    def _close_token(self) -> None:
        self._token.close()

    def _renew_token(self) -> None:
        """Appear anew to servers, without having been gone: under another name, and only then no more under the old."""
        name = self.instance if self._parts_begun % 2 else f"{self.instance}.again"
        before, self._token = self._token, self._tokens.alive(keys.service(KIND, name))
        before.close()

    def run(self, stop: threading.Event, tell: Callable[[Summary], object] | None = None) -> None:
        """Write what comes until ``stop`` is set; ``tell`` gets a summary about once a second."""
        while not stop.is_set():
            self.step()
            now = self._clock.monotonic()
            if now >= self._next_status:
                self._next_status = now + STATUS_SECONDS
                self._put_status()
                if tell is not None:
                    tell(self.summary())
            self._clock.wait(stop, TICK_SECONDS)

    def step(self) -> None:
        """Hand what waits to the file, and the file to the disk when it is time."""
        self._write()
        self.parts.flush()

    def _write(self, *, at_once: bool = False) -> None:
        if not self.parts.ready(at_once=at_once):
            return
        # No more than is there now: a file that begins makes messages of its own.
        for _ in range(len(self._queue)):
            recorded = self._queue.popleft()
            with self._lock:
                self._queued_bytes -= len(recorded.received.payload) + OVERHEAD
            if not self.parts.add(recorded):
                return
            # What comes fast must not keep the chunk from being written.
            self.parts.flush()
            if self.parts.trouble is not None:
                return

    def summary(self) -> Summary:
        """What has been done so far."""
        with self._lock:
            received, lost = self._sequence, self._overflowed + self.parts.lost
        recorded = self.parts.recorded
        return Summary(
            received, recorded, lost, received - lost - recorded, self.parts.bytes, len(self.parts.files),
            self._folder.removed,
        )  # fmt: skip

    def status(self) -> ServiceStatus:
        """Counters and gauges of this moment."""
        summary = self.summary()
        gauges = {"queue_bytes": float(self._queued_bytes), "waiting": float(summary.waiting)}
        with suppress(OSError):
            gauges["disk_free"] = float(self.parts.free)
        problems = [] if self.parts.trouble is None else [f"nothing can be recorded now: {self.parts.trouble}"]
        if summary.lost:
            problems.append(f"{summary.lost} messages were not recorded")
        return ServiceStatus(
            kind=KIND, instance=self.instance, t=self._clock.time_ns(), started=self._started,
            counters={
                "received": summary.received, "recorded": summary.recorded, "lost": summary.lost,
                "bytes": summary.bytes, "files": summary.files, "files_removed": summary.removed,
            },
            gauges=gauges, refused=self.rejections.snapshot(), problems=[problem[:300] for problem in problems],
        )  # fmt: skip

    def _put_status(self) -> None:
        try:
            self._status.put(self.status().encode())
        # A network in trouble must not stop what still comes from being written.
        except Exception as error:
            _log.warning("status not published", error=f"{type(error).__name__}: {error}")
