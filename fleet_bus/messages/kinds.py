"""What a field of a binary message may hold: how it is packed, read, checked and described."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from re import Pattern
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fleet_bus import codec
from fleet_bus.errors import MessageError
from fleet_bus.messages.ranges import Range

#: By name, the sizes of arrays that have been found while the fields of one message are read in their order.
Sizes = dict[str, int]


class Kind(ABC):
    """What a field holds: as a value of the message, on the wire, and in JSON Schema."""

    #: Types that msgpack may give for it.
    types: ClassVar[tuple[type, ...]]

    @abstractmethod
    def pack(self, value: Any) -> Any:
        """What msgpack packs for a value."""

    @abstractmethod
    def read(self, key: str, packed: Any, sizes: Sizes) -> Any:
        """The value of what was packed, which is of the right type; raise ``MessageError`` if it cannot be one."""

    def check(self, key: str, value: Any) -> None:
        """Raise ``MessageError`` (not_finite, range) unless all numbers lie in their range; most kinds have none."""
        return None

    @abstractmethod
    def json(self) -> dict[str, Any]:
        """JSON Schema of what is packed."""

    @property
    def spans(self) -> Mapping[str, Range]:
        """Ranges of its numbers by where they stand in it; nothing stands for all that have no range of their own."""
        return {}


@dataclass(frozen=True)
class Whole(Kind):
    """An integer."""

    types = (int,)
    span: Range

    def pack(self, value: Any) -> int:
        """See ``Kind``."""
        return int(value)

    def read(self, key: str, packed: Any, sizes: Sizes) -> Any:
        """See ``Kind``."""
        return packed

    def check(self, key: str, value: Any) -> None:
        """See ``Kind``."""
        self.span.check(key, value)

    def json(self) -> dict[str, Any]:
        """See ``Kind``."""
        return {"type": "integer", **self.span.json()}

    @property
    def spans(self) -> Mapping[str, Range]:
        """See ``Kind``."""
        return {"": self.span}


@dataclass(frozen=True)
class Number(Kind):
    """A float; an integer will do on the wire."""

    types = (float, int)
    span: Range

    def pack(self, value: Any) -> float:
        """See ``Kind``."""
        return float(value)

    def read(self, key: str, packed: Any, sizes: Sizes) -> float:
        """See ``Kind``."""
        return float(packed)

    def check(self, key: str, value: Any) -> None:
        """See ``Kind``."""
        if not math.isfinite(value):
            raise MessageError("not_finite", f"{key} is {value}")
        self.span.check(key, value)

    def json(self) -> dict[str, Any]:
        """See ``Kind``."""
        return {"type": "number", **self.span.json()}

    @property
    def spans(self) -> Mapping[str, Range]:
        """See ``Kind``."""
        return {"": self.span}


@dataclass(frozen=True)
class Text(Kind):
    """A text: any, one of some ``options``, or what a ``pattern`` fits; ``make`` turns it into the value."""

    types = (str,)
    options: tuple[str, ...] = ()
    pattern: Pattern[str] | None = None
    make: Callable[[str], str] = str

    def pack(self, value: Any) -> str:
        """See ``Kind``."""
        return str(value)

    def read(self, key: str, packed: Any, sizes: Sizes) -> str:
        """See ``Kind``."""
        if self.options and packed not in self.options:
            raise MessageError("range", f"{key} is {packed!r:.40}, none of {list(self.options)}")
        if self.pattern is not None and self.pattern.fullmatch(packed) is None:
            raise MessageError("fields", f"{key} is {packed!r:.80}: expected {self.pattern.pattern}")
        return self.make(packed)

    def json(self) -> dict[str, Any]:
        """See ``Kind``."""
        if self.options:
            return {"enum": list(self.options)}
        return {"type": "string"} | ({} if self.pattern is None else {"pattern": f"^{self.pattern.pattern}$"})


@dataclass(frozen=True)
class Texts(Kind):
    """Texts, as many as ``count`` allows; that number is the ``size`` of arrays which have one entry for each."""

    types = (list,)
    count: Range | None = None
    size: str = ""

    def pack(self, value: Any) -> list[str]:
        """See ``Kind``."""
        return list(value)

    def read(self, key: str, packed: Any, sizes: Sizes) -> tuple[str, ...]:
        """See ``Kind``."""
        if not all(isinstance(text, str) for text in packed):
            raise MessageError("fields", f"{key!r} must hold texts")
        if self.count is not None and len(packed) not in self.count:
            raise MessageError("fields", f"{key!r} holds {len(packed)} texts: expected {self.count}")
        if self.size:
            sizes[self.size] = len(packed)
        return tuple(packed)

    def json(self) -> dict[str, Any]:
        """See ``Kind``."""
        most = {} if self.count is None else {"minItems": int(self.count.low), "maxItems": int(self.count.high)}
        return {"type": "array", "items": {"type": "string"}, **most}


@dataclass(frozen=True)
class TextMap(Kind):
    """Texts by name."""

    types = (dict,)

    def pack(self, value: Any) -> dict[str, str]:
        """See ``Kind``."""
        return dict(value)

    def read(self, key: str, packed: Any, sizes: Sizes) -> dict[str, str]:
        """See ``Kind``."""
        if not all(isinstance(text, str) for text in (*packed, *packed.values())):
            raise MessageError("fields", f"{key!r} must hold texts")
        found: dict[str, str] = packed
        return found

    def json(self) -> dict[str, Any]:
        """See ``Kind``."""
        return {"type": "object", "additionalProperties": {"type": "string"}}


@dataclass(frozen=True)
class Row(Kind):
    """A few values of known kinds, as a list on the wire; ``make`` puts them together and ``parts`` apart.

    Where ``below`` names a size, all of them are indices less than it.
    """

    types = (list,)
    items: tuple[Kind, ...]
    make: Callable[..., Any]
    parts: Callable[[Any], Sequence[Any]]
    below: str = ""

    def pack(self, value: Any) -> list[Any]:
        """See ``Kind``."""
        return [pack(part) for pack, part in zip(self._packs, self.parts(value), strict=True)]

    @cached_property
    def _packs(self) -> tuple[Callable[[Any], Any], ...]:
        return tuple(item.pack for item in self.items)

    def read(self, key: str, packed: Any, sizes: Sizes) -> Any:
        """See ``Kind``."""
        kinds = [item.types[0].__name__ for item in self.items]
        if not isinstance(packed, list) or len(packed) != len(self.items):
            raise MessageError("fields", f"{key!r} must hold {kinds}")
        for item, part in zip(self.items, packed, strict=True):
            if type(part) not in item.types:
                raise MessageError("fields", f"{key!r} holds {type(part).__name__} among what must be {kinds}")
        if self.below and not all(0 <= index < sizes[self.below] for index in packed):
            raise MessageError("range", f"{key} is {packed!r:.40}: expected indices below {sizes[self.below]}")
        return self.make(*(item.read(key, part, sizes) for item, part in zip(self.items, packed, strict=True)))

    def check(self, key: str, value: Any) -> None:
        """See ``Kind``."""
        parts = self.parts(value)
        for index, span in self._numbers:
            if parts[index] not in span:
                self.items[index].check(f"{key}[{index}]", parts[index])

    @cached_property
    def _numbers(self) -> tuple[tuple[int, Range], ...]:
        return tuple((index, item.spans[""]) for index, item in enumerate(self.items) if item.spans)

    def json(self) -> dict[str, Any]:
        """See ``Kind``."""
        items = [item.json() for item in self.items]
        return {"type": "array", "prefixItems": items, "items": False, "minItems": len(items)}

    @property
    def spans(self) -> Mapping[str, Range]:
        """See ``Kind``."""
        found: dict[str, Range] = {}
        for index, item in enumerate(self.items):
            for span in item.spans.values():
                if found.setdefault("", span) != span:
                    found[f"[{index}]"] = span
        return found


@dataclass(frozen=True)
class Rows(Kind):
    """Any number of rows."""

    types = (list,)
    row: Row

    def pack(self, value: Any) -> list[Any]:
        """See ``Kind``."""
        return [self.row.pack(row) for row in value]

    def read(self, key: str, packed: Any, sizes: Sizes) -> tuple[Any, ...]:
        """See ``Kind``."""
        return tuple(self.row.read(key, row, sizes) for row in packed)

    def check(self, key: str, value: Any) -> None:
        """See ``Kind``."""
        for row in value:
            self.row.check(key, row)

    def json(self) -> dict[str, Any]:
        """See ``Kind``."""
        return {"type": "array", "items": self.row.json()}

    @property
    def spans(self) -> Mapping[str, Range]:
        """See ``Kind``."""
        return self.row.spans


@dataclass(frozen=True)
class Array(Kind):
    """Numbers in a bin, in C order; ``shape`` holds numbers and names of sizes.

    A name that no field before has found out follows from the length of the bin, and must lie in ``count``.
    """

    types = (bytes,)
    dtype: str
    shape: tuple[str, ...]
    span: Range
    count: Range | None = None

    def pack(self, value: Any) -> bytes:
        """See ``Kind``."""
        return codec.to_bin(value, self.dtype)

    def read(self, key: str, packed: Any, sizes: Sizes) -> NDArray[Any]:
        """See ``Kind``; floats of 32 bits come as such of 64."""
        shape = [int(name) if name.isdigit() else sizes.get(name, -1) for name in self.shape]
        one = self._itemsize * abs(math.prod(shape))
        if -1 in shape:
            found = shape.index(-1)
            sizes[self.shape[found]] = shape[found] = len(packed) // one
            if self.count is not None and (len(packed) % one or shape[found] not in self.count):
                raise MessageError("shape", f"{key!r} holds {len(packed)} bytes: expected {self.count} times {one}")
            one *= shape[found]
        if len(packed) != one:
            raise MessageError("shape", f"{key!r} holds {len(packed)} bytes: {shape} of {self.dtype} has {one}")
        array = np.frombuffer(packed, dtype=self.dtype).reshape(shape)
        return array.astype(np.float64) if array.dtype == np.float32 else array

    @cached_property
    def _itemsize(self) -> int:
        return np.dtype(self.dtype).itemsize

    def check(self, key: str, value: Any) -> None:
        """See ``Kind``."""
        self.span.check_array(key, value)

    def json(self) -> dict[str, Any]:
        """See ``Kind``."""
        bin_ = {"type": "string", "contentEncoding": "base64", "x-dtype": self.dtype, "x-shape": list(self.shape)}
        return bin_ | self.span.array_json()

    @property
    def spans(self) -> Mapping[str, Range]:
        """See ``Kind``."""
        return {"": self.span}


@dataclass(frozen=True)
class Bytes(Kind):
    """A bin of bytes that are no numbers: as many times ``each`` bytes as the ``size`` says, at most ``most`` times."""

    types = (bytes,)
    each: int
    size: str
    most: int

    def pack(self, value: Any) -> bytes:
        """See ``Kind``."""
        return bytes(value)

    def read(self, key: str, packed: Any, sizes: Sizes) -> bytes:
        """See ``Kind``."""
        if len(packed) != self.each * (n := sizes.setdefault(self.size, len(packed) // self.each)) or n > self.most:
            raise MessageError("shape", f"{key!r} holds {len(packed)} bytes: expected {n} times {self.each}")
        return bytes(packed)

    def json(self) -> dict[str, Any]:
        """See ``Kind``."""
        return {"type": "string", "contentEncoding": "base64", "x-bytes": [self.size, self.each]}
