"""Messages of a made-up fleet, as they come from the bus."""

from collections.abc import Mapping, Sequence

import numpy as np

from fleet_bus import keys
from fleet_bus.messages import (
    Audit,
    Cut,
    Event,
    EventKind,
    Label,
    ReachTube,
    ServiceStatus,
    StateFlag,
    StateSample,
    VehicleProfile,
    parse_profile,
)
from fleet_bus.messages.state import ENCODING as STATE
from fleet_bus.messages.tube import ENCODING as TUBE
from fleet_bus.pubsub import Received

T0 = 1_700_000_000_000_000_000
SECOND = 1_000_000_000


def ring(radius: float, corners: int = 8) -> np.ndarray:
    """A regular polygon around 0, counter-clockwise (corners, 2)."""
    angle = 2 * np.pi * np.arange(corners) / corners
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


AUDIT = Audit(100, 99, 0.1, 100, 99, 3)


def tube(
    vehicle: str,
    *,
    at: tuple[float, float] = (0.0, 0.0),
    seq: int = 0,
    t: int = T0,
    steps: int = 3,
    corners: int = 8,
    radius: float = 0.5,
    label: Label = Label.GUARANTEED,
    server: str = "reach-1",
    verdicts: Mapping[str, str] | None = None,
    cuts: Sequence[Cut] = (),
    audit: Audit = AUDIT,
    epoch: int = 1,
) -> ReachTube:
    """A tube of four states whose sets are rings that grow, side by side along x."""
    n = 4
    center = np.zeros((steps, n))
    center[:, 0] = at[0] + 0.1 * np.arange(1, steps + 1)
    center[:, 1] = at[1]
    outline = np.stack([ring(radius * (k + 1) / steps, corners) for k in range(steps)])
    wide = np.full((steps, n), radius)
    area = np.pi * (radius * np.arange(1, steps + 1) / steps) ** 2
    return ReachTube(
        vehicle=vehicle, epoch=epoch, seq=seq, t=t, times=t + SECOND // 10 * np.arange(1, steps + 1),
        state_names=("x", "y", "yaw", "v"), position=(0, 1), method="set_membership", label=label, center=center,
        generators=np.zeros((steps, n, 2)), hull=np.stack([-wide, wide], axis=1), outline=outline, area=area,
        area_free=2 * area, cuts=tuple(cuts), verdicts=dict(verdicts or {}), audit=audit, server=server, server_epoch=1,
        compute_seconds=0.001,
    )  # fmt: skip


def of_tube(message: ReachTube, arrived: int = T0) -> Received:
    return Received(keys.tube(message.vehicle), message.encode(), TUBE, None, arrived_ns=arrived)


def of_state(
    vehicle: str,
    x: Sequence[float],
    *,
    seq: int = 0,
    t: int = T0,
    arrived: int = T0,
    epoch: int = 1,
    flags: StateFlag = StateFlag.NONE,
) -> Received:
    sample = StateSample(epoch=epoch, seq=seq, t=t, flags=flags, x=np.array(x, dtype=float), u=np.zeros(1))
    return Received(keys.state(vehicle), sample.encode(), STATE, None, arrived_ns=arrived)


PROFILE: VehicleProfile = parse_profile(
    {
        "class": "toy",
        "state": {"v": "m/s", "x": "m", "y": "m", "yaw": {"unit": "rad", "angle": True}},
        "inputs": {"u": {"unit": "1", "limits": [-1, 1], "rate": 1}},
        "sample_time": 0.1,
        "roles": {"position": ["x", "y"], "heading": "yaw"},
        "confidence": 0.9,
    }
)


def of_profile(vehicle: str, profile: VehicleProfile = PROFILE, arrived: int = T0) -> Received:
    return Received(keys.profile(vehicle), profile.encode(), VehicleProfile.encoding(), None, arrived_ns=arrived)


def of_status(
    instance: str = "reach-1", *, t: int = T0, arrived: int = T0, waiting: Mapping[str, str] | None = None
) -> Received:
    status = ServiceStatus(kind="reach", instance=instance, t=t, started=T0 - SECOND, waiting=dict(waiting or {}))
    key = keys.service_status("reach", instance)
    return Received(key, status.encode(), ServiceStatus.encoding(), None, arrived_ns=arrived)


def contradiction(vehicle: str, t: int = T0, scenario: str = "lot", message: str = "it left the lot") -> Event:
    return Event(
        kind=EventKind.CONTRADICTION, vehicle=vehicle, t=t, source="reach-1", message=message,
        details={"scenario": scenario, "predicate": "P", "elapsed": 1.0},
    )  # fmt: skip


def of_event(event: Event, arrived: int = T0) -> Received:
    key = keys.event(event.vehicle) if event.vehicle is not None else keys.service_event("reach", event.source)
    return Received(key, event.encode(), Event.encoding(), None, arrived_ns=arrived)
