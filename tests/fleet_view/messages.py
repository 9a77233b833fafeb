"""Messages of a small fleet, and a view that they are fed to by a clock of the test's own."""

from typing import Any

from fleet_bus import keys
from fleet_bus.messages import Event, EventKind, ReachTube, ServiceStatus, StateFlag, VehicleProfile
from fleet_bus.messages.state import ENCODING as STATE
from fleet_bus.messages.tube import ENCODING as TUBE
from fleet_bus.pubsub import Received
from fleet_view import Feed, FleetView
from tests.fleet_bus.messages.examples import T0, a_profile, a_sample, a_tube
from tests.memory_bus import Time


def status_of(instance: str = "reach-1", **changes: Any) -> ServiceStatus:
    return ServiceStatus(kind=changes.pop("kind", "reach"), instance=instance, t=T0, started=T0, **changes)


def event_of(vehicle: str | None = "svea1", kind: EventKind = EventKind.MISS, t: int = T0, **changes: Any) -> Event:
    message = changes.pop("message", f"{kind} of {vehicle}")
    return Event(kind=kind, vehicle=vehicle, t=t, source="reach-1", message=message, **changes)


class Fleet:
    """A view with its feed, a clock, and what puts messages in."""

    def __init__(self, **options: Any) -> None:
        self.time = Time(now=100.0)
        self.view = FleetView(**options)
        self.feed = Feed(self.view, self.time)

    @property
    def now(self) -> float:
        return self.time.now

    def wait(self, seconds: float) -> None:
        self.time.now += seconds

    def put(self, key: str, payload: bytes, encoding: str) -> None:
        self.feed.arrived(Received(key, payload, encoding, None))
        self.feed.take_in()

    def tube(self, vehicle: str = "svea1", **changes: Any) -> ReachTube:
        tube = a_tube(vehicle=vehicle, **changes)
        self.put(keys.tube(vehicle), tube.encode(), TUBE)
        return tube

    def sample(self, vehicle: str = "svea1", *, history: bool = False) -> None:
        flags = StateFlag.HISTORY if history else StateFlag.NONE
        self.put(keys.state(vehicle), a_sample(flags=flags).encode(), STATE)

    def profile(self, vehicle: str = "svea1", profile: VehicleProfile | None = None) -> None:
        self.put(keys.profile(vehicle), (profile or a_profile()).encode(), VehicleProfile.encoding())

    def status(self, instance: str = "reach-1", **changes: Any) -> None:
        status = status_of(instance, **changes)
        self.put(keys.service_status(status.kind, instance), status.encode(), ServiceStatus.encoding())

    def event(self, vehicle: str | None = "svea1", **changes: Any) -> Event:
        event = event_of(vehicle, **changes)
        key = keys.service_event("reach", "reach-1") if vehicle is None else keys.event(vehicle)
        self.put(key, event.encode(), Event.encoding())
        return event
