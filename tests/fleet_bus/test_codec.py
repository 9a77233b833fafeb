"""What comes from the bus is read strictly and within bounds, whatever it is."""

import random
import struct
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet_bus import codec
from fleet_bus.errors import MessageError
from tests.fleet_bus.messages.examples import messages, reason_or_none, refusal

MESSAGES = messages()
each_message = pytest.mark.parametrize("name", MESSAGES)

#: What the decoding of one message may allocate: a few times the largest message.
MEMORY = 4_000_000


@contextmanager
def bounded_memory(limit: int = MEMORY) -> Iterator[None]:
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < limit
    finally:
        tracemalloc.stop()


def accepted_or_refused(decode: Callable[..., object], *arguments: Any, **options: Any) -> None:
    assert reason_or_none(decode, *arguments, **options) in {None, *codec.REASONS}


plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text() | st.binary(),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=5), inner, max_size=5),
    max_leaves=20,
)


@given(st.dictionaries(st.text(), st.integers(-(2**63), 2**64 - 1) | st.text() | st.binary(), max_size=20))
def test_what_is_packed_is_unpacked(fields: dict[str, object]) -> None:
    payload = codec.pack(fields)
    assert codec.unpack(payload, limit=len(payload)) == fields


@given(st.binary(max_size=200))
def test_random_bytes_are_unpacked_or_refused(payload: bytes) -> None:
    accepted_or_refused(codec.unpack, payload, limit=1000)


@each_message
def test_random_bytes_are_no_message(name: str) -> None:
    _, decode, _, _ = MESSAGES[name]
    source = random.Random(7)
    for _ in range(300):
        noise = source.randbytes(source.randrange(200))
        assert refusal(decode, noise) in ("malformed", "fields")


@each_message
def test_every_truncation_is_refused(name: str) -> None:
    payload, decode, _, _ = MESSAGES[name]
    for length in range(len(payload)):
        assert refusal(decode, payload[:length]) == "malformed"


@each_message
def test_what_follows_the_map_is_refused(name: str) -> None:
    payload, decode, _, _ = MESSAGES[name]
    assert refusal(decode, payload + b"\xc0") == "malformed"
    assert refusal(decode, payload + payload) == "malformed"


@each_message
def test_a_mutated_message_is_accepted_or_refused_and_nothing_else(name: str) -> None:
    payload, decode, _, _ = MESSAGES[name]
    source = random.Random(11)
    for _ in range(1500):
        mutated = bytearray(payload)
        for _ in range(source.choice((1, 1, 2, 8))):
            place = source.randrange(len(mutated))
            mutated[place] = source.randrange(256)
            if source.random() < 0.1:
                del mutated[place]
        accepted_or_refused(decode, bytes(mutated))


@each_message
def test_each_field_may_be_missing_doubled_or_anything_else(name: str) -> None:
    payload, decode, _, _ = MESSAGES[name]
    fields = msgpack.unpackb(payload)
    strange: list[object] = [
        None,
        True,
        -1,
        2**64 - 1,
        1.5,
        float("nan"),
        float("inf"),
        "",
        "x" * 300,
        b"",
        b"\0" * 7,
        [],
        [[]],
        {},
    ]
    for key in fields:
        for value in strange:
            changed = msgpack.packb({**fields, key: value})
            accepted_or_refused(decode, changed)
        renamed = {f"{k}_" if k == key else k: v for k, v in fields.items()}
        assert refusal(decode, msgpack.packb(renamed)) == "fields"
        doubled = bytearray(payload + msgpack.packb(key) + msgpack.packb(fields[key]))
        if len(fields) < 15:
            doubled[0] += 1
        else:
            doubled[1:3] = struct.pack(">H", len(fields) + 1)
        assert refusal(decode, bytes(doubled)) == "malformed"
    assert refusal(decode, msgpack.packb({**fields, "unknown": 1})) == "fields"
    assert refusal(decode, msgpack.packb({**fields, b"bytes": 1})) == "fields"
    assert refusal(decode, msgpack.packb({**fields, 7: 1})) == "malformed"


@given(plain)
def test_any_data_in_msgpack_is_read_or_refused(data: object) -> None:
    payload = msgpack.packb(data)
    for _, decode, _, _ in MESSAGES.values():
        assert refusal(decode, payload) in ("fields", "malformed", "too_large")


@each_message
@pytest.mark.parametrize("level", [b"\x91", b"\x81\xa1a", b"\xdc\x04\x00", b"\xdd\x00\x00\x04\x00", b"\xdc\xff\xff"])
@pytest.mark.parametrize("depth", [17, 200, 999, 1024, 5000])
def test_a_nested_bomb_is_refused_cheaply(name: str, level: bytes, depth: int) -> None:
    payload, decode, _, limit = MESSAGES[name]
    key = msgpack.packb(next(iter(msgpack.unpackb(payload))))
    bomb = b"\x81" + key + level * depth
    with bounded_memory(12_000_000):
        assert refusal(decode, bomb) == ("malformed" if len(bomb) <= limit else "too_large")
    # the same, but well-formed
    if level in (b"\x91", b"\x81\xa1a"):
        assert refusal(decode, bomb + b"\xc0") == ("malformed" if len(bomb) + 1 <= limit else "too_large")


@each_message
@pytest.mark.parametrize(
    "claim",
    [b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff", b"\xc6\xff\xff\xff\xff", b"\xdb\xff\xff\xff\xff",
     b"\xc9\xff\xff\xff\xff\x01", b"\xde\xff\xff", b"\xdd\x7f\xff\xff\xff", b"\xd6\xff\x00\x00\x00\x00"],
)  # fmt: skip
def test_a_few_bytes_cannot_claim_gigabytes(name: str, claim: bytes) -> None:
    payload, decode, _, _ = MESSAGES[name]
    key = msgpack.packb(next(iter(msgpack.unpackb(payload))))
    for bomb in (claim, b"\x81" + key + claim, b"\x81" + claim):
        with bounded_memory():
            assert refusal(decode, bomb) == "malformed"


@each_message
def test_a_megabyte_of_noise_is_too_large_before_it_is_looked_at(name: str) -> None:
    payload, decode, _, limit = MESSAGES[name]
    noise = random.Random(3).randbytes(max(1_000_000, limit + 1))
    padded = payload + bytes(limit)
    with bounded_memory(100_000):
        assert refusal(decode, noise) == "too_large"
        assert refusal(decode, padded) == "too_large"


@pytest.mark.parametrize(
    "payload", [b"", b"\xc0", b"\x90", b"\x01", b"\xa1a", b"\xc4\x01a", b"\x81\xa1\xff\x01", b"\xc1"]
)
def test_what_is_no_map_is_malformed(payload: bytes) -> None:
    assert refusal(codec.unpack, payload, limit=100) == "malformed"


@each_message
def test_encodings_are_told_apart(name: str) -> None:
    _, _, encoding, _ = MESSAGES[name]
    schema, _, version = encoding.removeprefix("application/msgpack;").rpartition(".v")
    codec.check_encoding(encoding, schema, int(version))
    for found in (f"application/msgpack;{schema}.v2", f"application/msgpack;{schema}.v11", f"{encoding}.1"):
        assert refusal(codec.check_encoding, found, schema, 1) == "version"
    for found in ("", "zenoh/bytes", "application/msgpack", "application/json;" + schema, "application/cdr", "é" * 500):
        assert refusal(codec.check_encoding, found, schema, 1) == "encoding"
    others = [other for _, _, other, _ in MESSAGES.values() if other != encoding]
    for other in others:
        assert refusal(codec.check_encoding, other, schema, 1) == "encoding"


def test_the_message_says_which_version_came_and_which_is_read() -> None:
    with pytest.raises(MessageError, match=r"fleet\.state\.v2.* this program reads version 1"):
        codec.check_encoding("application/msgpack;fleet.state.v2", "fleet.state", 1)


def test_bins_are_little_endian_rows_and_read_only() -> None:
    array = np.arange(6.0).reshape(2, 3)
    raw = codec.to_bin(np.asfortranarray(array))
    assert raw == struct.pack("<6d", *range(6))
    found = codec.from_bin({"a": raw}, "a", (2, 3))
    assert np.array_equal(found, array)
    with pytest.raises(ValueError, match="read-only"):
        found[0, 0] = 1.0


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({}, "fields"),
        ({"a": "text"}, "fields"),
        ({"a": [1.0]}, "fields"),
        ({"a": b""}, "shape"),
        ({"a": b"\0" * 15}, "shape"),
        ({"a": b"\0" * 24}, "shape"),
        ({"a": struct.pack("<2d", 1.0, float("nan"))}, "not_finite"),
        ({"a": struct.pack("<2d", float("-inf"), 1.0)}, "not_finite"),
    ],
)
def test_a_bin_that_does_not_fit_is_refused(fields: dict[str, object], reason: str) -> None:
    assert refusal(codec.from_bin, fields, "a", (2,)) == reason


def test_fields_have_exactly_their_types() -> None:
    types: dict[str, type | tuple[type, ...]] = {"a": int, "b": (float, int), "c": bool}
    codec.check_fields({"a": 1, "b": 2, "c": True}, types)
    for wrong in ({"a": True, "b": 2, "c": True}, {"a": 1, "b": "2", "c": True}, {"a": 1.0, "b": 2, "c": True},
                  {"a": 1, "b": 2}, {"a": 1, "b": 2, "c": True, "d": 0}, {"a": 1, "b": False, "c": True}):  # fmt: skip
        assert refusal(codec.check_fields, wrong, types) == "fields"
