"""The fleet as it is seen on the bus: what a viewer knows of vehicles, services, events and traffic, bounded in memory.

For terminals and pages alike: it draws nothing, and reads no clock that it is not handed.
"""

from fleet_view.feed import Feed
from fleet_view.snapshot import SORTS, Snapshot, VehicleRow
from fleet_view.traffic import Traffic
from fleet_view.view import FleetView, Refused, Service

__all__ = [
    "SORTS",
    "Feed",
    "FleetView",
    "Refused",
    "Service",
    "Snapshot",
    "Traffic",
    "VehicleRow",
]
