"""The fields of a binary message as one list: what is packed, read, checked and described follows from it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from fleet_bus import codec
from fleet_bus.messages.kinds import Array, Kind, Sizes
from fleet_bus.messages.ranges import Range


@dataclass(frozen=True, slots=True)
class Field:
    """One field: its short key, the attribute of the message, what it holds, unit and meaning."""

    key: str
    name: str
    kind: Kind
    unit: str
    meaning: str

    def json(self) -> dict[str, Any]:
        """JSON Schema with title and description."""
        unit = {"x-unit": self.unit} if self.unit else {}
        return {"title": self.name, "description": self.meaning, **self.kind.json(), **unit}


class FieldList:
    """The fields of a message in their order, which is that of the sizes: what finds one out stands first."""

    def __init__(self, *fields: Field) -> None:
        self.fields: Final = fields
        self._types: Final = {field.key: field.kind.types for field in fields}
        self._packers: Final = [(field.key, field.name, field.kind.pack) for field in fields]
        arrays: dict[Range, list[Field]] = {}
        for field in fields:
            if isinstance(field.kind, Array):
                arrays.setdefault(field.kind.span, []).append(field)
        #: Arrays of one range are looked through together, which takes a third of the time.
        self._arrays: Final = [(span, [(f.key, f.name) for f in found]) for span, found in arrays.items()]
        self._others: Final = [
            (f.key, f.name, f.kind.check) for f in fields if f.kind.spans and not isinstance(f.kind, Array)
        ]

    def pack(self, message: object) -> dict[str, Any]:
        """What msgpack packs of a message; raise ``MessageError`` (not_finite, range) for a number out of range."""
        self.check(message)
        return {key: pack(getattr(message, name)) for key, name, pack in self._packers}

    def read(self, packed: Mapping[str, Any]) -> dict[str, Any]:
        """Values by attribute of what came; raise ``MessageError`` with the reason for what is no such message.

        Whether the numbers lie in their ranges, and are numbers at all, ``check`` tells.
        """
        codec.check_fields(packed, self._types)
        sizes: Sizes = {}
        return {field.name: field.kind.read(field.key, packed[field.key], sizes) for field in self.fields}

    def check(self, message: object) -> None:
        """Raise ``MessageError`` (not_finite, range) unless every number of a message lies in its range."""
        for key, name, check in self._others:
            check(key, getattr(message, name))
        for span, fields in self._arrays:
            if len(fields) == 1:
                span.check_array(fields[0][0], getattr(message, fields[0][1]))
            else:
                span.check_arrays({key: getattr(message, name) for key, name in fields})
