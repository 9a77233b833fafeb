"""A stretch of a recording, in a file of its own."""

import itertools
import re
import secrets
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from mcap.records import Channel, Message, Schema

from fleet_bus import codec
from fleet_bus.errors import FleetError, MessageError, RecordingError, UsageError
from fleet_bus.messages import Event, EventKind
from fleet_bus.pubsub import Received
from fleet_recorder import layout
from fleet_recorder.layout import Recorded, SceneMessage
from fleet_recorder.reader import Reading
from fleet_recorder.recording_file import CHUNK_BYTES, RecordingFile

#: Numbers from here on are instants in nanoseconds, smaller ones seconds from the beginning: 12 days after 1970.
_NANOSECONDS: Final = 10**15
_CHECKPOINT: Final = "fleet.checkpoint"
_CHECKPOINT_BYTES: Final = 4 << 20
#: By how much (ns) what a server took in after a checkpoint may have come to the recorder before the checkpoint did: it
#: is large, and the server works on none while it writes it.
_LATE_NS: Final = 5 * 10**9


@dataclass(frozen=True, slots=True)
class Cut:
    """What was cut out: messages of the stretch and those carried over from before it, of scene, and the instant (Unix
    ns) around which it lies, from ``start_ns`` to ``end_ns``."""

    path: Path
    at_ns: int
    start_ns: int
    end_ns: int
    messages: int
    carried: int
    scene: int
    checkpoint: bool


def find_instant(paths: Sequence[Path], at: str) -> int:
    """The instant (Unix ns) that a text names: an ISO time, nanoseconds, or seconds from the beginning of a recording.

    An ISO time without an offset is in UTC. Raises ``UsageError`` for another text.
    """
    text = at.strip()
    try:
        number = float(text)
    except ValueError:
        return _iso(text)
    if re.fullmatch(r"\d+", text) and int(text) >= _NANOSECONDS:
        return int(text)
    if not 0 <= number < _NANOSECONDS / 1e9:
        raise UsageError(f"--at {at!r:.60}: seconds from the beginning, nanoseconds since 1970, or an ISO time")
    first = next(iter(Reading(paths, warn=bool)))
    return first.logged_ns + round(number * 1e9)


def _iso(text: str) -> int:
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        raise UsageError(
            f"--at {text!r:.60}: write an ISO time such as 2026-12-01T11:20:05.5Z, nanoseconds since 1970, or seconds "
            "from the beginning of the recording"
        ) from None
    aware = found if found.tzinfo is not None else found.replace(tzinfo=UTC)
    since = aware - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * 86_400 + since.seconds) * 10**9 + since.microseconds * 1000


def find_event(paths: Sequence[Path], which: str) -> tuple[int, Event]:
    """When (Unix ns) an event was recorded, and the event: the first of a kind, or the one of a number, counted from 1.

    Raises ``UsageError`` for a kind that there is none of, ``RecordingError`` for one that is not in the recording.
    """
    number = int(which) if which.isdecimal() else None
    if number is None and which not in list(EventKind):
        raise UsageError(f"--event {which!r:.60}: give a number, or one of {', '.join(EventKind)}")
    seen: dict[str, int] = {}
    for recorded in Reading(paths, warn=bool):
        if layout.schema_name(recorded.received.encoding) != "fleet.event.v1":
            continue
        try:
            event = Event.decode(recorded.received.payload, recorded.received.encoding)
        except MessageError:
            continue
        seen[event.kind] = seen.get(event.kind, 0) + 1
        if event.kind == which or sum(seen.values()) == number:
            return recorded.logged_ns, event
    found = ", ".join(f"{count} {kind}" for kind, count in seen.items()) or "none"
    raise RecordingError(f"--event {which}: no such event in the recording; there are: {found}")


class _InForce:
    """The newest message of each key that is in force until the next, and the newest checkpoint, before a stretch."""

    def __init__(self) -> None:
        self._newest: dict[str, Recorded] = {}
        #: By key: which checkpoint, its parts, and how many it has.
        self._checkpoints: dict[str, tuple[object, list[Recorded], int]] = {}
        self._whole: dict[str, list[Recorded]] = {}

    def see(self, recorded: Recorded) -> None:
        received = recorded.received
        if layout.stays(received):
            self._newest.pop(received.key, None)
            if received.encoding != layout.TOKEN or _alive(received):
                self._newest[received.key] = recorded
        elif layout.schema_name(received.encoding).rpartition(".v")[0] == _CHECKPOINT:
            self._see_checkpoint(recorded)

    def _see_checkpoint(self, recorded: Recorded) -> None:
        key = recorded.received.key
        try:
            fields = codec.unpack(recorded.received.payload, limit=_CHECKPOINT_BYTES)
            which, (part, count) = (fields["se"], fields["r"]), fields["p"]
        except (MessageError, KeyError, TypeError, ValueError):
            return
        known = self._checkpoints.get(key)
        if known is None or known[0] != which or part == 1:
            known = which, [], count
        known[1].append(recorded)
        self._checkpoints[key] = known
        if len(known[1]) == count:
            # One that is on its way when the stretch begins is of no use; the one before it is.
            self._whole[key] = known[1]

    @property
    def messages(self) -> Iterator[Recorded]:
        return itertools.chain(self._newest.values(), *self._whole.values())

    @property
    def has_checkpoint(self) -> bool:
        return bool(self._whole)

    @property
    def checkpoint_ns(self) -> int | None:
        """When the newest whole checkpoint came; of several servers, the first of their newest."""
        return min((parts[0].logged_ns for parts in self._whole.values()), default=None)


def cut(
    paths: Sequence[Path],
    out: Path,
    at_ns: int,
    *,
    before: float = 30.0,
    after: float = 30.0,
    from_checkpoint: bool = False,
    warn: Callable[[str], object] | None = None,
) -> Cut:
    """Write what was recorded from ``before`` seconds before an instant (Unix ns) until ``after`` seconds after it.

    The file stands alone: it begins with the profiles, documents, assignments, statuses and tokens that were in force,
    and the newest checkpoint of each server. With ``from_checkpoint`` the stretch is longer: it begins some seconds
    before the newest checkpoint came, so that all that a server took in since then is in it.

    Raises ``RecordingError`` where nothing was recorded in the stretch, or it has no checkpoint before it,
    ``UsageError`` if ``out`` is there already, ``FleetError`` if it cannot be written; then no file is left.
    """
    start, end = at_ns - round(before * 1e9), at_ns + round(after * 1e9)
    if from_checkpoint:
        start = _checkpoint_before(paths, start) - _LATE_NS
    draft = out.with_name(f".{secrets.token_hex(8)}.new")
    details = {"cut_from": ", ".join(path.name for path in paths)[:1000], "at_ns": str(at_ns)}
    if out.exists():
        raise UsageError(f"{out} is there already: name another file with -o")
    try:
        writing = RecordingFile(draft, details)
        try:
            done = _Copy(writing, start, end, from_checkpoint).run(paths, warn, at_ns, out)
            writing.finish()
            draft.rename(out)
        finally:
            writing.close()
    except OSError as error:
        raise FleetError(f"{out}: cannot be written: {error.strerror or error}") from None
    finally:
        draft.unlink(missing_ok=True)
    return done


def _checkpoint_before(paths: Sequence[Path], start: int) -> int:
    in_force = _InForce()
    for recorded in Reading(paths, warn=bool):
        if recorded.logged_ns < start:
            in_force.see(recorded)
    found = in_force.checkpoint_ns
    if found is None:
        raise RecordingError(
            "no checkpoint of a server was recorded before the stretch: leave out --from-checkpoint, or begin later"
        )
    return found


class _Copy:
    """Copies a stretch into a file; ``has_checkpoint``: there is one in it, and none has to be carried over."""

    def __init__(self, writing: RecordingFile, start: int, end: int, has_checkpoint: bool) -> None:
        self._writing = writing
        self._start = start
        self._end = end
        self._has_checkpoint = has_checkpoint
        self._in_force = _InForce()
        self._messages = self._carried = self._scene = 0

    def run(self, paths: Sequence[Path], warn: Callable[[str], object] | None, at_ns: int, out: Path) -> Cut:
        first = last = None
        for recorded in Reading(paths, warn=warn, scene=self._draw):
            logged = recorded.logged_ns
            first, last = logged if first is None else min(first, logged), max(last or 0, logged)
            inside = self._start <= logged <= self._end
            if not self._messages and (recorded.carried or not inside):
                # What lies out of order after the stretch is not in force before it.
                if logged <= self._end:
                    self._in_force.see(recorded)
            elif inside:
                if not self._messages:
                    self._carry(logged)
                self._add(recorded)
                self._messages += 1
        if not self._messages:
            raise RecordingError(
                f"nothing was recorded from {_instant(self._start)} to {_instant(self._end)}: the recording goes from "
                f"{_instant(first or 0)} to {_instant(last or 0)}"
            )
        return Cut(
            out, at_ns, self._start, self._end, self._messages, self._carried, self._scene,
            self._in_force.has_checkpoint or self._has_checkpoint,
        )  # fmt: skip

    def _carry(self, logged_ns: int) -> None:
        for recorded in self._in_force.messages:
            if self._has_checkpoint and not layout.stays(recorded.received):
                continue
            self._add(recorded._replace(logged_ns=logged_ns, carried=True))
            self._carried += 1

    def _add(self, recorded: Recorded) -> None:
        if self._writing.full:
            raise UsageError("the stretch has more sources and keys than one file can hold: cut a shorter one")
        self._writing.add(recorded)
        if self._writing.waiting > CHUNK_BYTES:
            self._writing.write_out()

    def _draw(self, schema: Schema | None, channel: Channel, message: Message) -> None:
        if self._messages and message.log_time <= self._end:
            name, encoding, data = ("", "", b"") if schema is None else (schema.name, schema.encoding, schema.data)
            self._writing.add_scene(
                SceneMessage(
                    channel.topic, name, encoding, data, channel.message_encoding, message.data, message.log_time
                )
            )
            self._scene += 1


def _alive(received: Received) -> bool:
    try:
        return layout.is_alive(received)
    except MessageError:
        return False


def _instant(time_ns: int) -> str:
    """An instant in whole milliseconds, as ``find_instant`` reads it."""
    seconds, rest = divmod(max(0, time_ns), 10**9)
    try:
        return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{rest // 10**6:03d}Z"
    except (OverflowError, OSError, ValueError):
        return f"{time_ns} ns"
