"""``CheckpointPart``: a part of the state of a reach server between two rounds."""

import re
from dataclasses import dataclass
from typing import Final, Self

from fleet_bus import codec, keys
from fleet_bus.errors import MessageError
from fleet_bus.messages import ranges
from fleet_bus.messages.fields import Field, FieldList
from fleet_bus.messages.kinds import Bytes, Row, Text, Whole

SCHEMA: Final = "fleet.checkpoint"
VERSION: Final = 1
ENCODING: Final = codec.encoding(SCHEMA, VERSION)
#: Bytes of the state in one message, and of the message.
PART_BYTES: Final = 2**20
MAX_BYTES: Final = PART_BYTES + 4096

_HASH: Final = re.compile("[0-9a-f]{32}")


@dataclass(frozen=True, slots=True)
class CheckpointPart:
    """A ``part``, (which, of how many), of the state of a server after the round ``number``, at which its journal has
    the ``chain``. ``digest`` (hex) is that of the whole state, whose bytes follow each other in the parts' ``data``."""

    server: str
    server_epoch: int
    build: str
    number: int
    chain: str
    digest: str
    part: tuple[int, int]
    data: bytes

    def encode(self) -> bytes:
        """Payload of this part (encoding ``fleet.checkpoint.v1``); raise ``MessageError`` where ``decode`` would refuse
        it."""
        self._check()
        return codec.pack(FIELDS.pack(self), limit=MAX_BYTES)

    @classmethod
    def decode(cls, payload: bytes, encoding: str = ENCODING) -> Self:
        """Read one payload; raise ``MessageError`` with the reason if it is not a sound part."""
        codec.check_encoding(encoding, SCHEMA, VERSION)
        found = cls(**FIELDS.read(codec.unpack(payload, limit=MAX_BYTES)))
        FIELDS.check(found)
        found._check()
        return found

    def _check(self) -> None:
        part, parts = self.part
        if part > parts:
            raise MessageError("range", f"p is part {part} of {parts}")


_PART: Final = Whole(ranges.PARTS)

#: What encoder, decoder, checks, JSON Schema and docs/reference/wire.md follow: B bytes.
FIELDS: Final = FieldList(
    Field("sv", "server", Text(pattern=keys.ID_PATTERN), "", "id of the server, the same as in the key"),
    Field("se", "server_epoch", Whole(ranges.EPOCH), "ns", "when that server started"),
    Field("b", "build", Text(), "", "digest of the program and of what it computes with"),
    Field("r", "number", Whole(ranges.COUNTER), "", "round after which the state was this"),
    Field("ch", "chain", Text(pattern=_HASH), "", "chain of its journal then"),
    Field("h", "digest", Text(pattern=_HASH), "", "BLAKE2b of the whole state, 16 bytes, hex"),
    Field("p", "part", Row((_PART, _PART), lambda *parts: parts, tuple), "", "which part, of how many"),
    Field("d", "data", Bytes(1, "B", PART_BYTES), "", "bytes of the state; only the server that wrote them reads them"),
)  # fmt: skip
