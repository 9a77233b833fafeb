"""The document of ``fleet evaluate --json``."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from fleet_bus.messages import VehicleProfile
from fleet_lab.evaluation.figures import ROLLING, MethodFigures


def as_json(
    figures: Mapping[str, MethodFigures], recordings: Sequence[str], profile: VehicleProfile, horizon: int
) -> dict[str, Any]:
    """Figures by method with what they are about."""
    return {
        "recordings": list(recordings),
        "profile": profile.vehicle_class,
        "horizon": horizon,
        "confidence": profile.confidence,
        "rolling_checks": ROLLING,
        "methods": {name: _method(f) for name, f in figures.items()},
    }


def _method(figures: MethodFigures) -> dict[str, Any]:
    document = asdict(figures)
    for part in ("steps", "runs", "rolling", "events"):
        document[part] = [dict(entry) for entry in document[part]]
    for entry in document["rolling"]:
        entry["steps"] = {str(step): shares for step, shares in entry["steps"].items()}
    return document
