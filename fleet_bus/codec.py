"""Strict, bounded msgpack: what every message of the bus is packed and unpacked with."""

from collections.abc import Mapping
from typing import Any, Final

import msgpack
import numpy as np
from numpy.typing import NDArray

from fleet_bus.errors import MessageError

MEDIA_TYPE: Final = "application/msgpack"

#: Longest list and largest map. msgpack makes room for a list as its length claims, at every level of nesting, so
#: that a long limit would let a few bytes take much memory.
MAX_LIST: Final = 1024
MAX_MAP: Final = 256
#: Lists and maps inside of each other; what goes deeper would overflow the stack of whoever prints it.
MAX_DEPTH: Final = 16

#: Every reason under which a message can be refused, with what it means (also the metric labels).
REASONS: Final[Mapping[str, str]] = {
    "key": "the key names no valid vehicle, scenario or service",
    "encoding": "the encoding names another schema, or none",
    "version": "the schema is known, its version is not",
    "too_large": "the payload is larger than the schema allows",
    "malformed": "the payload is not msgpack, is nested too deeply or holds too much",
    "fields": "a field is missing, unknown or of the wrong type",
    "shape": "an array has another length than its header or its profile says",
    "not_finite": "an array holds NaN or an infinity",
    "range": "a number lies outside what the field allows",
    "no_profile": "a state of a vehicle whose profile has not come",
    "profile": "a state that contradicts the profile of its vehicle",
    "overflow": "more arrived than could be kept until it was processed",
    "other_source": "another session writes to this key",
    "old_version": "a document of a version that is not above the one in force",
}


def pack(fields: Mapping[str, Any], *, limit: int | None = None) -> bytes:
    """Pack a map; ``bytes`` become msgpack bin, text becomes str.

    Raises ``MessageError`` (range, too_large) for an integer beyond 64 bits, and for more than ``limit`` bytes.
    """
    try:
        packed: bytes = msgpack.packb(fields, use_bin_type=True)
    except OverflowError:
        raise MessageError("range", "an integer needs more than 64 bits") from None
    if limit is not None:
        _check_size(packed, limit)
    return packed


def unpack(payload: bytes, *, limit: int) -> dict[str, Any]:
    """Unpack a map of at most ``limit`` bytes; raise ``MessageError`` (too_large, malformed, fields) otherwise."""
    _check_size(payload, limit)
    try:
        # The lengths are bounded before anything is allocated, so that a few bytes cannot claim gigabytes.
        fields = msgpack.unpackb(
            payload,
            raw=False,
            strict_map_key=True,
            max_str_len=limit,
            max_bin_len=limit,
            max_array_len=MAX_LIST,
            max_map_len=MAX_MAP,
            max_ext_len=0,
            object_pairs_hook=_unique,
        )
    except (ValueError, TypeError, RecursionError, msgpack.exceptions.UnpackException) as error:
        raise MessageError("malformed", f"not a msgpack map: {error or type(error).__name__}") from None
    if not isinstance(fields, dict):
        raise MessageError("malformed", f"a msgpack {type(fields).__name__} where a map is expected")
    _check_depth(fields)
    return fields


def _check_size(payload: bytes, limit: int) -> None:
    if len(payload) > limit:
        raise MessageError("too_large", f"{len(payload)} bytes where at most {limit} are allowed")


def _check_depth(fields: dict[str, Any]) -> None:
    level: list[Any] = [fields]
    for _ in range(MAX_DEPTH):
        level = [
            item
            for holder in level
            for item in (holder.values() if isinstance(holder, dict) else holder)
            if isinstance(item, dict | list)
        ]
        if not level:
            return
    raise MessageError("malformed", f"lists and maps are nested more than {MAX_DEPTH} deep")


def _unique(pairs: list[tuple[Any, Any]]) -> dict[Any, Any]:
    """Map of some pairs; raise ``ValueError`` for a repeated key, of which readers would keep different values."""
    fields = dict(pairs)
    if len(fields) != len(pairs):
        raise ValueError("a key of a map is repeated")
    return fields


def encoding(schema: str, version: int) -> str:
    """Zenoh encoding of a message: media type, then schema name and version."""
    return f"{MEDIA_TYPE};{schema}.v{version}"


def check_encoding(found: str, schema: str, version: int) -> None:
    """Raise ``MessageError`` (encoding or version) unless ``found`` is ``encoding(schema, version)``."""
    if found == encoding(schema, version):
        return
    if found.startswith(f"{MEDIA_TYPE};{schema}.v"):
        raise MessageError("version", f"{found!r:.80} came, this program reads version {version}")
    raise MessageError("encoding", f"{found!r:.80} came where {encoding(schema, version)!r} is expected")


def to_bin(array: NDArray[Any], dtype: str = "<f8") -> bytes:
    """Little-endian bytes of an array in C order."""
    return np.ascontiguousarray(array, dtype=dtype).tobytes()


def from_bin(fields: Mapping[str, Any], key: str, shape: tuple[int, ...], dtype: str = "<f8") -> NDArray[Any]:
    """Read-only array of a bin field; raise ``MessageError`` (fields, shape, not_finite) if it does not fit."""
    raw = fields.get(key)
    if not isinstance(raw, bytes):
        raise MessageError("fields", f"field {key!r} must be bin, came as {type(raw).__name__}")
    expected = int(np.prod(shape)) * np.dtype(dtype).itemsize
    if len(raw) != expected:
        raise MessageError("shape", f"field {key!r} holds {len(raw)} bytes, shape {shape} of {dtype} has {expected}")
    array = np.frombuffer(raw, dtype=dtype).reshape(shape)
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise MessageError("not_finite", f"field {key!r} holds NaN or an infinity")
    return array


def check_fields(fields: Mapping[str, Any], types: Mapping[str, type | tuple[type, ...]]) -> None:
    """Raise ``MessageError("fields")`` unless ``fields`` has exactly the keys and types of ``types``."""
    if fields.keys() != types.keys():
        missing = sorted(types.keys() - fields.keys())
        unknown = sorted(str(key)[:40] for key in fields.keys() - types.keys())[:8]
        raise MessageError("fields", f"missing {missing}, unknown {unknown}")
    for key, kind in types.items():
        # bool is an int to Python, never on the wire
        if not isinstance(fields[key], kind) or (isinstance(fields[key], bool) and kind is not bool):
            raise MessageError("fields", f"field {key!r} came as {type(fields[key]).__name__}")
