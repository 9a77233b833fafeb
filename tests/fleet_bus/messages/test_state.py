"""States: byte for byte, one by one and many at once."""

import struct
from collections.abc import Sequence

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleet_bus.errors import MessageError
from fleet_bus.messages import StateBatch, StateFlag, StateSample, decode_states, ranges
from fleet_bus.messages.state import ENCODING, MAX_BYTES
from tests.examples import examples
from tests.fleet_bus.messages.examples import T0, a_sample, refusal, samples

FIELDS = ("epoch", "seq", "t", "x", "u", "flags", "bound", "plan", "plan_tolerance")


def same(a: StateSample, b: StateSample) -> bool:
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in FIELDS)


def payload(header: Sequence[int], numbers: Sequence[float], tail: bytes = b"") -> bytes:
    """A payload written by hand: epoch, seq, t, flags, n, m, plan, reserved; then the numbers."""
    raw = struct.pack("<QQqIHHHH4x", *header) + struct.pack(f"<{len(numbers)}d", *numbers) + tail
    packed: bytes = msgpack.packb({"d": raw})
    return packed


@given(samples())
def test_a_sample_survives_the_wire(sample: StateSample) -> None:
    assert same(StateSample.decode(sample.encode()), sample)


def test_the_bytes_are_what_the_reference_says() -> None:
    sample = a_sample(
        x=np.array([1.0, 2.0]), u=np.array([0.5]), flags=StateFlag.NEW_TRAJECTORY, bound=np.array([0.1, 0.2]),
        plan=np.array([[0.6], [0.7]]), plan_tolerance=np.array([0.01]),
    )  # fmt: skip
    expected = payload((3, 7, T0, 2 | 4, 2, 1, 2, 0), [1.0, 2.0, 0.5, 0.1, 0.2, 0.6, 0.7, 0.01])
    assert sample.encode() == expected
    assert expected[:5] == b"\x81\xa1d\xc4" + bytes([40 + 64])


def test_a_plan_without_tolerance_has_tolerance_zero() -> None:
    found = StateSample.decode(a_sample(plan=np.ones((3, 2))).encode())
    assert found.plan_tolerance is not None
    assert np.array_equal(found.plan_tolerance, np.zeros(2))


def test_a_plan_of_no_steps_is_no_plan() -> None:
    assert StateSample.decode(a_sample(plan=np.zeros((0, 2))).encode()).plan is None


def test_decoded_arrays_are_read_only() -> None:
    found = StateSample.decode(a_sample().encode())
    with pytest.raises(ValueError, match="read-only"):
        found.x[0] = 1.0


GOOD = (1, 2, T0, 0, 2, 1, 0, 0)


def changed(**fields: int) -> tuple[int, ...]:
    names = ("epoch", "seq", "t", "flags", "n", "m", "plan", "reserved")
    return tuple(fields.get(name, value) for name, value in zip(names, GOOD, strict=True))


NAN, INF = float("nan"), float("inf")
REFUSED = {
    "time zero": (payload(changed(t=0), [0, 0, 0]), "range"),
    "time before 1970": (payload(changed(t=-1), [0, 0, 0]), "range"),
    "time after 2199": (payload(changed(t=ranges.LATEST + 1), [0, 0, 0]), "range"),
    "time near the end of 64 bits": (payload(changed(t=2**63 - 1), [0, 0, 0]), "range"),
    "epoch beyond all times": (payload(changed(epoch=2**64 - 1), [0, 0, 0]), "range"),
    "seq that no agent reaches": (payload(changed(seq=2**53), [0, 0, 0]), "range"),
    "state beyond all measurements": (payload(GOOD, [0, -1.1e30, 0]), "range"),
    "input beyond all measurements": (payload(GOOD, [0, 0, 1.1e30]), "range"),
    "bound beyond all measurements": (payload(changed(flags=4), [0, 0, 0, 1.1e30, 0]), "range"),
    "plan beyond all measurements": (payload(changed(plan=1), [0, 0, 0, 1.1e30, 0]), "range"),
    "tolerance beyond all measurements": (payload(changed(plan=1), [0, 0, 0, 0, 1.1e30]), "range"),
    "no state": (payload(changed(n=0), [0]), "range"),
    "too many states": (payload(changed(n=33), [0] * 34), "range"),
    "too many inputs": (payload(changed(m=17), [0] * 19), "range"),
    "a plan of nothing, longer than any": (payload(changed(m=0, plan=65535), [0, 0]), "range"),
    "unknown flag": (payload(changed(flags=16), [0, 0, 0]), "range"),
    "reserved in use": (payload(changed(reserved=1), [0, 0, 0]), "range"),
    "too few numbers": (payload(GOOD, [0, 0]), "shape"),
    "too many numbers": (payload(GOOD, [0, 0, 0, 0]), "shape"),
    "half a number": (payload(GOOD, [0, 0, 0], b"\0\0\0\0"), "shape"),
    "more states than numbers": (payload(changed(n=3), [0, 0, 0]), "shape"),
    "bound announced, not there": (payload(changed(flags=4), [0, 0, 0]), "shape"),
    "plan announced, not there": (payload(changed(plan=2), [0, 0, 0]), "shape"),
    "as many states as there can be": (payload(changed(n=65535, m=65535, plan=65535), [0, 0, 0]), "shape"),
    "NaN state": (payload(GOOD, [NAN, 0, 0]), "not_finite"),
    "infinite input": (payload(GOOD, [0, 0, INF]), "not_finite"),
    "infinite plan": (payload(changed(plan=1), [0, 0, 0, -INF, 0]), "not_finite"),
    "negative bound": (payload(changed(flags=4), [0, 0, 0, 0.1, -0.1]), "range"),
    "NaN bound": (payload(changed(flags=4), [0, 0, 0, 0.1, NAN]), "not_finite"),
    "negative tolerance": (payload(changed(plan=1), [0, 0, 0, 0, -1.0]), "range"),
    "no header": (msgpack.packb({"d": b"\0" * 39}), "shape"),
    "empty bin": (msgpack.packb({"d": b""}), "shape"),
    "text for bin": (msgpack.packb({"d": "text"}), "fields"),
    "list for bin": (msgpack.packb({"d": [1.0]}), "fields"),
    "no bin": (msgpack.packb({}), "fields"),
    "another key": (msgpack.packb({"e": b""}), "fields"),
    "one key more": (msgpack.packb({"d": b"", "e": 1}), "fields"),
    "not a map": (msgpack.packb([1]), "malformed"),
    "nothing": (b"", "malformed"),
    "too large": (payload((1, 2, T0, 0, 600, 0, 0, 0), [0.0] * 600), "too_large"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_each_refusal_has_its_reason_one_by_one_and_at_once(what: str) -> None:
    raw, reason = REFUSED[what]
    assert refusal(StateSample.decode, raw) == reason
    good = payload(GOOD, [1, 2, 3])
    batches, refused = decode_states([good, raw, good], [ENCODING] * 3)
    assert [(index, error.reason) for index, error in refused] == [(1, reason)]
    assert sorted(i for batch in batches for i in batch.index.tolist()) == [0, 2]


@pytest.mark.parametrize(
    ("encoding", "reason"),
    [
        ("application/msgpack;fleet.state.v2", "version"),
        ("application/msgpack;fleet.tube.v1", "encoding"),
        ("", "encoding"),
    ],
)
def test_another_encoding_is_refused_one_by_one_and_at_once(encoding: str, reason: str) -> None:
    good = a_sample().encode()
    assert refusal(StateSample.decode, good, encoding) == reason
    batches, refused = decode_states([good, good], [ENCODING, encoding])
    assert [(index, error.reason) for index, error in refused] == [(1, reason)]
    assert [batch.index.tolist() for batch in batches] == [[0]]


def rows(batch: StateBatch) -> list[tuple[int, StateSample]]:
    found = []
    for i, index in enumerate(batch.index.tolist()):
        extra = [None if a is None else a[i] for a in (batch.bound, batch.plan, batch.plan_tolerance)]
        sample = StateSample(
            int(batch.epoch[i]), int(batch.seq[i]), int(batch.t[i]), batch.x[i], batch.u[i],
            StateFlag(int(batch.flags[i])), *extra,
        )  # fmt: skip
        found.append((index, sample))
    return found


bad = st.sampled_from(sorted(raw for raw, _ in REFUSED.values())) | st.binary(max_size=120)
#: A bin of 32 bits length is valid msgpack, but not what ``encode`` writes: it takes the slow path.
odd = samples(2, 1).map(lambda s: b"\x81\xa1d\xc6" + len(r := msgpack.unpackb(s.encode())["d"]).to_bytes(4, "big") + r)


@settings(max_examples=examples(300))
@given(st.lists(samples(2, 1).map(StateSample.encode) | samples().map(StateSample.encode) | bad | odd, max_size=12))
@pytest.mark.slow
def test_many_at_once_are_what_they_are_one_by_one(payloads: list[bytes]) -> None:
    expected: dict[int, StateSample] = {}
    reasons: dict[int, str] = {}
    for index, raw in enumerate(payloads):
        try:
            expected[index] = StateSample.decode(raw)
        except MessageError as error:
            reasons[index] = error.reason
    batches, refused = decode_states(payloads, [ENCODING] * len(payloads))
    found = [row for batch in batches for row in rows(batch)]
    assert sorted(index for index, _ in found) == sorted(expected)
    assert all(same(sample, expected[index]) for index, sample in found)
    assert {index: error.reason for index, error in refused} == reasons
    assert len(refused) == len(reasons)


@given(st.binary(min_size=1, max_size=4), st.integers(0, 400))
def test_a_mutated_sample_never_touches_its_neighbours(noise: bytes, place: int) -> None:
    good = a_sample().encode()
    place %= len(good)
    mutated = (good[:place] + noise + good[place + len(noise) :])[: len(good)]
    batches, refused = decode_states([good, mutated, good], [ENCODING] * 3)
    found = dict(row for batch in batches for row in rows(batch))
    assert same(found[0], a_sample())
    assert same(found[2], a_sample())
    assert (1 in found) == (not refused)


def test_equal_layouts_come_as_one_batch_in_order() -> None:
    payloads = [a_sample(seq=k, x=np.full(4, float(k))).encode() for k in range(100)]
    (batch,), refused = decode_states(payloads, [ENCODING] * 100)
    assert not refused
    assert np.array_equal(batch.seq, np.arange(100))
    assert np.array_equal(batch.index, np.arange(100))
    assert np.array_equal(batch.x[:, 0], np.arange(100.0))


def test_nothing_gives_nothing() -> None:
    assert decode_states([], []) == ([], [])


def test_the_longest_plan_that_fits_is_accepted_and_one_more_is_refused() -> None:
    room = (MAX_BYTES - 6 - 40) // 8 - 4 - 2
    fits = a_sample(plan=np.zeros((room // 2 - 1, 2))).encode()
    assert len(fits) <= MAX_BYTES
    StateSample.decode(fits)
    assert refusal(a_sample(plan=np.zeros((room // 2 + 1, 2))).encode) == "too_large"


UNSENDABLE = {
    "NaN": (a_sample(x=np.array([0.0, NAN, 0.0, 0.0])), "not_finite"),
    "infinite plan": (a_sample(plan=np.array([[0.0, INF]])), "not_finite"),
    "huge state": (a_sample(x=np.full(4, 1e31)), "range"),
    "negative bound": (a_sample(bound=np.array([0.1, 0.1, -0.1, 0.1])), "range"),
    "no time": (a_sample(t=0), "range"),
    "time beyond 64 bits": (a_sample(t=2**70), "range"),
    "negative seq": (a_sample(seq=-1), "range"),
    "epoch beyond 64 bits": (a_sample(epoch=2**64), "range"),
    "unknown flag": (a_sample(flags=StateFlag(16)), "range"),
    "33 states": (a_sample(x=np.zeros(33)), "range"),
    "bound of other length": (a_sample(bound=np.zeros(3)), "shape"),
    "plan of other width": (a_sample(plan=np.zeros((3, 1))), "shape"),
    "tolerance of other length": (a_sample(plan=np.zeros((3, 2)), plan_tolerance=np.zeros(3)), "shape"),
}


@pytest.mark.parametrize("what", UNSENDABLE)
def test_what_would_be_refused_is_not_encoded(what: str) -> None:
    sample, reason = UNSENDABLE[what]
    assert refusal(sample.encode) == reason


whole_header = st.tuples(
    *[
        st.sampled_from([0, 1, int(span.low), int(span.high), int(span.high) + 1, *extra])
        for span, extra in (
            (ranges.EPOCH, (2**64 - 1,)), (ranges.SEQ, (2**63, 2**64 - 1)), (ranges.TIME, (-1, 2**63 - 1, -(2**63))),
            (ranges.FLAGS, (2**31,)),
        )
    ]
)  # fmt: skip
extremes = st.sampled_from([0.0, -0.0, 5e-324, 1e30, -1e30, np.nextafter(1e30, 2e30), -1.1e30, 1e308, NAN, INF, -INF])


@settings(max_examples=300)
@given(st.lists(st.tuples(whole_header, st.lists(extremes, min_size=7, max_size=7)), min_size=1, max_size=8))
@pytest.mark.slow
def test_both_ways_of_reading_hold_the_same_ranges(made: list[tuple[tuple[int, ...], list[float]]]) -> None:
    """Samples of one layout, so that they are read as a batch, with numbers at and beyond the ends of their ranges."""
    payloads = [
        payload((*header, 2, 1, 1, 0), [*n[:3], *(n[3:5] if header[3] & 4 else []), *n[5:]]) for header, n in made
    ]
    reasons: dict[int, str] = {}
    for index, raw in enumerate(payloads):
        try:
            assert StateSample.decode(raw).encode() == raw
        except MessageError as error:
            reasons[index] = error.reason
    batches, refused = decode_states(payloads, [ENCODING] * len(payloads))
    assert {index: error.reason for index, error in refused} == reasons
    read = sorted(i for batch in batches for i in batch.index.tolist())
    assert read == [i for i in range(len(payloads)) if i not in reasons]
