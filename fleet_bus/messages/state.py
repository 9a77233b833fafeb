"""``StateSample``: one filtered state and the input in force from it on, all numbers in one bin."""

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

#: epoch, seq, t (ns), flags, n, m, plan steps, reserved (zero), padding to a multiple of 8
_HEADER: Final = struct.Struct("<QQqIHHHHxxxx")
_HEADER_DTYPE: Final = np.dtype(
    [("epoch", "<u8"), ("seq", "<u8"), ("t", "<i8"), ("flags", "<u4"), ("n", "<u2"), ("m", "<u2"), ("plan", "<u2"),
     ("reserved", "<u2"), ("pad", "V4")]
)  # fmt: skip


class StateFlag(IntFlag):
    """What a sample says about itself."""

    NONE = 0
    INPUT_MISSING = 1  #: no input is known from this sample on (``u`` is zero and must not be used)
    NEW_TRAJECTORY = 2  #: this sample does not follow from the one before it
    BOUND = 4  #: the sample carries its own bound of the state's error
    HISTORY = 8  #: recorded before this start of the agent: fills windows, gets no tube


#: The ranges of the header's numbers, by name; ``plan`` are the steps of a plan there.
HEADER: Final[Mapping[str, ranges.Range]] = {
    "epoch": ranges.EPOCH, "seq": ranges.SEQ, "t": ranges.TIME, "flags": ranges.FLAGS, "n": ranges.STATES,
    "m": ranges.INPUTS, "plan": ranges.PLAN, "reserved": ranges.NONE,
}  # fmt: skip
#: The ranges of the numbers after the header, in their order.
NUMBERS: Final[Mapping[str, ranges.Range]] = {
    "x": ranges.VALUE, "u": ranges.VALUE, "bound": ranges.SIZE, "plan": ranges.VALUE, "plan_tolerance": ranges.SIZE,
}  # fmt: skip


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
        n, m = len(self.x), len(self.u)
        parts: list[tuple[str, NDArray[np.float64], tuple[int, ...]]] = [("x", self.x, (n,)), ("u", self.u, (m,))]
        if self.bound is not None:
            flags |= int(StateFlag.BOUND)
            parts.append(("bound", self.bound, (n,)))
        steps = 0
        if self.plan is not None and len(self.plan):
            steps = len(self.plan)
            tolerance = np.zeros(m) if self.plan_tolerance is None else self.plan_tolerance
            parts += [("plan", self.plan, (steps, m)), ("plan_tolerance", tolerance, (m,))]
        header = (int(self.epoch), int(self.seq), int(self.t), flags, n, m, steps, 0)
        for (name, span), number in zip(HEADER.items(), header, strict=True):
            span.check(name, number)
        for name, array, shape in parts:
            if array.shape != shape:
                raise MessageError("shape", f"{name} has shape {array.shape}, expected {shape}")
            NUMBERS[name].check_array(name, array)
        numbers = codec.to_bin(np.concatenate([array.ravel() for _, array, _ in parts]))
        return codec.pack({"d": _HEADER.pack(*header) + numbers}, limit=MAX_BYTES)

    @classmethod
    def decode(cls, payload: bytes, encoding: str = ENCODING) -> Self:
        """Read one payload; raise ``MessageError`` with the reason if it is not a sound sample."""
        codec.check_encoding(encoding, SCHEMA, VERSION)
        fields = codec.unpack(payload, limit=MAX_BYTES)
        codec.check_fields(fields, {"d": bytes})
        raw: bytes = fields["d"]
        if len(raw) < _HEADER.size:
            raise MessageError("shape", f"bin of {len(raw)} bytes is shorter than its header of {_HEADER.size}")
        header = epoch, seq, t, flags, n, m, steps, _ = _HEADER.unpack_from(raw)
        has_bound = bool(flags & StateFlag.BOUND)
        counts = [n, m, n * has_bound, steps * m, m * bool(steps)]
        if len(raw) != _HEADER.size + 8 * sum(counts):
            raise MessageError("shape", f"bin of {len(raw)} bytes, header says n={n} m={m} plan={steps}")
        for (name, span), number in zip(HEADER.items(), header, strict=True):
            span.check(name, number)
        numbers = np.frombuffer(raw, dtype="<f8", offset=_HEADER.size)
        parts = np.split(numbers, np.cumsum(counts)[:-1])
        for (name, span), part in zip(NUMBERS.items(), parts, strict=True):
            span.check_array(name, part)
        x, u, bound, plan, tolerance = parts
        return cls(
            epoch, seq, t, x, u, StateFlag(flags),
            bound if has_bound else None,
            plan.reshape(steps, m) if steps else None,
            tolerance if steps else None,
        )  # fmt: skip


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
    bound: NDArray[np.float64] | None
    plan: NDArray[np.float64] | None
    plan_tolerance: NDArray[np.float64] | None


def decode_states(
    payloads: Sequence[bytes], encodings: Sequence[str]
) -> tuple[list[StateBatch], list[tuple[int, MessageError]]]:
    """Read many payloads at once: batches of equal layout, and ``(index, error)`` of every one refused.

    Payloads of equal length and header are joined and read by one ``frombuffer``; when a batch holds
    anything doubtful, its members are read one by one to find the culprit.
    """
    groups: defaultdict[tuple[str, int, bytes], list[int]] = defaultdict(list)
    for index, (payload, encoding) in enumerate(zip(payloads, encodings, strict=True)):
        # flags, n, m and plan steps stand at fixed places of the bin: bytes 24 to 40
        head = _bin_offset(payload)
        layout = payload[head + 24 : head + _HEADER.size] if head else b""
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
    _, _, _, flags, n, m, steps, _ = _HEADER.unpack_from(first, head)
    has_bound = bool(flags & StateFlag.BOUND)
    counts = [n, m, n * has_bound, steps * m, m * bool(steps)]
    if body != 8 * sum(counts):
        return None
    layout = np.dtype([("head", f"V{head}"), ("header", _HEADER_DTYPE), ("numbers", "<f8", (sum(counts),))])
    rows = np.frombuffer(b"".join(payloads), dtype=layout)
    fields, numbers = rows["header"], rows["numbers"]
    heads_equal = np.array_equal(rows["head"], np.broadcast_to(rows["head"][0], rows["head"].shape))
    _, _, bound, plan, tolerance = parts = np.split(numbers, np.cumsum(counts)[:-1], axis=1)
    declared = int.from_bytes(first[4:head], "big")
    sound = (
        heads_equal
        and declared == body + _HEADER.size
        and all(span.holds(fields[name]) for name, span in HEADER.items())
        and all(span.holds(part) for span, part in zip(NUMBERS.values(), parts, strict=True))
    )
    if not sound:
        return None
    return StateBatch(
        index, fields["epoch"], fields["seq"], fields["t"], fields["flags"], parts[0], parts[1],
        bound if has_bound else None,
        plan.reshape(len(payloads), steps, m) if steps else None,
        tolerance if steps else None,
    )  # fmt: skip


def _batch_of_one(sample: StateSample, index: int) -> StateBatch:
    def row(array: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
        return None if array is None else array[None]

    return StateBatch(
        np.array([index]),
        np.array([sample.epoch], dtype=np.uint64),
        np.array([sample.seq], dtype=np.uint64),
        np.array([sample.t], dtype=np.int64),
        np.array([int(sample.flags)], dtype=np.uint32),
        sample.x[None],
        sample.u[None],
        row(sample.bound),
        row(sample.plan),
        row(sample.plan_tolerance),
    )
