"""What happens with every sample is told a few times, and then how often it was."""

from fleet_bus.messages import EventKind
from reach_server.data.events import EngineEvent
from reach_server.service.event_limit import MOST, PERIOD, EventLimit


def event(vehicle: str = "a", kind: EventKind = EventKind.JUMP) -> EngineEvent:
    return EngineEvent(kind, vehicle, 1, "the pose jumped")


def test_a_flood_of_one_kind_about_one_vehicle_is_held_back_and_counted() -> None:
    limit = EventLimit()
    told = [limit.admit(event(), 0.05 * k) for k in range(500)]
    # 25 s: three periods.
    assert len([e for e in told if e is not None]) == 3 * MOST
    assert limit.withheld == 500 - 3 * MOST
    later = limit.admit(event(), 100.0)
    assert later is not None
    held = [e.message for e in (*told, later) if e is not None and "more before" in e.message]
    assert sum(int(message.split("(and ")[1].split()[0]) for message in held) == limit.withheld


def test_other_kinds_and_vehicles_are_told() -> None:
    limit = EventLimit()
    for _ in range(100):
        limit.admit(event(), 0.0)
    assert limit.admit(event(kind=EventKind.GLITCH), 0.0) is not None
    assert limit.admit(event("b"), 0.0) is not None
    assert limit.admit(event(), PERIOD) is None
    limit.forget("a")
    assert limit.admit(event(), PERIOD) == event()
