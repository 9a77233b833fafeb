"""One MCAP file that is being written: whole chunks go to the disk, and stay whole when it is full."""

import os
from collections.abc import Callable, Hashable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Final, cast

from mcap.writer import CompressionType, Writer

from fleet_bus.pubsub import Received
from fleet_recorder import layout
from fleet_recorder.layout import Recorded, SceneMessage

#: Bytes of messages, before they are compressed, that make a chunk full.
CHUNK_BYTES: Final = 1 << 20
#: Channels in one file: MCAP numbers them by 16 bits.
MOST_CHANNELS: Final = 60_000
#: Places in the index, one for each channel in each chunk, which are kept in memory until the file ends.
MOST_PLACES: Final = 1_000_000

#: Writes bytes to a descriptor at an offset, as ``os.pwrite``.
Write = Callable[[int, memoryview, int], int]


class _Sink:
    """The stream that the MCAP writer writes to: memory, until ``write_out`` puts all of it to the file at once."""

    def __init__(self, descriptor: int, sync: bool, write: Write) -> None:
        self.descriptor = descriptor
        #: Bytes in the file, which ends with a whole record.
        self.whole = 0
        self._sync = sync
        self._write = write
        self._waiting = bytearray()

    def write(self, data: bytes) -> int:
        self._waiting += data
        return len(data)

    def tell(self) -> int:
        return self.whole + len(self._waiting)

    def flush(self) -> None:
        """When bytes go to the disk is not the MCAP writer's to say."""

    @property
    def waiting(self) -> int:
        return len(self._waiting)

    def write_out(self) -> None:
        """Write what waits; where that raises ``OSError``, the file is as it was, and all of it still waits."""
        if not self._waiting:
            return
        try:
            rest, place = memoryview(bytes(self._waiting)), self.whole
            while rest:
                count = self._write(self.descriptor, rest, place)
                rest, place = rest[count:], place + count
            if self._sync:
                os.fsync(self.descriptor)
        except OSError:
            # Half of a chunk would be read as the end of the file, by readers of what follows.
            with suppress(OSError):
                os.ftruncate(self.descriptor, self.whole)
            raise
        self.whole += len(self._waiting)
        self._waiting.clear()


class RecordingFile:
    """A new file at ``path``; messages wait in memory until ``flush``.

    ``details`` describe the recording; ``sync`` waits for the disk at every flush; ``write`` stands in for
    ``os.pwrite``. Raises ``OSError`` (``FileExistsError`` if there is one) if it cannot be made.

    Attributes:
        path: where it is.
        finished: whether it has its summary, which may still wait to be written.
    """

    def __init__(
        self, path: Path, details: Mapping[str, str], *, sync: bool = False, chunk_bytes: int = CHUNK_BYTES,
        write: Write = os.pwrite,
    ) -> None:  # fmt: skip
        self.path = path
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self._sink = _Sink(descriptor, sync, write)
        self._open = True
        self.finished = False
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[Hashable, int] = {}
        self._in_chunk: set[int] = set()
        self._places = 0
        # Without the checksum of all, a reader in file order skips a chunk whose head is damaged, and says nothing.
        self._mcap = Writer(
            cast("IO[Any]", self._sink),
            chunk_size=chunk_bytes,
            compression=CompressionType.ZSTD,
            enable_data_crcs=True,
        )
        self._mcap.start(layout.PROFILE)
        known = " ".join(sorted(layout.known_schemas()))
        self._mcap.add_metadata(layout.DETAILS, {"format": str(layout.FORMAT), "schemas": known, **details})

    @property
    def size(self) -> int:
        """Bytes in the file, and of those that wait for the disk."""
        return self._sink.tell()

    @property
    def written(self) -> int:
        """Bytes in the file."""
        return self._sink.whole

    @property
    def waiting(self) -> int:
        """Bytes of whole chunks that wait for ``write_out``."""
        return self._sink.waiting

    @property
    def full(self) -> bool:
        """Whether it has as many channels, or as large an index, as a file may have."""
        return len(self._channels) >= MOST_CHANNELS or self._places + len(self._in_chunk) >= MOST_PLACES

    @property
    def there(self) -> bool:
        """Whether the file is still where it was made, and not removed or replaced by somebody."""
        try:
            found, own = self.path.stat(), os.fstat(self._sink.descriptor)
        except OSError:
            return False
        return (found.st_ino, found.st_dev) == (own.st_ino, own.st_dev)

    def add(self, recorded: Recorded) -> None:
        """Take a message of the bus; raise ``ValueError`` for one that MCAP has no room for."""
        received = recorded.received
        carried_ns = received.arrived_ns if recorded.carried else None
        identity = received.key, received.source, received.encoding, received.timestamp_ns is None, carried_ns
        channel = self._channels.get(identity)
        if channel is None:
            # A record that fails when it is half written would spoil its chunk.
            for text in (received.key, received.source, received.encoding):
                text.encode()
            channel = self._channels[identity] = self._mcap.register_channel(
                received.key,
                layout.message_encoding(received.encoding),
                self._schema_of(received),
                layout.metadata(received, recorded.carried),
            )
        self._add(
            channel,
            recorded.logged_ns,
            layout.publish_time(received, recorded.logged_ns),
            received.payload,
            recorded.sequence % layout.SEQUENCES,
        )

    def add_scene(self, message: SceneMessage) -> None:
        """Take a message for viewers."""
        schema = self._schema(message.schema, message.schema_encoding, message.schema_data)
        identity = message.topic, schema, message.message_encoding
        channel = self._channels.get(identity)
        if channel is None:
            channel = self._channels[identity] = self._mcap.register_channel(
                message.topic, message.message_encoding, schema, {layout.FLEET: layout.SCENE}
            )
        self._add(channel, message.time_ns, message.time_ns, message.payload, 0)

    def _add(self, channel: int, logged: int, published: int, payload: bytes, sequence: int) -> None:
        if logged not in layout.TIMES or published not in layout.TIMES:
            raise ValueError(f"the times {logged} and {published} ns do not fit into 64 bits")
        self._in_chunk.add(channel)
        self._mcap.add_message(channel, logged, payload, published, sequence)

    def _schema_of(self, received: Received) -> int:
        name = layout.schema_name(received.encoding)
        data = layout.known_schemas().get(name)
        return 0 if data is None else self._schema(name, "jsonschema", data)

    def _schema(self, name: str, encoding: str, data: bytes) -> int:
        if not name:
            return 0
        known = self._schemas.get((name, encoding, data))
        if known is None:
            known = self._schemas[name, encoding, data] = self._mcap.register_schema(name, encoding, data)
        return known

    def flush(self) -> None:
        """End the chunk and write it; raises ``OSError`` as ``write_out`` does."""
        if not self.finished:
            self._mcap.flush()  # type: ignore[no-untyped-call]
            self._places += len(self._in_chunk)
            self._in_chunk.clear()
        self._sink.write_out()

    def write_out(self) -> None:
        """Write the chunks that are full; where that raises ``OSError``, the file is as it was, and they wait on."""
        self._sink.write_out()

    def finish(self) -> None:
        """Write the rest, with a summary, and close; where that raises ``OSError`` it may be tried again."""
        if not self.finished:
            self._mcap.finish()  # type: ignore[no-untyped-call]
            self.finished = True
        self._sink.write_out()
        self.close()

    def close(self) -> None:
        """Close the file as it is; without ``finish`` it has no summary and lacks what waits."""
        if self._open:
            self._open = False
            os.close(self._sink.descriptor)
