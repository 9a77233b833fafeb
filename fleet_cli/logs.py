"""Lines to stdout and stderr that never end or hold up the process: what cannot be written is lost, and counted.

A service outlives its log. The disk may be full, the reader of a pipe may have gone, or it may be there and read
nothing: then a plain write raises, or blocks whoever wrote the line, which may be Zenoh's network thread.
"""

import atexit
import io
import os
import select
import sys
import threading
import warnings
from collections import deque
from typing import Any, Final, TextIO

import structlog

#: Lines that wait for a stream that takes none; what comes then is lost.
WAITING: Final = 10_000
#: Seconds that a process which ends leaves its last lines to be written.
FLUSH_SECONDS: Final = 1.0


class LineWriter:
    """Writes lines to a stream, in order, from a thread of its own; neither blocks nor raises.

    A stream without a file descriptor is written to at once, by whoever has the line.

    Attributes:
        stream: where the lines go; None where there is none.
        lost: lines that were not written, since the stream took none; told there once it takes some again.
    """

    def __init__(self, stream: TextIO | None, waiting: int = WAITING) -> None:
        self.stream = stream
        self.lost = 0
        self._told = 0
        self._limit = waiting
        self._descriptor = _descriptor(stream)
        self._lines: deque[str] = deque()
        self._pending = 0
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None

    def line(self, text: str) -> None:
        """Write a line, when its turn comes."""
        if self._descriptor is None:
            self._write_now(text)
            return
        with self._changed:
            if len(self._lines) >= self._limit or not self._begun():
                self.lost += 1
                return
            self._lines.append(text)
            self._pending += 1
            self._changed.notify_all()

    def flush(self, timeout: float = FLUSH_SECONDS) -> bool:
        """Whether all lines are written or lost; waits for it, ``timeout`` seconds at most."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._pending, timeout)

    def _begun(self) -> bool:
        if self._thread is None:
            # A daemon: a stuck stream must not keep the process from ending.
            thread = threading.Thread(target=self._work, name="lines", daemon=True)
            try:
                thread.start()
            except RuntimeError:
                return False
            self._thread = thread
        return True

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: bool(self._lines))
                text = self._lines.popleft()
                owed = self.lost - self._told
            told = owed if owed and self._write(f"{owed} lines could not be written here") else 0
            written = self._write(text)
            with self._changed:
                self._told += told
                self.lost += not written
                self._pending -= 1
                self._changed.notify_all()

    def _write(self, text: str) -> bool:
        assert self._descriptor is not None
        data = memoryview(f"{text}\n".encode(errors="backslashreplace"))
        while data:
            try:
                # Whoever shares a pipe may have made it non-blocking.
                select.select([], [self._descriptor], [])
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:
                continue
            except (OSError, ValueError):
                return False
        return True

    def _write_now(self, text: str) -> None:
        try:
            if self.stream is None:
                raise OSError("there is no stream")
            print(text, file=self.stream, flush=True)
        except (OSError, ValueError):
            self.lost += 1


class _Logger:
    """What structlog's loggers write to: every level is one line."""

    def __init__(self, writer: LineWriter) -> None:
        self._writer = writer

    def msg(self, message: str) -> None:
        self._writer.line(message)

    log = debug = info = warn = warning = error = critical = fatal = exception = failure = err = msg


class LoggerFactory:
    """Makes the loggers of a process, which share one writer.

    Attributes:
        writer: where their lines go.
    """

    def __init__(self, stream: TextIO | None) -> None:
        self.writer = LineWriter(stream)

    def __call__(self, *args: Any) -> _Logger:
        return _Logger(self.writer)


_writers: dict[str, LineWriter] = {}


def configure(level: int, *, as_json: bool = False) -> None:
    """Send the log of this process from ``level`` (as in ``logging``) on, and Python's warnings, to stderr; ``as_json``
    as an object a line, with ``event``, ``level`` and ``timestamp``."""
    factory = LoggerFactory(sys.stderr)
    _writers["stderr"] = factory.writer
    colors = sys.stderr is not None and sys.stderr.isatty()
    renderers = (
        [structlog.processors.dict_tracebacks, structlog.processors.JSONRenderer(default=str)]
        if as_json
        else [structlog.dev.ConsoleRenderer(colors=colors)]
    )
    structlog.configure(
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            *renderers,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=factory,
    )
    warnings.showwarning = _show_warning


def say(text: str) -> None:
    """Print a line of a service to stdout; a stdout that takes none does not end the service."""
    writer = _writers.get("stdout")
    if writer is None or writer.stream is not sys.stdout:
        writer = _writers["stdout"] = LineWriter(sys.stdout)
    writer.line(text)


def tell(text: str) -> None:
    """Say to stderr what the user must know, whatever the level of the log."""
    if "stderr" not in _writers:
        _writers["stderr"] = LineWriter(sys.stderr)
    _writers["stderr"].line(text)


def warn(text: str) -> None:
    """Say to stderr what the user should know, whatever the level of the log."""
    tell(f"warning: {text}")


def flush() -> None:
    """Leave what was said the time to be written."""
    for writer in _writers.values():
        writer.flush()


def keep_standard_streams() -> None:
    """Let closed standard streams lead nowhere, so that no socket gets the number of one and with it what is said."""
    descriptor = os.open(os.devnull, os.O_RDWR)
    while descriptor <= 2:
        descriptor = os.open(os.devnull, os.O_RDWR)
    os.close(descriptor)


def _show_warning(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
    warn(str(message))


def _descriptor(stream: TextIO | None) -> int | None:
    """The stream's file descriptor, if it is a file and not one that a test put in its place."""
    try:
        return None if stream is None else stream.fileno()
    except (AttributeError, ValueError, OSError, io.UnsupportedOperation):
        return None


atexit.register(flush)
