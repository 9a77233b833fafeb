"""``StateSample``: one filtered state and the input in force from it on, all numbers in one bin."""

import math
import struct
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntFlag
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from fleet_bus import codec
from fleet_bus.errors import MessageError
from fleet_bus.messages import ranges

SCHEMA: Final = "fleet.state"
VERSION: Final = 1
ENCODING: Final = codec.encoding(SCHEMA, VERSION)
MAX_BYTES: Final = 4096


class StateFlag(IntFlag):
    """What a sample says about itself."""

    NONE = 0
    INPUT_MISSING = 1  #: no input is known from this sample on (``u`` is zero and must not be used)
    NEW_TRAJECTORY = 2  #: this sample does not follow from the one before it
    BOUND = 4  #: the sample carries its own bound of the state's error
    HISTORY = 8  #: recorded before this start of the agent: fills windows, gets no tube


@dataclass(frozen=True, slots=True)
class HeaderField:
    """A number of the header: its type (``u`` unsigned, ``i`` signed, bytes), its range and its meaning."""

    name: str
    type: str
    span: ranges.Range
    meaning: str

    @property
    def bytes(self) -> int:
        """How many bytes it takes."""
        return int(self.type[1:])


@dataclass(frozen=True, slots=True)
class BodyField:
    """An array of f8 after the header: the numbers of the header that make its shape, its range, and its meaning.

    It is there where the ``flag`` is set and no number of its shape, nor that called ``with_``, is zero; always if
    neither is given.
    """

    name: str
    shape: tuple[str, ...]
    span: ranges.Range
    meaning: str
    flag: StateFlag = StateFlag.NONE
    with_: str = ""

    @property
    def present(self) -> str:
        """When it is there, in words."""
        return f"flags & {int(self.flag)}" if self.flag else f"{self.with_} > 0" if self.with_ else "always"

    def there(self, header: Mapping[str, int]) -> bool:
        """Whether a header says that it is there."""
        if self.flag:
            return bool(header["flags"] & self.flag)
        return not self.with_ or header[self.with_] > 0

    def count(self, header: Mapping[str, int]) -> int:
        """How many numbers it has by a header."""
        return math.prod(header[size] for size in self.shape) if self.there(header) else 0


#: What encoder, decoders, checks, JSON Schema and docs/reference/wire.md follow. All numbers are little-endian.
HEADER: Final = (
    HeaderField("epoch", "u8", ranges.EPOCH, "id of this start of the agent; a later start has a greater one"),
    HeaderField("seq", "u8", ranges.SEQ, "counts the samples of one epoch from 0; a gap means lost samples"),
    HeaderField("t", "i8", ranges.TIME, "sample time, ns since the Unix epoch"),
    HeaderField(
        "flags", "u4", ranges.FLAGS, "sum of 1 input missing, 2 new trajectory, 4 carries its own bound, 8 history"
    ),
    HeaderField("n", "u2", ranges.STATES, "number of states"),
    HeaderField("m", "u2", ranges.INPUTS, "number of inputs"),
    HeaderField("plan", "u2", ranges.PLAN, "number of planned inputs after u, 0 for no plan"),
    HeaderField("reserved", "u2", ranges.NONE, "zero"),
)
#: Bytes after the header's numbers that are written as zero and ignored by readers: what follows begins at a multiple
#: of 8.
PADDING: Final = -sum(field.bytes for field in HEADER) % 8
BODY: Final = (
    BodyField("x", ("n",), ranges.VALUE, "filtered state, in the order and units of the profile"),
    BodyField("u", ("m",), ranges.VALUE, "input in force from t on; zeros if the flags say that it is missing"),
    BodyField("bound", ("n",), ranges.SIZE, "half-widths of the error of x, not negative", flag=StateFlag.BOUND),
    BodyField("plan", ("plan", "m"), ranges.VALUE, "inputs that will follow u, one row per sample time", with_="plan"),
    BodyField(
        "plan_tolerance", ("m",), ranges.SIZE, "half-widths around every row of the plan, not negative", with_="plan"
    ),
)

_CODES: Final = {"u8": "Q", "i8": "q", "u4": "I", "u2": "H"}
_HEADER: Final = struct.Struct(f"<{''.join(_CODES[field.type] for field in HEADER)}{PADDING}x")
_HEADER_DTYPE: Final = np.dtype([*((field.name, f"<{field.type}") for field in HEADER), ("padding", f"V{PADDING}")])
_NAMES: Final = tuple(field.name for field in HEADER)
#: Where the part of the header begins that is equal in samples of one layout.
_LAYOUT: Final = sum(field.bytes for field in HEADER[:3])


def _parts(numbers: NDArray[np.float64], header: Mapping[str, int]) -> dict[str, NDArray[np.float64]]:
    """Numbers (..., k) after a header as (..., *shape) by name, of the fields that are there.

    Raises ``MessageError`` (not_finite, range).
    """
    parts = {}
    start = 0
    for field in BODY:
        if not field.there(header):
            continue
        stop = start + field.count(header)
        part = numbers[..., start:stop]
        field.span.check_array(field.name, part)
        parts[field.name] = part.reshape(numbers.shape[:-1] + tuple(header[size] for size in field.shape))
        start = stop
    return parts


@dataclass(frozen=True, slots=True, eq=False)
class StateSample:
    """State ``x`` (n,) at time ``t`` and input ``u`` (m,) in force from ``t`` on.

    Attributes:
        epoch: id of this start of the agent; ``(epoch, seq)`` names the sample.
        seq: counts samples of one epoch from 0; a gap means lost samples.
        t: sample time, nanoseconds since the Unix epoch.
        x: filtered state, units of the profile.
        u: input in force from ``t`` on, units of the profile.
        flags: see ``StateFlag``.
        bound: half-widths (n,) of the error of ``x``, or None if the profile's bound holds.
        plan: inputs (steps, m) the vehicle intends after ``u``, or None (no steps are sent as none).
        plan_tolerance: half-widths (m,) around the plan.
    """

    epoch: int
    seq: int
    t: int
    x: NDArray[np.float64]
    u: NDArray[np.float64]
    flags: StateFlag = StateFlag.NONE
    bound: NDArray[np.float64] | None = None
    plan: NDArray[np.float64] | None = None
    plan_tolerance: NDArray[np.float64] | None = None

    def encode(self) -> bytes:
        """Payload of this sample (encoding ``fleet.state.v1``); raise ``MessageError`` where ``decode`` would refuse
        it."""
        flags = int(self.flags) & ~int(StateFlag.BOUND)
        if self.bound is not None:
            flags |= int(StateFlag.BOUND)
        header = {
            "epoch": int(self.epoch), "seq": int(self.seq), "t": int(self.t), "flags": flags, "n": len(self.x),
            "m": len(self.u), "plan": 0 if self.plan is None else len(self.plan), "reserved": 0,
        }  # fmt: skip
        for field in HEADER:
            field.span.check(field.name, header[field.name])
        numbers = []
        for part in BODY:
            if not part.there(header):
                continue
            shape = tuple(header[size] for size in part.shape)
            given: NDArray[np.float64] | None = getattr(self, part.name)
            array = np.zeros(shape) if given is None else given
            if array.shape != shape:
                raise MessageError("shape", f"{part.name} has shape {array.shape}, expected {shape}")
            part.span.check_array(part.name, array)
            numbers.append(array.ravel())
        packed = _HEADER.pack(*header.values()) + codec.to_bin(np.concatenate(numbers))
        return codec.pack({"d": packed}, limit=MAX_BYTES)

    @classmethod
    def decode(cls, payload: bytes, encoding: str = ENCODING) -> Self:
        """Read one payload; raise ``MessageError`` with the reason if it is not a sound sample."""
        codec.check_encoding(encoding, SCHEMA, VERSION)
        fields = codec.unpack(payload, limit=MAX_BYTES)
        codec.check_fields(fields, {"d": bytes})
        raw: bytes = fields["d"]
        if len(raw) < _HEADER.size:
            raise MessageError("shape", f"bin of {len(raw)} bytes is shorter than its header of {_HEADER.size}")
        header = _header(raw, 0)
        if len(raw) != _HEADER.size + 8 * (count := sum(field.count(header) for field in BODY)):
            sizes = " ".join(f"{name}={header[name]}" for name in ("n", "m", "plan"))
            raise MessageError("shape", f"bin of {len(raw)} bytes, header says {sizes}: {_HEADER.size + 8 * count}")
        for field in HEADER:
            field.span.check(field.name, header[field.name])
        numbers = np.frombuffer(raw, dtype="<f8", offset=_HEADER.size)
        flags = StateFlag(header["flags"])
        return cls(header["epoch"], header["seq"], header["t"], flags=flags, **_parts(numbers, header))


def _header(raw: bytes, offset: int) -> dict[str, int]:
    """The numbers of a header by name."""
    return dict(zip(_NAMES, _HEADER.unpack_from(raw, offset), strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class StateBatch:
    """Samples of equal layout as arrays: ``index`` (B,) says which of the payloads given each row is.

    ``epoch``, ``seq``, ``t`` (ns) and ``flags`` are (B,); ``x`` (B, n) and ``u`` (B, m) in the units of the profile;
    ``bound`` (B, n), ``plan`` (B, steps, m) and ``plan_tolerance`` (B, m) are None where no sample carries one.
    """

    index: NDArray[np.intp]
    epoch: NDArray[np.uint64]
    seq: NDArray[np.uint64]
    t: NDArray[np.int64]
    flags: NDArray[np.uint32]
    x: NDArray[np.float64]
    u: NDArray[np.float64]
    bound: NDArray[np.float64] | None = None
    plan: NDArray[np.float64] | None = None
    plan_tolerance: NDArray[np.float64] | None = None


def decode_states(
    payloads: Sequence[bytes], encodings: Sequence[str]
) -> tuple[list[StateBatch], list[tuple[int, MessageError]]]:
    """Read many payloads at once: batches of equal layout, and ``(index, error)`` of every one refused.

    Payloads of equal length and header are joined and read by one ``frombuffer``; when a batch holds
    anything doubtful, its members are read one by one to find the culprit.
    """
    groups: defaultdict[tuple[str, int, bytes], list[int]] = defaultdict(list)
    for index, (payload, encoding) in enumerate(zip(payloads, encodings, strict=True)):
        # what tells the layout stands at a fixed place of the bin
        head = _bin_offset(payload)
        layout = payload[head + _LAYOUT : head + _HEADER.size] if head else b""
        groups[encoding, len(payload), layout].append(index)
    batches: list[StateBatch] = []
    refused: list[tuple[int, MessageError]] = []
    for (encoding, _, _), members in groups.items():
        batch = _decode_equal([payloads[i] for i in members], encoding, np.array(members))
        if batch is not None:
            batches.append(batch)
            continue
        for index in members:
            try:
                batches.append(_batch_of_one(StateSample.decode(payloads[index], encoding), index))
            except MessageError as error:
                refused.append((index, error))
    return batches, refused


def _bin_offset(payload: bytes) -> int:
    """Offset of the bin's first byte if the payload starts as ``encode`` writes it, else 0."""
    if payload[:3] != b"\x81\xa1d" or len(payload) < 4:
        return 0
    return {0xC4: 5, 0xC5: 6}.get(payload[3], 0)


def _decode_equal(payloads: list[bytes], encoding: str, index: NDArray[np.intp]) -> StateBatch | None:
    """Batch of payloads of equal length and layout, or None if anything about them is doubtful."""
    first = payloads[0]
    head = _bin_offset(first)
    if encoding != ENCODING or not head or not head + _HEADER.size <= len(first) <= MAX_BYTES:
        return None
    body = len(first) - head - _HEADER.size
    header = _header(first, head)
    count = sum(field.count(header) for field in BODY)
    if body != 8 * count:
        return None
    layout = np.dtype([("head", f"V{head}"), ("header", _HEADER_DTYPE), ("numbers", "<f8", (count,))])
    rows = np.frombuffer(b"".join(payloads), dtype=layout)
    fields = rows["header"]
    heads_equal = np.array_equal(rows["head"], np.broadcast_to(rows["head"][0], rows["head"].shape))
    declared = int.from_bytes(first[4:head], "big")
    sound = (
        heads_equal
        and declared == body + _HEADER.size
        and all(field.span.holds(fields[field.name]) for field in HEADER)
    )
    if not sound:
        return None
    try:
        parts = _parts(rows["numbers"], header)
    except MessageError:
        return None
    return StateBatch(index, fields["epoch"], fields["seq"], fields["t"], fields["flags"], **parts)


def _batch_of_one(sample: StateSample, index: int) -> StateBatch:
    given = {field.name: getattr(sample, field.name) for field in BODY}
    return StateBatch(
        np.array([index]),
        np.array([sample.epoch], dtype=np.uint64),
        np.array([sample.seq], dtype=np.uint64),
        np.array([sample.t], dtype=np.int64),
        np.array([int(sample.flags)], dtype=np.uint32),
        **{name: array[None] for name, array in given.items() if array is not None},
    )
