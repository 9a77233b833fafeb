"""A recording in parts: when one file ends and the next begins, and what happens when the disk takes no more."""

import errno
import os
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import structlog

from fleet_bus.clock import SYSTEM, Clock
from fleet_bus.errors import MessageError
from fleet_bus.pubsub import Received
from fleet_bus.rejections import Rejections
from fleet_recorder import layout
from fleet_recorder.files import Folder, file_name
from fleet_recorder.layout import Recorded, SceneMessage
from fleet_recorder.recording_file import CHUNK_BYTES, RecordingFile, Write

_log = structlog.get_logger(__name__)

#: Seconds after which a chunk is written, full or not; with a round of the recorder it is less than one.
FLUSH_SECONDS: Final = 0.8
#: Seconds between two attempts to write to a disk that took nothing.
RETRY_SECONDS: Final = 1.0
#: Keys of which the message in force is repeated in every file; the oldest are let go.
MOST_CARRIED: Final = 50_000

Scene = Callable[[Received], Iterable[SceneMessage]]


@dataclass(frozen=True, slots=True)
class Rules:
    """How a recording is written: a part ends at ``part_bytes`` or after ``part_seconds``; ``keep_free`` bytes of the
    disk are left to others; ``sync`` waits for the disk at every chunk."""

    part_bytes: int = 256 << 20
    part_seconds: float = 600.0
    keep_free: int = 64 << 20
    sync: bool = False
    chunk_bytes: int = CHUNK_BYTES


class Parts:
    """The parts of one recording in ``folder``, each of which stands on its own: it begins with what is in force.

    What ``scene`` returns, anew for each file, makes messages for viewers out of those of the bus. ``details`` describe
    the recording in each file; ``opened`` is called when a file has begun. ``write`` and ``free`` stand in for
    ``os.pwrite`` and the bytes that are free on a folder's disk. No method raises what the disk raises: ``trouble``
    says it, and nothing more is taken until it is over.

    Attributes:
        trouble: why nothing can be written now; None if it can.
        recorded: messages that were written to a file.
        lost: messages that were taken, and are in none.
        written: bytes of the files that are complete.
        files: the files of this recording.
    """

    def __init__(
        self,
        folder: Folder,
        rules: Rules,
        *,
        clock: Clock = SYSTEM,
        scene: Callable[[], Scene] | None = None,
        details: Mapping[str, str] | None = None,
        rejections: Rejections | None = None,
        opened: Callable[[], object] = bool,
        write: Write = os.pwrite,
        free: Callable[[Path], int] = lambda path: shutil.disk_usage(path).free,
    ) -> None:
        self.trouble: str | None = None
        self.recorded = 0
        self.lost = 0
        self.written = 0
        self.files: list[Path] = []
        self._folder = folder
        self._rules = rules
        self._clock = clock
        self._new_scene = scene
        self._scene: Scene | None = None
        self._started_ns = clock.time_ns()
        self._details = {"recording": str(self._started_ns), **(details or {})}
        self._rejections = rejections or Rejections()
        self._opened = opened
        self._write = write
        self._free = free
        self._file: RecordingFile | None = None
        self._part = 0
        self._began = self._next_flush = clock.monotonic()
        self._next_try = -float("inf")
        self._troubled = 0.0
        #: Messages in the file's memory.
        self._pending = 0
        self._in_force: dict[str, Recorded] = {}

    @property
    def bytes(self) -> int:
        """Bytes in all files of this recording."""
        return self.written + (self._file.written if self._file is not None else 0)

    @property
    def free(self) -> int:
        """Bytes that are free on the disk; raises ``OSError``."""
        return self._free(self._folder.path)

    def ready(self, *, at_once: bool = False) -> bool:
        """Whether messages can be taken now: there is a file, and the disk has taken what came before. In trouble it is
        tried again once a second, or ``at_once``."""
        if self.trouble is not None and not at_once and self._clock.monotonic() < self._next_try:
            return False
        return self._attempt(self._prepare)

    def add(self, recorded: Recorded) -> bool:
        """Take a message, once ``ready``; whether the next one can be taken, too."""
        assert self._file is not None
        self._put(self._file, recorded)
        if layout.stays(recorded.received):
            self._keep(recorded)
        if self._file.waiting or self._file.full:
            return self._attempt(self._write_chunks)
        return True

    def flush(self, *, now: bool = False) -> None:
        """Write the chunk if it is old enough, or ``now``; begin a new file if this one is large or old enough."""
        if self.trouble is None and (now or self._clock.monotonic() >= self._next_flush):
            self._attempt(self._flush)

    def close(self) -> None:
        """Write the rest and the summary, or say that it cannot be."""
        file = self._file
        if file is None:
            return
        if not self._attempt(self._finish):
            _log.warning("the last file lacks its end, and a summary", file=str(file.path), lost=self._pending)
            self.lost += self._pending
            self.written += file.written
            file.close()
        self._file = None

    def _put(self, file: RecordingFile, recorded: Recorded) -> None:
        try:
            file.add(recorded)
        except ValueError as error:
            self.lost += 1
            self._rejections.count(MessageError("range", str(error)), recorded.received.key)
            return
        self._pending += 1
        if self._scene is None:
            return
        try:
            for message in self._scene(recorded.received):
                file.add_scene(message)
        # A message that nobody can draw is recorded all the same.
        except Exception as error:
            reason = error.reason if isinstance(error, MessageError) else "malformed"
            detail = f"not in the scene: {type(error).__name__}: {error}"
            self._rejections.count(MessageError(reason, detail), recorded.received.key)

    def _keep(self, recorded: Recorded) -> None:
        key = recorded.received.key
        self._in_force.pop(key, None)
        if recorded.received.encoding == layout.TOKEN and not layout.is_alive(recorded.received):
            return
        self._in_force[key] = recorded
        if len(self._in_force) > MOST_CARRIED:
            oldest = next(iter(self._in_force))
            del self._in_force[oldest]
            detail = f"more than {MOST_CARRIED} keys hold something: it is not repeated in the next file"
            self._rejections.count(MessageError("overflow", detail), oldest)

    def _attempt(self, what: Callable[[], None]) -> bool:
        """Do something with the disk; whether it worked. What it says is told once, and once more when it is over."""
        now = self._clock.monotonic()
        try:
            what()
        except OSError as error:
            self._next_try = now + RETRY_SECONDS
            why = f"{self._folder.path}: {error.strerror or error}"
            if self.trouble is None:
                self._troubled = now
                _log.warning("nothing can be recorded now; trying again", why=why)
            self.trouble = why
            return False
        if self.trouble is not None:
            self.trouble = None
            _log.warning("recording goes on", after_seconds=round(now - self._troubled, 1))
        return True

    def _prepare(self) -> None:
        if self._file is not None and self._file.finished:
            self._finish()
        elif self._file is not None:
            self._write_chunks()
        if self._file is None:
            self._begin()

    def _check_room(self, wanted: int) -> None:
        free = self.free
        if free < self._rules.keep_free + wanted:
            text = f"{free / 1e6:.0f} MB are free, {self._rules.keep_free / 1e6:.0f} MB of them are kept for others"
            raise OSError(errno.ENOSPC, text)

    def _write_chunks(self) -> None:
        assert self._file is not None
        if self._file.waiting:
            self._check_room(self._file.waiting)
            self._file.write_out()
        if self._file.full or self._file.size >= self._rules.part_bytes:
            self._finish()
            self._begin()

    def _flush(self) -> None:
        self._next_flush = self._clock.monotonic() + FLUSH_SECONDS
        file = self._file
        if file is None:
            return
        if not file.there:
            _log.warning("somebody removed a file, with all that it held; the next begins", file=str(file.path))
            self.lost += self._pending
            self._pending = 0
            file.close()
            self._file = None
            self._begin()
            return
        if self._pending:
            self._check_room(0)
        file.flush()
        self._settle()
        if self._clock.monotonic() - self._began >= self._rules.part_seconds:
            self._finish()
            self._begin()
        else:
            self._write_chunks()

    def _settle(self) -> None:
        """What was taken is on the disk."""
        self.recorded += self._pending
        self._pending = 0

    def _finish(self) -> None:
        assert self._file is not None
        self._file.finish()
        self._settle()
        self.written += self._file.written
        self._file = None

    def _begin(self) -> None:
        self._folder.path.mkdir(parents=True, exist_ok=True)
        self._check_room(0)
        self._folder.make_room(self._rules.part_bytes)
        while self._file is None:
            self._part += 1
            path = self._folder.path / file_name(self._started_ns, self._part)
            details = {**self._details, "part": str(self._part)}
            try:
                self._file = RecordingFile(
                    path, details, sync=self._rules.sync, chunk_bytes=self._rules.chunk_bytes, write=self._write
                )
            except FileExistsError:
                continue
        self.files.append(self._file.path)
        self._scene = None if self._new_scene is None else self._new_scene()
        now_ns = self._clock.time_ns()
        self._began = self._clock.monotonic()
        self._next_flush = self._began + FLUSH_SECONDS
        for recorded in self._in_force.values():
            self._put(self._file, recorded._replace(logged_ns=now_ns, carried=True))
        self._pending = 0
        self._opened()
        self._file.write_out()
