"""Records of MCAP files, one after the other, in bounded memory: whole ones, cut ones, and damaged ones told apart.

The library's own reader ends a file that was cut off and one that is damaged with the same errors, and reads as much
into memory as a length in the file says. Here a record is read only when all of it is there; what is in it, the library
reads.
"""

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, Any, Final

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError, UnsupportedCompressionError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, McapRecord, Message, Metadata, Schema, Statistics
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from fleet_bus.errors import RecordingError

#: Longest record, and longest chunk once it is unpacked, that is read into memory.
MOST_BYTES: Final = 256 << 20

_HEAD: Final = struct.Struct("<BQ")
_FOOTER_BYTES: Final = 20
_OPCODES: Final = frozenset(map(int, Opcode))
#: Kinds from here on are anybody's, those below it MCAP's.
_FIRST_PRIVATE: Final = 0x80


class Chunks:
    """The records of a file in file order, those inside of chunks among them; iterates once.

    Yields headers, metadata, schemas, channels and messages. Raises ``RecordingError`` where the file is missing,
    empty, no MCAP file or damaged.

    Attributes:
        cut: after the last record, how many bytes at the end of a file that was cut off are of no use; None if it is
            whole.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.cut: int | None = None
        self._messages = 0
        #: Messages by the statistics in its summary.
        self._counted: int | None = None
        try:
            self._size = path.stat().st_size
            with path.open("rb") as file:
                begin = file.read(len(MCAP0_MAGIC))
        except FileNotFoundError:
            raise RecordingError(f"{path}: there is no such file") from None
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from None
        if not begin:
            raise RecordingError(f"{path}: the file is empty: its recorder ended before it wrote anything")
        if not MCAP0_MAGIC.startswith(begin):
            raise RecordingError(
                f"{path}: not an MCAP file: it begins with {begin!r}; expected a recording of `fleet record`"
            )

    def __iter__(self) -> Iterator[McapRecord]:
        with self.path.open("rb") as file:
            file.seek(len(MCAP0_MAGIC))
            place = len(MCAP0_MAGIC)
            while True:
                head = file.read(_HEAD.size)
                if len(head) < _HEAD.size:
                    break
                opcode, length = _HEAD.unpack(head)
                after = place + _HEAD.size + length
                if after > self._size and self._grown(file) < after:
                    break
                if length > MOST_BYTES:
                    raise self._damaged(place, f"a record of {length} bytes; at most {MOST_BYTES} are read")
                body = file.read(length)
                if opcode == Opcode.FOOTER:
                    self._check_footer(body, place)
                    return
                for record in self._records(opcode, body, place):
                    self._messages += isinstance(record, Message)
                    yield record
                place = after
                file.seek(place)
            self.cut = max(0, self._grown(file) - place)

    def _grown(self, file: IO[bytes]) -> int:
        """The size now: a recorder may still be writing."""
        here = file.tell()
        self._size = file.seek(0, 2)
        file.seek(here)
        return self._size

    def _records(self, opcode: int, body: bytes, place: int) -> Iterator[McapRecord]:
        kind = _KINDS.get(opcode)
        if opcode < _FIRST_PRIVATE and opcode not in _OPCODES:
            raise self._damaged(place, f"a record of the unknown kind {opcode}")
        try:
            stream = ReadDataStream(BytesIO(body))
            if opcode == Opcode.CHUNK:
                yield from _unpack(Chunk.read(stream))
            elif opcode == Opcode.MESSAGE:
                yield Message.read(stream, len(body))
            elif opcode == Opcode.STATISTICS:
                self._counted = Statistics.read(stream).message_count
            elif kind is not None:
                yield kind.read(stream)
        except UnsupportedCompressionError as error:
            raise RecordingError(f"{self.path}: {error}: repack it with zstd") from None
        except (McapError, struct.error, ValueError, zstandard.ZstdError, MemoryError) as error:
            raise self._damaged(place, f"{type(error).__name__}: {error}") from None

    def _check_footer(self, body: bytes, place: int) -> None:
        """A bit that flipped in the head of a record makes another record of it, which may be skipped in silence."""
        if len(body) != _FOOTER_BYTES:
            raise self._damaged(place, f"its last record has {len(body)} bytes; expected {_FOOTER_BYTES}")
        if self._counted not in (None, self._messages):
            raise self._damaged(place, f"it holds {self._counted} messages, of which {self._messages} came")

    def _damaged(self, place: int, why: str) -> RecordingError:
        return RecordingError(f"{self.path}: damaged at byte {place}: {why}; what stands before it is sound")


_KINDS: Final[dict[int, Any]] = {
    Opcode.HEADER: Header,
    Opcode.METADATA: Metadata,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
}


def _unpack(chunk: Chunk) -> list[McapRecord]:
    sizes = [chunk.uncompressed_size]
    if chunk.compression == "zstd":
        # What is allocated is what the frame says, not what the chunk says.
        sizes.append(zstandard.frame_content_size(chunk.data))
    if max(sizes) > MOST_BYTES:
        raise ValueError(f"a chunk of {max(sizes)} bytes; at most {MOST_BYTES} are read")
    return breakup_chunk(chunk, validate_crc=True)
