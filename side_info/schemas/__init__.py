"""JSON Schema of scenario documents, for editors and for who writes them by program.

It ships beside this module; ``python -m side_info.schemas`` writes it anew. What it cannot say (names that are
declared, formulas that parse) ``Scenario.parse`` checks.
"""

import json
from importlib import resources
from typing import Any, Final

from fleet_bus.schemas import DIALECT
from side_info.documents.document import ScenarioFields

FILE: Final = "scenario.schema.json"


def generate() -> str:
    """Text of the schema, of the document as it is read from YAML."""
    schema = _closed(ScenarioFields.model_json_schema(mode="validation"))
    head = {"$schema": DIALECT, "$id": "urn:fleet-reach:scenario"}
    return json.dumps(head | schema, indent=2, ensure_ascii=False) + "\n"


def _closed(schema: Any) -> Any:
    """The schema with maps that have keys of the given pattern only."""
    if isinstance(schema, list):
        return [_closed(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    closed = {key: _closed(part) for key, part in schema.items()}
    return closed | {"additionalProperties": False} if "patternProperties" in schema else closed


def shipped() -> str:
    """Text of the schema that lies beside this module."""
    return resources.files(__name__).joinpath(FILE).read_text(encoding="utf-8")
