"""JSON Schemas of the messages: of the map that a payload holds, a bin being a base64 string in its place.

They ship beside this module as ``<schema>.v<version>.json``; ``python -m fleet_bus.schemas`` writes them anew.
"""

import json
from collections.abc import Mapping
from importlib import resources
from typing import Any, Final

from fleet_bus import codec
from fleet_bus.messages import (
    Assignment,
    Document,
    Event,
    ScenarioDocument,
    ServiceStatus,
    VehicleProfile,
)
from fleet_bus.messages import checkpoint as checkpoint_message
from fleet_bus.messages import journal as journal_message
from fleet_bus.messages import state as state_message
from fleet_bus.messages import tube as tube_message
from fleet_bus.messages.fields import FieldList

DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"

_DOCUMENTS: Final[tuple[type[Document], ...]] = (VehicleProfile, ScenarioDocument, Assignment, Event, ServiceStatus)


def generate() -> dict[str, str]:
    """File name to text of every schema."""
    schemas = {cls.encoding(): (cls.json_schema(), cls.MAX_BYTES) for cls in _DOCUMENTS}
    schemas[state_message.ENCODING] = (_state(), state_message.MAX_BYTES)
    for module, message in (
        (tube_message, tube_message.ReachTube),
        (journal_message, journal_message.JournalRound),
        (checkpoint_message, checkpoint_message.CheckpointPart),
    ):
        schemas[module.ENCODING] = (_listed(message, module.FIELDS), module.MAX_BYTES)
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


def _listed(message: type, fields: FieldList) -> dict[str, Any]:
    return _map(message.__name__, message, {field.key: field.json() for field in fields.fields})


def _state() -> dict[str, Any]:
    header: list[dict[str, Any]] = []
    offset = 0
    for number in state_message.HEADER:
        head = {"name": number.name, "type": number.type, "offset": offset, "description": number.meaning}
        header.append(head | number.span.array_json())
        offset += number.bytes
    padding = {"type": f"{state_message.PADDING} bytes", "offset": offset}
    header.append({"name": "padding", **padding, "description": "written as zero, ignored by readers"})
    offset += state_message.PADDING
    body = [
        {
            "name": field.name,
            "type": "f8",
            "shape": list(field.shape),
            "present": field.present,
            "description": field.meaning,
            **field.span.array_json(),
        }
        for field in state_message.BODY
    ]
    layout = {"byte-order": "little-endian", "header": header, "body-offset": offset, "body": body}
    data = {
        "title": "data", "description": "see x-layout", "type": "string", "contentEncoding": "base64",
        "x-dtype": "bytes", "x-shape": [f"{offset} + 8 k"], "x-layout": layout, "x-unit": "of the profile",
    }  # fmt: skip
    return _map("StateSample", state_message.StateSample, {"d": data})


def _map(title: str, message: type, properties: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "title": title,
        "description": (message.__doc__ or "").partition("\n")[0],
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }
