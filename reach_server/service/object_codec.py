"""A graph of objects as bytes and back: what a checkpoint is made of.

No pickle: what is read makes objects of classes from an allow list, by ``object.__new__`` and attributes, and calls
nothing that it names. References are kept, so that what was shared is shared again, arrays that look at one memory
included: a kernel that writes to one changes the other. Arrays keep strides and order, on which sums depend.

The bytes are msgpack records. Some make an object, which gets the next number: first without contents, where it may
refer to what comes later; others fill one. Dictionaries and sets are filled last, when their keys can be hashed.
"""

import ctypes
import sys
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum, Flag
from types import FunctionType, MethodType
from typing import Any, Final

import msgpack
import numpy as np
from numpy.typing import NDArray

from reach_server.predicates.interval_ad.tape import Operation, code_of, operation_of

#: Modules of whose classes objects may be made, and all modules below them.
ALLOWED: Final = (
    "fleet_bus.messages", "fleet_bus.writers",
    "side_info.documents", "side_info.progression", "side_info.stl",
    "reach_server.numeric", "reach_server.sets", "reach_server.data", "reach_server.predicates", "reach_server.models",
    "reach_server.side_information", "reach_server.tube", "reach_server.audit", "reach_server.methods",
    "reach_server.engine",
    "reach_server.service.clock_offsets", "reach_server.service.fleet", "reach_server.service.profiles",
    "reach_server.service.registry", "reach_server.service.sample_admission", "reach_server.service.sample_rows",
    "reach_server.service.scenario_assignments", "reach_server.service.scenario_book", "reach_server.service.vehicle",
)  # fmt: skip
#: Bytes that are read at most, and elements of an array.
MOST_BYTES: Final = 2**30
MOST_ELEMENTS: Final = 2**27

# Kinds of records: those that make something, and the one that fills it.
LIST, DICT, SET, DEQUE, OBJECT, TUPLE, FROZEN, NAMED_TUPLE = range(8)
ENUM, METHOD, MEMORY, ARRAY, SCALAR, LARGE, GIVEN, OPERATION = range(8, 16)
CLASS, FILL = 16, 17

#: A slot that holds nothing: no reference is like it.
_NOTHING: Final[list[int]] = []
_PLAIN: Final = frozenset({type(None), bool, float, str, bytes})
_SHELLS: Final[Mapping[type, int]] = {list: LIST, dict: DICT, set: SET, deque: DEQUE}


class CheckpointError(Exception):
    """State that cannot be written, or bytes that cannot be read; says what and where."""


@dataclass(frozen=True, slots=True)
class _Layout:
    """Attributes of a class that have slots, in order, and whether its objects have others."""

    slots: tuple[str, ...]
    open: bool


def _layout(cls: type) -> _Layout:
    slots: list[str] = []
    for base in reversed(cls.__mro__):
        own = base.__dict__.get("__slots__", ())
        slots += [name for name in ((own,) if isinstance(own, str) else own) if name not in ("__dict__", "__weakref__")]
    return _Layout(tuple(slots), cls.__dictoffset__ != 0)


def allowed(module: str) -> bool:
    """Whether classes of a module may be made."""
    return any(module == name or module.startswith(f"{name}.") for name in ALLOWED)


def dump(root: object, given: Mapping[str, object]) -> bytes:
    """The graph below an object; those ``given`` by name are left out. Raises ``CheckpointError`` for what is of no
    class that may be restored."""
    return _Writer(given).written(root)


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


def _dtype(dtype: np.dtype[Any]) -> str:
    if dtype.kind not in "biuf" or dtype.itemsize > 8:
        raise CheckpointError(f"an array of {dtype} cannot be restored")
    return dtype.str


class _Writer:
    def __init__(self, given: Mapping[str, object]) -> None:
        self._pack: Callable[[object], bytes] = msgpack.Packer(use_bin_type=True).pack
        self._parts: list[bytes] = []
        self._numbers: dict[int, int] = {}
        #: What was made on the way is kept, so that its id stays its own.
        self._kept: list[object] = []
        self._unfilled: deque[tuple[int, Any]] = deque()
        self._classes: dict[type, tuple[int, _Layout]] = {}
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
        if kind in _PLAIN:
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
        if kind in _SHELLS:
            more = (value.maxlen,) if kind is deque else ()
            return self._shell(value, _SHELLS[kind], *more)
        if kind is np.ndarray:
            return self._array(value)
        if isinstance(value, np.generic):
            return self._make(value, SCALAR, _dtype(value.dtype), value.tobytes())
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
        plain = type(value) in _PLAIN or type(value) is int
        if not plain and not (type(value) is tuple and all(type(v) in _PLAIN or type(v) is int for v in value)):
            raise CheckpointError(f"a frozen set of {type(value).__qualname__} cannot be restored")
        return self._value(value)

    def _class(self, cls: type) -> tuple[int, _Layout]:
        known = self._classes.get(cls)
        if known is None:
            if not allowed(cls.__module__):
                raise CheckpointError(f"a {cls.__module__}.{cls.__qualname__} cannot be restored: not on the list")
            layout = _layout(cls)
            known = self._classes[cls] = len(self._classes), layout
            self._put(CLASS, cls.__module__, cls.__qualname__, list(layout.slots))
        return known

    def _contents(self, holder: Any) -> Iterator[Any]:
        kind = type(holder)
        if kind is dict:
            for key, value in holder.items():
                yield self._value(key)
                yield self._value(value)
        elif kind in _SHELLS:
            yield from map(self._value, holder)
        else:
            layout = self._classes[kind][1]
            for name in layout.slots:
                yield self._value(getattr(holder, name)) if hasattr(holder, name) else _NOTHING
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
            array, ARRAY, memory, _dtype(array.dtype), list(array.shape), list(array.strides), offset,
            array.flags.writeable,
        )  # fmt: skip


class _Reader:
    def __init__(self, given: Mapping[str, object]) -> None:
        self._given = given
        self._made: list[Any] = []
        self._classes: list[tuple[type, _Layout]] = []
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
        layout = _layout(type(holder))
        for name, written in zip(layout.slots, contents, strict=False):
            if written != _NOTHING:
                object.__setattr__(holder, name, self._value(written))
        others = contents[len(layout.slots) :]
        if layout.open:
            vars(holder).update(zip(others[::2], map(self._value, others[1::2]), strict=True))
        elif others:
            raise CheckpointError(f"more attributes than a {type(holder).__qualname__} has")

    def _known_class(self, module: str, name: str, slots: list[str]) -> tuple[type, _Layout]:
        cls: Any = sys.modules.get(module) if allowed(module) else None
        for part in name.split("."):
            cls = vars(cls).get(part) if cls is not None else None
        if not isinstance(cls, type) or cls.__module__ != module:
            raise CheckpointError(f"{module:.80}.{name:.80} is no class that may be restored")
        layout = _layout(cls)
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
        _dtype(kind)
        buffer = self._value(memory)
        if not isinstance(buffer, np.ndarray):
            raise CheckpointError("an array of no memory")
        array: NDArray[Any] = np.ndarray(tuple(shape), kind, buffer, offset, tuple(strides))
        array.flags.writeable = writeable
        return array

    def _scalar(self, dtype: str, data: bytes) -> Any:
        kind = np.dtype(dtype)
        _dtype(kind)
        (value,) = np.frombuffer(data, dtype=kind)
        return value

    def _large(self, data: bytes) -> int:
        return int.from_bytes(data, "little", signed=True)

    def _deque(self, longest: int | None) -> deque[Any]:
        return deque(maxlen=longest)
