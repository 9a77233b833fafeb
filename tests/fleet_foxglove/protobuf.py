"""Protobuf read by its wire format, with the names that a served schema has: shares no code with Foxglove's SDK."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

_VARINT, _EIGHT, _LENGTH, _FOUR = 0, 1, 2, 5
_NUMBERS = {1: "<d", 2: "<f", 6: "<Q", 7: "<I", 15: "<i", 16: "<q"}
_STRING, _MESSAGE, _BYTES = 9, 11, 12
_SIGNED = {3, 5}
_REPEATED = 3


@dataclass(frozen=True)
class Field:
    name: str
    repeated: bool
    type: int
    type_name: str


Schema = dict[str, dict[int, Field]]


def varint(raw: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = raw[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return value, at


def fields(raw: bytes) -> Iterator[tuple[int, int, Any]]:
    """Number, wire type and raw value of each field."""
    at = 0
    while at < len(raw):
        tag, at = varint(raw, at)
        number, kind = tag >> 3, tag & 7
        if kind == _VARINT:
            value: Any
            value, at = varint(raw, at)
        elif kind == _LENGTH:
            length, at = varint(raw, at)
            value, at = raw[at : at + length], at + length
            assert len(value) == length
        else:
            size = {_EIGHT: 8, _FOUR: 4}[kind]
            value, at = raw[at : at + size], at + size
        yield number, kind, value


def read_schema(data: bytes) -> Schema:
    """Messages of a FileDescriptorSet by full name, their fields by number."""
    found: Schema = {}
    for _, _, file in fields(data):
        package = next((value.decode() for number, _, value in fields(file) if number == 2), "")
        for number, _, value in fields(file):
            if number == 4:
                _read_message(value, f".{package}", found)
    return found


def _read_message(raw: bytes, prefix: str, found: Schema) -> None:
    parts = list(fields(raw))
    name = f"{prefix}." + next(value.decode() for number, _, value in parts if number == 1)
    found[name] = {}
    for number, _, value in parts:
        if number == 2:
            given = {n: v for n, _, v in fields(value)}
            type_name = given.get(6, b"").decode()
            found[name][given[3]] = Field(given[1].decode(), given[4] == _REPEATED, given[5], type_name)
        elif number == 3:
            _read_message(value, name, found)


def decode(raw: bytes, schema: Schema, name: str) -> dict[str, Any]:
    """A message by names; what is not on the wire has the default of its type, None for a message."""
    known = schema[name]
    message: dict[str, Any] = {field.name: _default(field) for field in known.values()}
    for number, kind, value in fields(raw):
        field = known[number]
        values = list(_values(field, kind, value, schema))
        if field.repeated:
            message[field.name] += values
        else:
            (message[field.name],) = values
    return message


def _default(field: Field) -> Any:
    if field.repeated:
        return []
    return {_STRING: "", _BYTES: b"", _MESSAGE: None}.get(field.type, 0)


def _values(field: Field, kind: int, value: Any, schema: Schema) -> Iterator[Any]:
    if field.type == _MESSAGE:
        yield decode(value, schema, field.type_name)
    elif field.type == _STRING:
        yield value.decode()
    elif field.type == _BYTES:
        yield value
    elif field.type in _NUMBERS:
        # Repeated numbers come in one piece.
        yield from (number for (number,) in struct.iter_unpack(_NUMBERS[field.type], value))
    else:
        at = 0
        raw = value if kind == _LENGTH else None
        while raw is not None and at < len(raw):
            item, at = varint(raw, at)
            yield item - (field.type in _SIGNED and item >> 63) * 2**64
        if raw is None:
            yield value - (field.type in _SIGNED and value >> 63) * 2**64
