"""The tables of docs/reference/wire.md that follow from the lists of fields."""

import re
from collections.abc import Mapping
from typing import Final

from fleet_bus.messages import checkpoint, journal, ranges, tube
from fleet_bus.messages.fields import Field, FieldList
from fleet_bus.messages.kinds import Array, Bytes, Kind, Row, Rows, Text, TextMap, Texts, Whole
from fleet_bus.messages.ranges import Range
from fleet_bus.messages.state import BODY, HEADER, PADDING

#: Binary messages by name, with their lists of fields and the word for a field in the head of the table.
LISTED: Final[Mapping[str, tuple[FieldList, str]]] = {
    "ReachTube": (tube.FIELDS, "key"),
    "JournalRound": (journal.FIELDS, "key of a round"),
    "CheckpointPart": (checkpoint.FIELDS, "key of a part"),
}


def spans() -> dict[str, dict[str, Range]]:
    """The range of every number by message and field: ``*`` stands for any name, ``[]`` for any entry."""
    header = {field.name: field.span for field in HEADER}
    body = {field.name + "[]" * (field.name in header): field.span for field in BODY}
    listed = {
        name: {field.key + place: span for field in fields.fields for place, span in field.kind.spans.items()}
        for name, (fields, _) in LISTED.items()
    }
    return {"StateSample": header | body, **listed, **{name: dict(of) for name, of in ranges.FIELDS.items()}}


def tables() -> dict[str, list[str]]:
    """Head of each table to its rows."""
    header = []
    offset = 0
    for field in HEADER:
        header.append(f"| {offset} | {field.type} | `{field.name}` | {field.meaning} |")
        offset += field.bytes
    header.append(f"| {offset} | {PADDING} bytes | `padding` | written as zero, ignored by readers |")
    return {
        "| offset | type | name | meaning |": header,
        "| name | shape | there if | meaning |": [
            f"| `{field.name}` | ({', '.join(field.shape)}) | {field.present} | {field.meaning} |" for field in BODY
        ],
        **{
            f"| {word} | name | type | meaning |": [
                f"| `{field.key}` | {field.name} | {_type(field)} | {field.meaning} |" for field in fields.fields
            ]
            for fields, word in LISTED.values()
        },
        "| message | field | range |": [
            f"| {message} | `{field}` | {span} |"
            for message, fields in spans().items()
            for field, span in fields.items()
        ],
    }


def rewritten(page: str) -> str:
    """The page with the rows that its tables have by now; raise ``ValueError`` for one that is missing there."""
    for head, rows in tables().items():
        table = re.compile(rf"^({re.escape(head)}\n\|[ |-]+\|\n)(?:\|.*\n)*", re.M)
        text = "".join(f"{row}\n" for row in rows).replace("\\", r"\\")
        page, found = table.subn(rf"\g<1>{text}", page)
        if found != 1:
            raise ValueError(f"the page has {found} tables {head!r}, expected 1")
    return page


def _type(field: Field) -> str:
    found = _kind(field.kind)
    # In which unit a set is, its shape says.
    return found if not field.unit or field.unit.startswith("of the") else f"{found}, {field.unit}"


def _kind(kind: Kind) -> str:
    """What a field is on the wire, in short."""
    if isinstance(kind, Array):
        return f"bin {kind.dtype.removeprefix('<')} ({', '.join(kind.shape)})"
    if isinstance(kind, Bytes):
        return f"bin ({kind.size} times {kind.each} bytes)" if kind.each > 1 else f"bin ({kind.size} bytes)"
    if isinstance(kind, Row):
        return f"[{', '.join(_kind(item) for item in kind.items)}]"
    if isinstance(kind, Rows):
        return f"list of {_kind(kind.row)}"
    if isinstance(kind, Text) and kind.options:
        return " or ".join(f"`{option}`" for option in kind.options)
    names: Mapping[type, str] = {Text: "str", Texts: "list of str", TextMap: "map of str to str", Whole: "int"}
    return names.get(type(kind), "float")
