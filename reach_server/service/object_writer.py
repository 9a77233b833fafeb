"""A graph of objects as bytes (``object_graph`` says how)."""

import ctypes
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from enum import Enum, Flag
from types import MethodType
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

from reach_server.predicates.interval_ad.tape import Operation, code_of
from reach_server.service.object_graph import (
    ARRAY,
    CLASS,
    ENUM,
    FILL,
    FROZEN,
    GIVEN,
    LARGE,
    MEMORY,
    METHOD,
    NAMED_TUPLE,
    NOTHING,
    OBJECT,
    OPERATION,
    PLAIN,
    SCALAR,
    SHELLS,
    TUPLE,
    CheckpointError,
    Layout,
    allowed,
    checked_dtype,
    layout_of,
)


def dump(root: object, given: Mapping[str, object]) -> bytes:
    """The graph below an object; those ``given`` by name are left out. Raises ``CheckpointError`` for what is of no
    class that may be restored."""
    return _Writer(given).written(root)


class _Writer:
    def __init__(self, given: Mapping[str, object]) -> None:
        self._pack: Callable[[object], bytes] = msgpack.Packer(use_bin_type=True).pack
        self._parts: list[bytes] = []
        self._numbers: dict[int, int] = {}
        #: What was made on the way is kept, so that its id stays its own.
        self._kept: list[object] = []
        self._unfilled: deque[tuple[int, Any]] = deque()
        self._classes: dict[type, tuple[int, Layout]] = {}
        #: Memory that arrays look at, by the id of the array that has it.
        self._memories: dict[int, list[int]] = {}
        self._count = 0
        for name, value in given.items():
            self._make(value, GIVEN, name)

    def written(self, root: object) -> bytes:
        self._value(root)
        while self._unfilled:
            number, holder = self._unfilled.popleft()
            self._put(FILL, number, *self._contents(holder))
        return b"".join(self._parts)

    def _put(self, *record: Any) -> None:
        self._parts.append(self._pack(record))

    def _make(self, value: object, *record: Any) -> list[int]:
        """Write what makes an object; its number, as it is referred to."""
        made = self._new(*record)
        self._numbers[id(value)] = made[0]
        self._kept.append(value)
        return made

    def _new(self, *record: Any) -> list[int]:
        self._put(*record)
        self._count += 1
        return [self._count - 1]

    def _value(self, value: Any) -> Any:
        """How a value stands in a record: itself, or a reference."""
        kind = type(value)
        if kind in PLAIN:
            return value
        if kind is int:
            if -(2**63) <= value < 2**64:
                return value
            return self._make(value, LARGE, value.to_bytes(value.bit_length() // 8 + 1, "little", signed=True))
        number = self._numbers.get(id(value))
        return [number] if number is not None else self._made(value, kind)

    def _made(self, value: Any, kind: type) -> list[int]:
        if kind is tuple:
            return self._make(value, TUPLE, *map(self._value, value))
        if kind is frozenset:
            return self._make(value, FROZEN, *map(self._hashable, value))
        if kind in SHELLS:
            more = (value.maxlen,) if kind is deque else ()
            return self._shell(value, SHELLS[kind], *more)
        if kind is np.ndarray:
            return self._array(value)
        if isinstance(value, np.generic):
            return self._make(value, SCALAR, checked_dtype(value.dtype), value.tobytes())
        if kind is MethodType:
            return self._make(value, METHOD, self._value(value.__self__), value.__func__.__name__)
        if kind is Operation:
            return self._make(value, OPERATION, code_of(value))
        number, _ = self._class(kind)
        if isinstance(value, Enum):
            return self._make(value, ENUM, number, value.value if isinstance(value, Flag) else value.name)
        if isinstance(value, tuple):
            return self._make(value, NAMED_TUPLE, number, *map(self._value, value))
        if isinstance(value, dict | list | set | frozenset | str | bytes | int | float):
            raise CheckpointError(f"a {kind.__qualname__} is more than its attributes: it cannot be restored")
        return self._shell(value, OBJECT, number)

    def _shell(self, value: object, *record: Any) -> list[int]:
        made = self._make(value, *record)
        self._unfilled.append((made[0], value))
        return made

    def _hashable(self, value: Any) -> Any:
        """A member of a frozen set, which is hashed when it is made, before any object has its attributes."""
        plain = type(value) in PLAIN or type(value) is int
        if not plain and not (type(value) is tuple and all(type(v) in PLAIN or type(v) is int for v in value)):
            raise CheckpointError(f"a frozen set of {type(value).__qualname__} cannot be restored")
        return self._value(value)

    def _class(self, cls: type) -> tuple[int, Layout]:
        known = self._classes.get(cls)
        if known is None:
            if not allowed(cls.__module__):
                raise CheckpointError(f"a {cls.__module__}.{cls.__qualname__} cannot be restored: not on the list")
            layout = layout_of(cls)
            known = self._classes[cls] = len(self._classes), layout
            self._put(CLASS, cls.__module__, cls.__qualname__, list(layout.slots))
        return known

    def _contents(self, holder: Any) -> Iterator[Any]:
        kind = type(holder)
        if kind is dict:
            for key, value in holder.items():
                yield self._value(key)
                yield self._value(value)
        elif kind in SHELLS:
            yield from map(self._value, holder)
        else:
            layout = self._classes[kind][1]
            for name in layout.slots:
                yield self._value(getattr(holder, name)) if hasattr(holder, name) else NOTHING
            if layout.open:
                for name, value in vars(holder).items():
                    yield name
                    yield self._value(value)

    def _array(self, array: NDArray[Any]) -> list[int]:
        owner = array
        while isinstance(owner.base, np.ndarray):
            owner = owner.base
        low, high = np.lib.array_utils.byte_bounds(owner)
        memory = self._memories.get(id(owner))
        if memory is None:
            memory = self._memories[id(owner)] = self._new(MEMORY, ctypes.string_at(low, high - low))
            self._kept.append(owner)
        offset = array.__array_interface__["data"][0] - low if array.size else 0
        return self._make(
            array, ARRAY, memory, checked_dtype(array.dtype), list(array.shape), list(array.strides), offset,
            array.flags.writeable,
        )  # fmt: skip
