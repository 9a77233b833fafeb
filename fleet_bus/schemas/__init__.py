"""JSON Schemas of the messages: of the map that a payload holds, a bin being a base64 string in its place.

They ship beside this module as ``<schema>.v<version>.json``; ``python -m fleet_bus.schemas`` writes them anew.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any, Final

from fleet_bus import codec, keys
from fleet_bus.messages import (
    Assignment,
    Document,
    Event,
    Label,
    ScenarioDocument,
    ServiceStatus,
    VehicleProfile,
    ranges,
)
from fleet_bus.messages import state as state_message
from fleet_bus.messages import tube as tube_message
from fleet_bus.messages.methods import FROM_LIMITS, TUBE_METHODS

DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"

_DOCUMENTS: Final[tuple[type[Document], ...]] = (VehicleProfile, ScenarioDocument, Assignment, Event, ServiceStatus)
_TEXT: Final = {"type": "string"}
_NAMES: Final = {"type": "array", "items": _TEXT, "minItems": 1, "maxItems": 32}
_ID: Final = {"type": "string", "pattern": f"^{keys.ID_PATTERN.pattern}$"}


@dataclass(frozen=True, slots=True)
class Field:
    """One entry of a map: its short key, what it is called, its JSON Schema, unit and meaning."""

    key: str
    name: str
    schema: Mapping[str, Any]
    unit: str
    meaning: str


def _integer(span: ranges.Range) -> dict[str, Any]:
    return {"type": "integer", **span.json()}


def _number(span: ranges.Range) -> dict[str, Any]:
    return {"type": "number", **span.json()}


def _bin(dtype: str, *shape: str, span: ranges.Range | None = None) -> dict[str, Any]:
    found = {"type": "string", "contentEncoding": "base64", "x-dtype": dtype, "x-shape": list(shape)}
    return found if span is None else {**found, **_extra(span)}


def _sets(dtype: str, *shape: str) -> dict[str, Any]:
    return _bin(dtype, *shape, span=ranges.SET_VALUE)


def _extra(span: ranges.Range) -> dict[str, Any]:
    """The range of the numbers of an array, which JSON Schema has no words for."""
    return {f"x-{word}": limit for word, limit in span.json().items()}


def _list(*items: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "array", "prefixItems": list(items), "items": False, "minItems": len(items)}


_INDEX: Final = _integer(ranges.INDEX)
_STEP: Final = _integer(ranges.STEP)
_COUNT: Final = _integer(ranges.COUNTER)
_TIMES: Final = _bin("<i8", "h", span=ranges.AHEAD)
_AREAS: Final = _bin("<f8", "h", span=ranges.AREA)

#: The header of the bin of a state: offset in bytes, type, name, meaning. All numbers are little-endian.
STATE_HEADER: Final[tuple[tuple[int, str, str, str], ...]] = (
    (0, "u8", "epoch", "id of this start of the agent"),
    (8, "u8", "seq", "counts the samples of one epoch from 0; a gap means lost samples"),
    (16, "i8", "t", "sample time, ns since the Unix epoch"),
    (24, "u4", "flags", "sum of 1 input missing, 2 new trajectory, 4 carries its own bound, 8 history"),
    (28, "u2", "n", "number of states"),
    (30, "u2", "m", "number of inputs"),
    (32, "u2", "plan", "number of planned inputs after u, 0 for no plan"),
    (34, "u2", "reserved", "zero"),
    (36, "4 bytes", "padding", "written as zero, ignored by readers"),
)

#: What follows the header, each an array of f8 in C order: name, shape, when it is there, meaning.
STATE_BODY: Final[tuple[tuple[str, tuple[str, ...], str, str], ...]] = (
    ("x", ("n",), "always", "filtered state, in the order and units of the profile"),
    ("u", ("m",), "always", "input in force from t on; zeros if the flags say that it is missing"),
    ("bound", ("n",), "flags & 4", "half-widths of the error of x, not negative"),
    ("plan", ("plan", "m"), "plan > 0", "inputs that will follow u, one row per sample time"),
    ("plan_tolerance", ("m",), "plan > 0", "half-widths around the rows of the plan, not negative"),
)

TUBE_FIELDS: Final[tuple[Field, ...]] = (
    Field("v", "vehicle", _ID, "", "id of the vehicle, the same as in the key"),
    Field("e", "epoch", _integer(ranges.EPOCH), "", "epoch of the sample that the tube starts from"),
    Field("s", "seq", _integer(ranges.SEQ), "", "seq of that sample"),
    Field("t", "t", _integer(ranges.TIME), "ns", "time of that sample"),
    Field("T", "times", _TIMES, "ns", "times of the h steps, 1 to 1000 of them, since the Unix epoch"),
    Field("x", "state names", _NAMES, "", "names of the n states, in order"),
    Field("p", "position", _list(_INDEX, _INDEX), "", "indices of the two position states"),
    Field("m", "method", {"enum": list(TUBE_METHODS)}, "", f"how the sets came about; {FROM_LIMITS}: without a model"),
    Field("l", "label", {"enum": [str(label) for label in Label]}, "", "what the tube claims"),
    Field("c", "center", _sets("<f8", "h", "n"), "of the state", "center of the set of each step"),
    Field("g", "generators", _sets("<f4", "h", "n", "g"), "of the state", "{c + G b : |b_i| <= 1} contains the set"),
    Field("h", "hull", _sets("<f4", "h", "2", "n"), "of the state", "lower, then upper bounds, relative to the center"),
    Field(
        "o", "outline", _sets("<f4", "h", "K", "2"), "of the position",
        "vertices of a convex polygon around the position set, counter-clockwise, relative to the center",
    ),
    Field("a", "area", _AREAS, "squared position", "upper bound of the area of the position set"),
    Field("af", "area_free", _AREAS, "squared position", "the same without side information"),
    Field(
        "k", "cuts",
        {"type": "array", "items": _list(_TEXT, _TEXT, _STEP, _STEP)},
        "", "[scenario, predicate, first step, last step] of each predicate that made sets smaller; steps count from 1",
    ),
    Field("n", "notes", {"type": "array", "items": _TEXT}, "", "limitations in words, such as 'rank deficient'"),
    Field("vd", "verdicts", {"type": "object", "additionalProperties": _TEXT}, "", "requirement to verdict; empty"),
    Field(
        "au", "audit", _list(
            _COUNT, _COUNT, _number(ranges.MISS), _COUNT, _COUNT, _COUNT
        ),
        "–, –, of the state, –, –, –",
        "one-step predictions checked, how many held, by how much the last miss lay outside; of the newest (at most "
        "1000) how many there are, how many held, and how many misses among them the confidence explains",
    ),
    Field("sv", "server", _TEXT, "", "id of the server that computed the tube"),
    Field("se", "server_epoch", _integer(ranges.EPOCH), "ns", "when that server started"),
    Field("ct", "compute_seconds", _number(ranges.DURATION), "s", "time that the batch with this tube took to compute"),
)  # fmt: skip


def generate() -> dict[str, str]:
    """File name to text of every schema."""
    schemas = {cls.encoding(): (cls.json_schema(), cls.MAX_BYTES) for cls in _DOCUMENTS}
    schemas[state_message.ENCODING] = (_state(), state_message.MAX_BYTES)
    schemas[tube_message.ENCODING] = (_map("ReachTube", tube_message.ReachTube, TUBE_FIELDS), tube_message.MAX_BYTES)
    files = {}
    for encoding, (schema, limit) in sorted(schemas.items()):
        name = encoding.removeprefix(f"{codec.MEDIA_TYPE};")
        head = {"$schema": DIALECT, "$id": f"urn:fleet-reach:{name}", "x-encoding": encoding, "x-max-bytes": limit}
        files[f"{name}.json"] = json.dumps(head | schema, indent=2, ensure_ascii=False) + "\n"
    return files


def shipped() -> dict[str, str]:
    """File name to text of every schema that lies beside this module."""
    folder = resources.files(__name__)
    found = (entry for entry in folder.iterdir() if entry.name.endswith(".json"))
    return {entry.name: entry.read_text(encoding="utf-8") for entry in sorted(found, key=lambda entry: entry.name)}


def _state() -> dict[str, Any]:
    header = [
        {"name": name, "type": kind, "offset": offset, "description": meaning, **_header_range(name)}
        for offset, kind, name, meaning in STATE_HEADER
    ]
    body = [
        {
            "name": name,
            "type": "f8",
            "shape": list(shape),
            "present": present,
            "description": meaning,
            **_extra(state_message.NUMBERS[name]),
        }
        for name, shape, present, meaning in STATE_BODY
    ]
    layout = {"byte-order": "little-endian", "header": header, "body-offset": 40, "body": body}
    field = Field("d", "data", {**_bin("bytes", "40 + 8 k"), "x-layout": layout}, "of the profile", "see x-layout")
    return _map("StateSample", state_message.StateSample, (field,))


def _header_range(name: str) -> dict[str, Any]:
    span = state_message.HEADER.get(name)
    return {} if span is None else _extra(span)


def _map(title: str, message: type, fields: Sequence[Field]) -> dict[str, Any]:
    properties = {}
    for field in fields:
        unit = {"x-unit": field.unit} if field.unit else {}
        properties[field.key] = {"title": field.name, "description": field.meaning, **field.schema, **unit}
    return {
        "title": title,
        "description": (message.__doc__ or "").partition("\n")[0],
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }
