"""The offboard reach server: data windows, models, sets, tubes, audit, and the process around them.

Names come when they are asked for: ``import reach_server.sets`` loads no network and no model.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fleet_bus.messages import VehicleProfile
    from reach_server.data.window import SampleBatch, Window
    from reach_server.engine import Engine, Tubes

__all__ = ["Engine", "SampleBatch", "Tubes", "VehicleProfile", "Window"]

_HOMES = {
    "Engine": "reach_server.engine",
    "SampleBatch": "reach_server.data.window",
    "Tubes": "reach_server.engine",
    "VehicleProfile": "fleet_bus.messages",
    "Window": "reach_server.data.window",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
