"""Routes: zones, margins, and what is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from fleet_bus.errors import UsageError
from vehicle_agent.route import Box, Disc, Ring, Route, Zone, load_route, route_names

FIELDS: dict[str, Any] = {
    "route": "test",
    "duration": "2 s",
    "start": {"x": [0, 0], "y": [0, 0], "yaw": [0, 0]},
    "way_points": [{"x": 1, "y": 0, "speed": 1}, {"x": 2, "y": 0, "speed": 1}],
}


def test_both_scenarios_of_the_paper_ship() -> None:
    assert route_names() == ("convoy", "intersection", "parking-lot", "roundabout")
    parking, roundabout = load_route("parking-lot"), load_route("roundabout")
    zones = {zone.name: zone for route in (parking, roundabout) for zone in route.zones}
    assert (parking.duration, roundabout.duration) == (40.0, 14.0)
    assert zones["P"] == Zone(name="P", start=0, end=25, box=Box(x=(-1.437, 1.998), y=(-1.590, 3.268)))
    assert zones["O"] == Zone(name="O", start=25, end=40, box=Box(y=(-1.665 - 1, -1.665 + 1)))
    assert zones["before"] == Zone(name="before", start=0, end=4, box=Box(y=(1.25, 3.25)))
    assert zones["roundabout"] == Zone(
        name="roundabout", start=4, end=10, disc=Disc(center=(0.307, 0.044), radius=1.429)
    )
    assert zones["after"] == Zone(name="after", start=10, end=14, box=Box(y=(-3.169, -1.169)))
    assert parking.margin == roundabout.margin == 0.03


def test_clearance() -> None:
    points = np.array([[0.0, 0.0], [0.9, 0.0], [2.0, 0.5]])
    box = Zone(name="b", start=0, end=1, box=Box(x=(-1, 1)))
    disc = Zone(name="d", start=0, end=1, disc=Disc(center=(0.0, 0.0), radius=1.0))
    np.testing.assert_allclose(box.clearance(points), [1.0, 0.1, -1.0])
    np.testing.assert_allclose(disc.clearance(points), [1.0, 0.1, 1 - np.hypot(2, 0.5)])
    ring = Zone(name="r", start=0, end=1, ring=Ring(center=(0.0, 0.0), radius=(0.5, 1.2)))
    np.testing.assert_allclose(ring.clearance(points), [-0.5, 0.3, 1.2 - np.hypot(2, 0.5)])


def test_windows_are_closed_and_widened_by_the_slack() -> None:
    zone = {"name": "z", "start": 0.1, "end": 0.3, "box": {"x": [0, 1]}}
    t = np.arange(6, dtype=np.float64) * 0.1  # 0.3 is not exactly 3 * 0.1
    inside = np.array([[0.5, 0.0]] * 6)
    for slack, watched in ((0.0, {1, 2, 3}), (0.1, {0, 1, 2, 3, 4})):
        route = Route.model_validate({**FIELDS, "zones": [zone], "slack": slack})
        assert route.obeyed(t, inside)
        for k in range(6):
            points = inside.copy()
            points[k] = 0.98, 0.0  # closer to the border than the margin
            assert route.obeyed(t, points) == (k not in watched)
    empty = Route.model_validate({**FIELDS, "zones": [{**zone, "start": 5, "end": 6}]})
    np.testing.assert_array_equal(empty.clearance(t, inside), [np.inf])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"zones": [{"name": "z", "start": 0, "end": 1}]}, "give one of box, disc and ring"),
        (
            {"zones": [{"name": "z", "start": 0, "end": 1, "box": {}, "ring": {"center": [0, 0], "radius": [1, 2]}}]},
            "give one of box, disc and ring",
        ),
        ({"zones": [{"name": "z", "start": 2, "end": 1, "box": {}}]}, "reversed"),
        ({"way_points": FIELDS["way_points"][:1]}, "way_points"),
        ({"duration": "forty"}, "duration"),
        ({"surprise": 1}, "surprise"),
        (
            {"way_points": [{"x": 1, "y": 0, "speed": 1, "at": 5}, {"x": 2, "y": 0, "speed": 1, "at": 4}]},
            "must increase",
        ),
    ],
)
def test_unsound_routes_are_refused(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = tmp_path / "route.yaml"
    path.write_text(yaml.safe_dump({**FIELDS, **changes}))
    with pytest.raises(UsageError, match=message):
        load_route(path)


def test_files_and_names(tmp_path: Path) -> None:
    path = tmp_path / "route.yaml"
    path.write_text(yaml.safe_dump(FIELDS))
    assert load_route(path).route == "test"
    with pytest.raises(UsageError, match="there are convoy, intersection, parking-lot, roundabout"):
        load_route("motorway")
    with pytest.raises(UsageError, match="cannot be read"):
        load_route(tmp_path / "missing.yaml")
    path.write_text("[")
    with pytest.raises(UsageError, match="cannot be read"):
        load_route(path)
