"""What a recording has of servers and of what these took in, found by what a journal names it by."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

import msgpack

from fleet_bus import keys
from fleet_bus.errors import MessageError
from fleet_bus.messages import CheckpointPart, JournalRound, ServiceStatus
from fleet_bus.messages import tube as tube_message
from fleet_bus.messages.journal import Reference, digest_of, tube_digest
from fleet_bus.pubsub import Received

#: Bytes in which vehicle, epoch and seq of a tube stand.
_HEAD: Final = 256

Name = tuple[str, int, int]


@dataclass(slots=True)
class ServerRecord:
    """What was recorded of one server since one start of it: payload and contents of the messages of its journal by
    round and part, checkpoints by round and part, and chains that its status told, by round."""

    rounds: dict[int, dict[int, tuple[bytes, JournalRound]]] = field(default_factory=lambda: defaultdict(dict))
    checkpoints: dict[int, dict[int, CheckpointPart]] = field(default_factory=lambda: defaultdict(dict))
    told: dict[int, str] = field(default_factory=dict)

    def checkpoint(self, number: int) -> list[CheckpointPart]:
        """All parts of the checkpoint after a round, in order; none where one is missing."""
        parts = self.checkpoints.get(number, {})
        complete = bool(parts) and all(len(parts) == part.part[1] for part in parts.values())
        return [parts[place] for place in sorted(parts)] if complete else []


class Recorded:
    """A recording, in any order, taken in once."""

    def __init__(self, messages: Iterable[Received]) -> None:
        self.inputs: dict[Reference, Received] = {}
        self.servers: dict[tuple[str, int], ServerRecord] = defaultdict(ServerRecord)
        #: Tubes by digest.
        self.tubes: dict[bytes, Name] = {}
        self.unreadable: dict[str, int] = defaultdict(int)
        for message in messages:
            self._take(message)

    def _take(self, message: Received) -> None:
        chunks = message.key.split("/")
        try:
            if chunks[0] == "spec" or (chunks[0] == "fleet" and chunks[-1] in ("state", "profile")):
                digest = digest_of(message.payload, message.encoding)
                # What came twice is the same message.
                self.inputs.setdefault(Reference(message.key, message.source, digest), message)
            elif chunks[0] == "reach" and chunks[-1] == "tube":
                self.tubes[tube_digest(message.payload)] = _name_of(message)
            elif chunks[:2] == ["svc", "reach"]:
                self._take_of_server(message, chunks[-1])
        except MessageError as error:
            self.unreadable[f"{message.key}: {error}"] += 1

    def _take_of_server(self, message: Received, what: str) -> None:
        if what == "journal":
            part = JournalRound.decode(message.payload, message.encoding)
            _check_key(message.key, keys.journal(part.server))
            record = self.servers[part.server, part.server_epoch]
            record.rounds[part.number][part.part[0]] = message.payload, part
        elif what == "checkpoint":
            piece = CheckpointPart.decode(message.payload, message.encoding)
            _check_key(message.key, keys.checkpoint(piece.server))
            self.servers[piece.server, piece.server_epoch].checkpoints[piece.number][piece.part[0]] = piece
        elif what == "status":
            status = ServiceStatus.decode(message.payload, message.encoding)
            if "value" in status.chain and (number := status.chain.get("round", "")).isdecimal():
                self.servers[status.instance, status.started].told[int(number)] = status.chain["value"]

    def taken(self, like: Reference) -> list[Reference]:
        """What servers took in of the key and source of a message, in their order."""
        chosen = [
            reference
            for _, record in sorted(self.servers.items(), key=lambda item: item[0][::-1])
            for _, parts in sorted(record.rounds.items())
            for _, (_, part) in sorted(parts.items())
            for reference in part.references
            if reference[:2] == like[:2]
        ]
        return list(dict.fromkeys(chosen))


def _check_key(found: str, expected: str) -> None:
    if found != expected:
        raise MessageError("key", f"a message of {expected} was put on {found:.120}")


def _name_of(message: Received) -> Name:
    """Vehicle, epoch and seq of a tube, without reading all of it."""
    if message.encoding != tube_message.ENCODING:
        raise MessageError("encoding", f"{message.encoding!r:.80} is no tube")
    unpacker = msgpack.Unpacker(raw=False, max_str_len=_HEAD)
    unpacker.feed(message.payload[:_HEAD])
    try:
        unpacker.read_map_header()
        found = {unpacker.unpack(): unpacker.unpack() for _ in range(3)}
        return str(found["v"]), int(found["e"]), int(found["s"])
    except (ValueError, TypeError, KeyError, msgpack.exceptions.UnpackException) as error:
        raise MessageError("malformed", f"not a tube: {type(error).__name__}") from None
