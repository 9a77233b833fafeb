"""A graph of objects from bytes (``object_graph`` says how)."""

import sys
from collections import deque
from collections.abc import Callable, Mapping
from enum import Enum, Flag
from types import FunctionType, MethodType
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

from reach_server.predicates.interval_ad.tape import operation_of
from reach_server.service.object_graph import (
    ARRAY,
    CLASS,
    DEQUE,
    DICT,
    ENUM,
    FILL,
    FROZEN,
    GIVEN,
    LARGE,
    LIST,
    MEMORY,
    METHOD,
    MOST_BYTES,
    MOST_ELEMENTS,
    NAMED_TUPLE,
    NOTHING,
    OBJECT,
    OPERATION,
    SCALAR,
    SET,
    TUPLE,
    CheckpointError,
    Layout,
    allowed,
    checked_dtype,
    layout_of,
)


def load(data: bytes, given: Mapping[str, object]) -> Any:
    """The object that ``dump`` wrote; ``given`` has what was left out, by name. Raises ``CheckpointError`` for bytes
    that are no such graph, or of another version of the program."""
    if len(data) > MOST_BYTES:
        raise CheckpointError(f"{len(data)} bytes: at most {MOST_BYTES} are read")
    try:
        return _Reader(given).read(data)
    except CheckpointError:
        raise
    except Exception as error:
        raise CheckpointError(f"not a checkpoint: {type(error).__name__}: {error!s:.200}") from None


class _Reader:
    def __init__(self, given: Mapping[str, object]) -> None:
        self._given = given
        self._made: list[Any] = []
        self._classes: list[tuple[type, Layout]] = []
        self._makers: dict[int, Callable[..., object]] = {
            LIST: list, DICT: dict, SET: set, DEQUE: self._deque, OBJECT: self._object, TUPLE: self._tuple,
            FROZEN: self._frozen, NAMED_TUPLE: self._named_tuple, ENUM: self._enum, METHOD: self._method,
            MEMORY: self._memory, ARRAY: self._array, SCALAR: self._scalar, LARGE: self._large,
            GIVEN: self._given.__getitem__, OPERATION: operation_of,
        }  # fmt: skip

    def read(self, data: bytes) -> Any:
        unpacker = msgpack.Unpacker(
            raw=False, strict_map_key=True, max_buffer_size=MOST_BYTES, max_str_len=2**20, max_bin_len=MOST_BYTES,
            max_array_len=2**26, max_map_len=0, max_ext_len=0,
        )  # fmt: skip
        unpacker.feed(data)
        hashing: list[tuple[Any, list[Any]]] = []
        for kind, *record in unpacker:
            if kind == CLASS:
                self._classes.append(self._known_class(*record))
            elif kind == FILL:
                holder, contents = self._made[record[0]], record[1:]
                if type(holder) in (dict, set):
                    hashing.append((holder, contents))
                else:
                    self._fill(holder, contents)
            else:
                self._made.append(self._makers[kind](*record))
        if unpacker.tell() != len(data):
            raise CheckpointError("the last record is cut off")
        for holder, contents in hashing:
            values = list(map(self._value, contents))
            if type(holder) is dict:
                holder.update(zip(values[::2], values[1::2], strict=True))
            else:
                holder.update(values)
        return self._made[len(self._given)]

    def _value(self, written: Any) -> Any:
        if type(written) is not list:
            return written
        (number,) = written
        if number < 0:
            raise CheckpointError("a reference before the first object")
        return self._made[number]

    def _fill(self, holder: Any, contents: list[Any]) -> None:
        if type(holder) in (list, deque):
            holder.extend(map(self._value, contents))
            return
        layout = layout_of(type(holder))
        for name, written in zip(layout.slots, contents, strict=False):
            if written != NOTHING:
                object.__setattr__(holder, name, self._value(written))
        others = contents[len(layout.slots) :]
        if layout.open:
            vars(holder).update(zip(others[::2], map(self._value, others[1::2]), strict=True))
        elif others:
            raise CheckpointError(f"more attributes than a {type(holder).__qualname__} has")

    def _known_class(self, module: str, name: str, slots: list[str]) -> tuple[type, Layout]:
        cls: Any = sys.modules.get(module) if allowed(module) else None
        for part in name.split("."):
            cls = vars(cls).get(part) if cls is not None else None
        if not isinstance(cls, type) or cls.__module__ != module:
            raise CheckpointError(f"{module:.80}.{name:.80} is no class that may be restored")
        layout = layout_of(cls)
        if list(layout.slots) != slots:
            raise CheckpointError(f"{module}.{name} has other attributes here: another version wrote this")
        return cls, layout

    def _object(self, number: int) -> object:
        cls = self._classes[number][0]
        if issubclass(cls, Enum | tuple | type):
            raise CheckpointError(f"a {cls.__qualname__} is not made of attributes")
        return object.__new__(cls)

    def _tuple(self, *values: Any) -> tuple[Any, ...]:
        return tuple(map(self._value, values))

    def _frozen(self, *values: Any) -> frozenset[Any]:
        return frozenset(map(self._value, values))

    def _named_tuple(self, number: int, *values: Any) -> Any:
        cls = self._classes[number][0]
        if not issubclass(cls, tuple) or len(getattr(cls, "_fields", ())) != len(values):
            raise CheckpointError(f"a {cls.__qualname__} of {len(values)} values: another version wrote this")
        return tuple.__new__(cls, map(self._value, values))

    def _enum(self, number: int, value: str | int) -> Enum:
        cls = self._classes[number][0]
        if not issubclass(cls, Enum):
            raise CheckpointError(f"{cls.__qualname__} is no enumeration")
        return cls(value) if issubclass(cls, Flag) else cls[str(value)]

    def _method(self, owner: list[int], name: str) -> MethodType:
        bound = self._value(owner)
        function = next((vars(base)[name] for base in type(bound).__mro__ if name in vars(base)), None)
        if not isinstance(function, FunctionType) or not allowed(function.__module__):
            raise CheckpointError(f"{name:.80} is no method of a {type(bound).__qualname__}")
        return MethodType(function, bound)

    def _memory(self, data: bytes) -> NDArray[np.uint8]:
        memory = np.empty(len(data), dtype=np.uint8)
        memory[:] = np.frombuffer(data, dtype=np.uint8)
        return memory

    def _array(
        self, memory: list[int], dtype: str, shape: list[int], strides: list[int], offset: int, writeable: bool
    ) -> NDArray[Any]:
        if np.prod(shape, dtype=np.float64) > MOST_ELEMENTS:
            raise CheckpointError(f"an array of shape {shape!s:.80} is too large")
        kind = np.dtype(dtype)
        checked_dtype(kind)
        buffer = self._value(memory)
        if not isinstance(buffer, np.ndarray):
            raise CheckpointError("an array of no memory")
        array: NDArray[Any] = np.ndarray(tuple(shape), kind, buffer, offset, tuple(strides))
        array.flags.writeable = writeable
        return array

    def _scalar(self, dtype: str, data: bytes) -> Any:
        kind = np.dtype(dtype)
        checked_dtype(kind)
        (value,) = np.frombuffer(data, dtype=kind)
        return value

    def _large(self, data: bytes) -> int:
        return int.from_bytes(data, "little", signed=True)

    def _deque(self, longest: int | None) -> deque[Any]:
        return deque(maxlen=longest)
