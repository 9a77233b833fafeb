"""A small vehicle class and scenarios for it."""

from fleet_bus.messages import VehicleProfile, parse_profile
from side_info import Scenario

PROFILE: VehicleProfile = parse_profile(
    {
        "class": "c", "state": {"v": "m/s", "east": "m", "north": "m"}, "sample_time": 0.1,
        "roles": {"position": ["east", "north"]}, "maps_to": {"x1": "east", "x2": "north"},
        "future_inputs": "learned",
    }
)  # fmt: skip


def scenario(assume: str, regions: str = "{}", name: str = "s") -> Scenario:
    return Scenario.parse(
        f"scenario: {name}\nversion: 1\nstate: {{x1: m, x2: m}}\ntime: {{zero: on_start, semantics: sampled}}\n"
        f"regions: {regions}\nassume: {assume}\n"
    )


DISC = "{ring: {disc: {center: {x1: 0.3, x2: -2.0}, radius: 1.4}}}"
