"""The files of a recorder in its folder: names, who may write there, and which are removed first."""

import fcntl
import os
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, Self

import structlog

from fleet_bus.errors import UsageError

_log = structlog.get_logger(__name__)

#: Files that a recorder wrote, and may remove: nobody else's have such names. Sorted by name they are in order of time.
_NAME: Final = re.compile(r"fleet-\d{8}T\d{6}\.\d{3}Z-\d{6}\.mcap")


def file_name(started_ns: int, part: int) -> str:
    """Name of a part, counted from 1, of the recording that began at ``started_ns`` (Unix ns)."""
    seconds, rest = divmod(max(0, started_ns), 10**9)
    instant = datetime.fromtimestamp(seconds, UTC)
    return f"fleet-{instant:%Y%m%dT%H%M%S}.{rest // 10**6:03d}Z-{part:06d}.mcap"


class Folder:
    """A folder that this recorder alone writes to, until ``close`` or the end of its ``with`` block.

    ``limit`` (bytes) is what all files of recorders in it may take together; the oldest are removed. Raises
    ``UsageError`` where the folder cannot be written to, or another recorder does.

    Attributes:
        path: the folder.
        removed: how many files were removed.
    """

    def __init__(self, path: Path, limit: int | None = None) -> None:
        self.path = path
        self.removed = 0
        self._limit = limit
        try:
            path.mkdir(parents=True, exist_ok=True)
            self._descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except OSError as error:
            raise _unusable(path, error) from None
        try:
            if not os.access(path, os.W_OK | os.X_OK):
                raise UsageError(f"{path} cannot be written to: name another folder with -o")
            # Each would remove what the other one writes.
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._descriptor)
            raise UsageError(f"another recorder writes to {path}: name another folder with -o") from None
        except BaseException:
            os.close(self._descriptor)
            raise
        self._open = True

    def files(self) -> list[tuple[Path, int]]:
        """Files of recorders and their sizes in bytes, the oldest first."""
        found = []
        for path in sorted(self.path.iterdir()):
            if _NAME.fullmatch(path.name):
                try:
                    found.append((path, path.stat().st_size))
                except FileNotFoundError:
                    continue
        return found

    def make_room(self, wanted: int) -> None:
        """Remove the oldest files until ``wanted`` bytes more keep within the limit; raises ``OSError``."""
        if self._limit is None:
            return
        found = self.files()
        total = sum(size for _, size in found)
        for path, size in found:
            if total + wanted <= self._limit:
                return
            path.unlink()
            self.removed += 1
            total -= size
            _log.info("oldest file removed", file=str(path), limit=self._limit)

    def close(self) -> None:
        """Let others write here; closing again does nothing."""
        if self._open:
            self._open = False
            os.close(self._descriptor)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()


def _unusable(path: Path, error: OSError) -> UsageError:
    return UsageError(f"{path} is no folder to record to: {error.strerror or error}; name another with -o")
