"""Reading recordings: the messages of the bus as they came, in the order in which they were written."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Final

import structlog
from mcap.reader import make_reader
from mcap.records import Channel, Header, Message, Metadata, Schema

from fleet_bus.errors import RecordingError
from fleet_bus.pubsub import Received
from fleet_recorder import layout
from fleet_recorder.chunks import Chunks
from fleet_recorder.layout import Recorded

_log = structlog.get_logger(__name__)

#: Called with the schema, the channel and the message of what only viewers read.
OnScene = Callable[[Schema | None, Channel, Message], object]
#: Channels that are named of a file that is none of ours.
_NAMED: Final = 8


def read(paths: Path | Sequence[Path], warn: Callable[[str], object] | None = None) -> Iterator[Received]:
    """The messages of one recording, or several one after the other, exactly as they came to the recorder.

    A folder stands for the ``*.mcap`` files in it, in the order of their names. What a file repeats of the one before
    it comes once. A file that was cut off gives what is whole; ``warn`` is told that, and of messages that were not
    recorded (by default the log is). In bounded memory.

    Raises ``RecordingError`` that says what to do: at once for a file that is missing, empty or no MCAP file, or a
    whole one of another program; where it is reached, for one that was cut off, is damaged or comes from a newer
    version.
    """
    reading = Reading(paths, warn=warn)
    return (recorded.received for recorded in reading)


class Reading:
    """``read`` with what a recording says beside the messages; iterates once. Raises as ``read`` does.

    ``scene`` gets the messages that only viewers read.

    Attributes:
        messages: how many messages of the bus came so far.
        missing: how many came to the recorder, and were not recorded.
        cut: files that were cut off.
    """

    def __init__(
        self,
        paths: Path | Sequence[Path],
        *,
        warn: Callable[[str], object] | None = None,
        scene: OnScene | None = None,
    ) -> None:
        self.messages = 0
        self.missing = 0
        self.cut: list[Path] = []
        self._paths = expand(paths)
        for path in self._paths:
            _check_contents(path)
        self._warn = warn or _log.warning
        self._scene = scene
        self._warned: set[str] = set()
        #: Recording and part that was read last, and the last sequence in it.
        self._recording, self._part = "", 0
        self._last: int | None = None

    def __iter__(self) -> Iterator[Recorded]:
        for path in self._paths:
            yield from self._file(path)
        if not self.messages:
            names = ", ".join(map(str, islice(self._paths, _NAMED)))
            why = "it was cut off before anything was whole" if self.cut else "nothing came while it was written"
            raise RecordingError(f"{names}: no messages of the bus: {why}")

    def _file(self, path: Path) -> Iterator[Recorded]:
        chunks = Chunks(path)
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        ours, follows, before, missing = False, False, self.messages, self.missing
        for record in chunks:
            if isinstance(record, Message):
                channel = channels.get(record.channel_id)
                if channel is None:
                    raise RecordingError(
                        f"{path}: damaged: a message on channel {record.channel_id}, which is not there"
                    )
                if layout.FLEET not in channel.metadata:
                    continue
                ours = True
                if channel.metadata[layout.FLEET] == layout.SCENE:
                    if self._scene is not None:
                        self._scene(schemas.get(channel.schema_id), channel, record)
                    continue
                recorded = layout.recorded(
                    channel.topic, channel.metadata, record.data,
                    log_time=record.log_time, publish_time=record.publish_time, sequence=record.sequence,
                )  # fmt: skip
                if recorded.carried:
                    if follows:
                        continue
                else:
                    self._count_missing(record.sequence)
                self.messages += 1
                yield recorded
            elif isinstance(record, Channel):
                channels[record.id] = record
                self._check_channel(path, record)
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Metadata) and record.name == layout.DETAILS:
                ours = True
                follows = self._begin(path, record.metadata)
            elif isinstance(record, Header):
                ours = ours or record.profile == layout.PROFILE
        if not ours and channels:
            raise foreign(path, channels.values(), schemas)
        if chunks.cut is not None:
            self.cut.append(path)
            self._warn(
                f"{path}: cut off, or still being written: {self.messages - before} messages came, {chunks.cut} bytes "
                "at its end are no whole chunk"
            )
        if self.missing > missing:
            self._warn(
                f"{path}: {self.missing - missing} messages came to the recorder and are not in the recording: it "
                "could not keep up, its disk was full, or they were lost later"
            )

    def _begin(self, path: Path, details: dict[str, str]) -> bool:
        """Take in what describes a file; whether it goes on where the last one ended."""
        _check_details(path, details)
        recording, part = details.get("recording", ""), details.get("part", "")
        number = int(part) if part.isdecimal() else 0
        same = bool(recording) and recording == self._recording
        follows = same and number == self._part + 1
        self._recording, self._part = recording, number
        if not same:
            self._last = None
        return follows

    def _count_missing(self, sequence: int) -> None:
        if self._last is not None:
            gap = (sequence - self._last - 1) % layout.SEQUENCES
            # What was written out of order is not missing.
            if gap < layout.SEQUENCES // 2:
                self.missing += gap
        self._last = sequence

    def _check_channel(self, path: Path, channel: Channel) -> None:
        found = channel.metadata.get(layout.FLEET, layout.SCENE)
        if found != layout.SCENE and found != str(layout.FORMAT):
            raise _newer(path, f"its channel {channel.topic!r:.120} has the layout {found!r:.20}")
        name = layout.schema_name(channel.metadata.get(layout.ENCODING, ""))
        if newer_than(name) and name not in self._warned:
            self._warned.add(name)
            known = newest(name)
            self._warn(f"{path}: {name} on {channel.topic}: this program reads {known}, and will refuse these messages")


def expand(paths: Path | Sequence[Path]) -> list[Path]:
    """Files that some paths stand for; raise ``RecordingError`` for a folder without recordings."""
    found: list[Path] = []
    for path in [paths] if isinstance(paths, Path) else paths:
        if not path.is_dir():
            found.append(path)
            continue
        inside = sorted(path.glob("*.mcap"))
        if not inside:
            raise RecordingError(f"{path}: no recordings (*.mcap) in this folder")
        found += inside
    return found


def newest(name: str) -> str:
    """The newest version that this program knows of a schema given with some version; empty for an unknown one."""
    base = name.rpartition(".v")[0]
    versions = [other for other in layout.known_schemas() if other.rpartition(".v")[0] == base]
    return max(versions, key=_version, default="")


def newer_than(name: str) -> bool:
    """Whether a schema, given with its version, is a newer version of one that this program knows."""
    known = newest(name)
    return bool(known) and _version(name) > _version(known)


def _version(name: str) -> int:
    text = name.rpartition(".v")[2]
    return int(text) if text.isdecimal() else 0


def _check_contents(path: Path) -> None:
    """Find out at once whether a file can be read, as far as its beginning and its summary say so."""
    # What is wrong with a file as a whole.
    Chunks(path)
    with path.open("rb") as file:
        try:
            summary = make_reader(file).get_summary()
        # Cut off, damaged, still being written: the library has many ways to say so.
        except Exception:
            summary = None
    if summary is None or not summary.channels:
        return
    if not any(layout.FLEET in channel.metadata for channel in summary.channels.values()):
        raise foreign(path, summary.channels.values(), summary.schemas)


def _check_details(path: Path, details: dict[str, str]) -> None:
    """Raise ``RecordingError`` for a recording whose recorder knew more than this program."""
    version = details.get("format", "")
    if version.isdecimal() and int(version) > layout.FORMAT:
        raise _newer(path, f"it has the layout {version}, this program reads {layout.FORMAT}")
    newer = sorted(name for name in details.get("schemas", "").split() if newer_than(name))
    if newer:
        raise _newer(path, f"it knows {', '.join(newer)}, this program {', '.join(map(newest, newer))}")


def _newer(path: Path, what: str) -> RecordingError:
    return RecordingError(f"{path}: recorded by a newer version of fleet-reach: {what}; update to read it")


def foreign(path: Path, channels: Iterable[Channel], schemas: dict[int, Schema]) -> RecordingError:
    """The error about a file of another program, which names what is inside."""
    every = list(channels)
    named = []
    for channel in every[:_NAMED]:
        schema = schemas.get(channel.schema_id)
        what = schema.name if schema is not None else channel.message_encoding or "no schema"
        named.append(f"{channel.topic:.80} ({what:.80})")
    more = f" and {len(every) - len(named)} more" if len(every) > len(named) else ""
    return RecordingError(
        f"{path}: an MCAP file without messages of a fleet's bus: it holds {', '.join(named)}{more}; expected a "
        "recording of `fleet record`"
    )
