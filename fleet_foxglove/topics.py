"""What is shown to Foxglove and what is recorded for it: topics, frames, and a message as bytes with its schema."""

from typing import Any, Final, NamedTuple

#: One entity a vehicle, and one for its heading (``foxglove.SceneUpdate``).
SCENE: Final = "/fleet/scene"
#: One entity a scenario: the outlines of its regions (``foxglove.SceneUpdate``).
REGIONS: Final = "/fleet/regions"
#: From ``world`` to the frame of each vehicle (``foxglove.FrameTransform``).
TRANSFORMS: Final = "/fleet/transforms"
#: From ``world`` to the frame ``fleet`` (``foxglove.FrameTransform``).
ORIGIN: Final = "/fleet/origin"
#: What can be plotted, of one vehicle a message (JSON).
NUMBERS: Final = "/fleet/numbers"
#: Events of vehicles and services (``foxglove.Log``).
LOG: Final = "/fleet/log"

#: Where positions are what the vehicles say; and the same, moved to where the fleet is, for a camera to look at.
WORLD: Final = "world"
FLEET: Final = "fleet"


def vehicle_frame(vehicle: str) -> str:
    """Name of the frame of a vehicle: its measured position, x along its heading."""
    return f"vehicle/{vehicle}"


class SceneMessage(NamedTuple):
    """A message as Foxglove gets it, with all that a recording keeps of its schema."""

    topic: str
    schema_name: str
    schema_encoding: str
    schema_data: bytes
    message_encoding: str
    payload: bytes
    t_ns: int
    """When what it shows came here, or was taken where that is not known: Unix ns."""


def _number(unit: str, meaning: str) -> dict[str, Any]:
    return {"type": "number", "description": f"{meaning}, {unit}" if unit else meaning}


def _text(meaning: str) -> dict[str, Any]:
    return {"type": "string", "description": meaning}


#: JSON Schema of ``NUMBERS``.
NUMBERS_SCHEMA: Final[dict[str, Any]] = {
    "title": "fleet.numbers",
    "type": "object",
    "properties": {
        "timestamp": {
            "title": "time",
            "type": "object",
            "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
            "description": "when the sample was taken that the tube starts from",
        },
        "vehicle": _text("id of the vehicle"),
        "label": _text("what the tube claims"),
        "method": _text("how the sets came about"),
        "server": _text("id of the server"),
        "area": _number("squared position", "area of the position set of the last step"),
        "area_free": _number("squared position", "the same without side information"),
        "first_area": _number("squared position", "area of the position set of the first step"),
        "coverage": {
            "type": ["number", "null"],
            "description": "part of the newest one-step predictions that held; null before the first",
        },
        "checked": _number("", "one-step predictions checked"),
        "misses": _number("", "how many of those did not hold"),
        "compute_ms": _number("ms", "time that the batch with this tube took to compute"),
        "age_ms": {
            "type": ["number", "null"],
            "description": "from the sample's stamp to the arrival of the tube here, ms, if the clocks agree",
        },
        "cuts": _number("", "predicates of scenarios that made sets smaller"),
        "verdicts": {
            "type": "array",
            "items": {"type": "object", "properties": {"name": {"type": "string"}, "verdict": {"type": "string"}}},
            "description": "requirements that are watched, and what is known of them",
        },
    },
}
