"""The offboard reach server: data windows, models, sets, tubes, audit, and the process around them."""

from fleet_bus.messages import VehicleProfile
from reach_server.engine import Engine
from reach_server.results import Tubes
from reach_server.windows import SampleBatch, Window

__all__ = ["Engine", "SampleBatch", "Tubes", "VehicleProfile", "Window"]
