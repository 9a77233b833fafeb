"""``JournalRound``: what one round of a reach server took in, in which order, and what came of it, by digests.

With the messages that it names, or with a recording of them, its rounds can be computed anew.
"""

import re
from dataclasses import dataclass, field
from hashlib import blake2b
from operator import attrgetter
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from fleet_bus import codec, keys
from fleet_bus.errors import MessageError
from fleet_bus.messages import ranges
from fleet_bus.messages.fields import Field, FieldList
from fleet_bus.messages.kinds import Array, Bytes, Number, Row, Rows, Text, Texts, Whole

SCHEMA: Final = "fleet.journal"
VERSION: Final = 1
ENCODING: Final = codec.encoding(SCHEMA, VERSION)
MAX_BYTES: Final = 2**20

#: Bytes of a digest, and of a chain.
DIGEST: Final = 8
CHAIN: Final = 16
#: Chain before the first round of a server.
BEGINNING: Final = "0" * (2 * CHAIN)
_DIGEST: Final = re.compile("[0-9a-f]{16}")
#: Samples, and tubes, that one message lists at most, and calls.
MOST_LISTED: Final = 8192
MOST_CALLS: Final = 1000

#: Bytes that end the payload of a tube: the time that it took to compute, which no two runs share.
TIMED: Final = 8

#: What a server does in a round, in the order in which it may.
CALLS: Final = ("profile", "document", "assignment", "hear", "process", "elapse", "gone", "let_go")


def digest_of(payload: bytes, encoding: str) -> bytes:
    """By which a journal names a message, beside its key and its source."""
    return blake2b(payload, digest_size=DIGEST, key=encoding.encode()[:64]).digest()


def digests(packed: bytes) -> list[bytes]:
    """Digests that follow each other, one by one."""
    return [packed[at : at + DIGEST] for at in range(0, len(packed), DIGEST)]


def tube_digest(payload: bytes) -> bytes:
    """Digest of a tube's payload but for the time that it took to compute."""
    return blake2b(memoryview(payload)[:-TIMED], digest_size=DIGEST).digest()


class Reference(NamedTuple):
    """What a journal names a message by."""

    key: str
    source: str
    digest: bytes


@dataclass(frozen=True, slots=True)
class Call:
    """Something a server did at ``now`` (s): ``subject`` is the key of the message that was taken in, or the vehicle
    that was found gone, ``source`` the session that sent it, ``digest`` (hex) that of the message, where there is one.
    """

    kind: str
    now: float
    subject: str = ""
    source: str = ""
    digest: str = ""


def _no_places() -> NDArray[np.uint16]:
    return np.zeros(0, dtype=np.uint16)


def _no_stamps() -> NDArray[np.int64]:
    return np.zeros(0, dtype=np.int64)


def _no_times() -> NDArray[np.float64]:
    return np.zeros(0)


@dataclass(frozen=True, slots=True, eq=False)
class JournalRound:
    """Round ``number`` (from 1) of a server at ``now`` (s, a clock that never goes back) and ``stamp`` (Unix ns), or
    a ``part`` of it, (which, of how many).

    ``idle`` (I,) are the times (s) of the rounds before it in which nothing came or went but time. ``calls`` is what
    it did; ``process`` took in the samples (S) of ``sample_vehicle`` (S,), places in ``vehicles``, which came from
    ``sample_session`` (S,), places in ``sessions``, at ``arrived`` (S,) (Unix ns, 0: not known), in this order. The
    tubes (T) of ``tube_vehicle`` (T,) start from the samples ``tube_epoch`` (T,), ``tube_seq`` (T,), and say ``note``.
    Digests are 8 bytes each. ``failed`` names the error that ended the round. ``totals``: samples, tubes and events so
    far. ``chain`` is that of all messages of the server up to this one: see ``link``.
    """

    server: str
    server_epoch: int
    build: str
    number: int
    now: float
    stamp: int
    part: tuple[int, int] = (1, 1)
    idle: NDArray[np.float64] = field(default_factory=_no_times)
    vehicles: tuple[str, ...] = ()
    sessions: tuple[str, ...] = ()
    calls: tuple[Call, ...] = ()
    sample_vehicle: NDArray[np.uint16] = field(default_factory=_no_places)
    sample_session: NDArray[np.uint16] = field(default_factory=_no_places)
    arrived: NDArray[np.int64] = field(default_factory=_no_stamps)
    sample_digest: bytes = b""
    tube_vehicle: NDArray[np.uint16] = field(default_factory=_no_places)
    tube_epoch: NDArray[np.int64] = field(default_factory=_no_stamps)
    tube_seq: NDArray[np.int64] = field(default_factory=_no_stamps)
    tube_digest: bytes = b""
    event_digest: bytes = b""
    note: str = ""
    failed: str = ""
    totals: tuple[int, int, int] = (0, 0, 0)
    chain: str = BEGINNING

    def encode(self) -> bytes:
        """Payload of this round (encoding ``fleet.journal.v1``); raise ``MessageError`` where ``decode`` would refuse
        it."""
        self._check()
        return codec.pack(FIELDS.pack(self), limit=MAX_BYTES)

    @classmethod
    def decode(cls, payload: bytes, encoding: str = ENCODING) -> Self:
        """Read one payload; raise ``MessageError`` with the reason if it is not a sound round."""
        codec.check_encoding(encoding, SCHEMA, VERSION)
        found = cls(**FIELDS.read(codec.unpack(payload, limit=MAX_BYTES)))
        FIELDS.check(found)
        found._check()
        return found

    @property
    def references(self) -> list[Reference]:
        """The messages that were taken in: documents, then samples, in their order."""
        documents = [
            Reference(call.subject, call.source, bytes.fromhex(call.digest)) for call in self.calls if call.digest
        ]
        places = zip(
            self.sample_vehicle.tolist(), self.sample_session.tolist(), digests(self.sample_digest), strict=True
        )
        return documents + [
            Reference(keys.state(self.vehicles[vehicle]), self.sessions[session], digest)
            for vehicle, session, digest in places
        ]

    def _check(self) -> None:
        part, parts = self.part
        if part > parts:
            raise MessageError("range", f"p is part {part} of {parts}")
        if len(self.calls) > MOST_CALLS:
            raise MessageError("shape", f"c holds {len(self.calls)} calls: at most {MOST_CALLS}")
        for call in self.calls:
            if call.digest and _DIGEST.fullmatch(call.digest) is None:
                raise MessageError("fields", f"c holds {call.digest!r:.40}: expected a digest of {2 * DIGEST} digits")
        for name in self.vehicles:
            if keys.ID_PATTERN.fullmatch(name) is None:
                raise MessageError("fields", f"v holds {name!r:.80}: expected ids of vehicles")
        for name, places, listed in (
            ("kv", self.sample_vehicle, self.vehicles),
            ("ks", self.sample_session, self.sessions),
            ("tv", self.tube_vehicle, self.vehicles),
        ):
            if len(places) and int(places.max()) >= len(listed):
                raise MessageError("range", f"{name} is {int(places.max())}: expected places among {len(listed)} names")


def link(before: str, payload: bytes) -> str:
    """The chain after a journal message: a digest of the chain ``before`` and of its payload but for its own chain,
    which ends it."""
    return blake2b(bytes.fromhex(before) + payload[: -2 * CHAIN], digest_size=CHAIN).hexdigest()


_COUNT: Final = Whole(ranges.COUNTER)
_PART: Final = Whole(ranges.PARTS)
_SAMPLE_PLACES: Final = Array("<u2", ("S",), ranges.PLACE)
_TUBE_PLACES: Final = Array("<u2", ("T",), ranges.PLACE)


def _digests(size: str) -> Bytes:
    return Bytes(DIGEST, size, MOST_LISTED)


#: What encoder, decoder, checks, JSON Schema and docs/reference/wire.md follow: I idle rounds, S samples, T tubes, E
#: events.
FIELDS: Final = FieldList(
    Field("sv", "server", Text(pattern=keys.ID_PATTERN), "", "id of the server, the same as in the key"),
    Field("se", "server_epoch", Whole(ranges.EPOCH), "ns", "when that server started"),
    Field("b", "build", Text(), "", "digest of the program and of what it computes with"),
    Field("r", "number", _COUNT, "", "number of the round, from 1; a gap means lost rounds"),
    Field("n", "now", Number(ranges.MONOTONIC), "s", "when it was, by a clock that never goes back"),
    Field("t", "stamp", Whole(ranges.TIME), "ns", "when it was, by the clock of the server"),
    Field("p", "part", Row((_PART, _PART), lambda *parts: parts, tuple), "", "which part of the round, of how many"),
    Field("i", "idle", Array("<f8", ("I",), ranges.MONOTONIC), "s", "times of the rounds before it without any input"),
    Field("v", "vehicles", Texts(ranges.LISTED), "", "vehicles that are spoken about"),
    Field("s", "sessions", Texts(ranges.LISTED), "", "sessions that are"),
    Field(
        "c", "calls",
        Rows(
            Row(
                (Text(CALLS), Number(ranges.MONOTONIC), Text(), Text(), Text()), Call,
                attrgetter("kind", "now", "subject", "source", "digest"),
            )
        ),
        "", "what was done: kind, when (s), key or vehicle, session, digest (hex)",
    ),
    Field("kv", "sample_vehicle", _SAMPLE_PLACES, "", "vehicle of each sample, its place in `v`"),
    Field("ks", "sample_session", _SAMPLE_PLACES, "", "session that sent it, its place in `s`"),
    Field("ka", "arrived", Array("<i8", ("S",), ranges.EPOCH), "ns", "when it came, 0 where that is not known"),
    Field("kd", "sample_digest", _digests("S"), "", "digest of each sample"),
    Field("tv", "tube_vehicle", _TUBE_PLACES, "", "vehicle of each tube, its place in `v`"),
    Field("ep", "tube_epoch", Array("<i8", ("T",), ranges.EPOCH), "", "epoch of the sample that it starts from"),
    Field("sq", "tube_seq", Array("<i8", ("T",), ranges.SEQ), "", "seq of that sample"),
    Field("td", "tube_digest", _digests("T"), "", "digest of each tube but for its `ct`"),
    Field("ed", "event_digest", _digests("E"), "", "digest of each event"),
    Field("no", "note", Text(), "", "note that the tubes carry because the server is behind"),
    Field("x", "failed", Text(), "", "error that ended the round"),
    Field("tt", "totals", Row((_COUNT, _COUNT, _COUNT), lambda *n: n, tuple), "", "samples, tubes, events so far"),
    Field("ch", "chain", Text(pattern=re.compile("[0-9a-f]{32}")), "", "chain of all that came and went so far"),
)  # fmt: skip
