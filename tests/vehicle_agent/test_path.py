"""Paths drawn from a route."""

from typing import Any

import numpy as np

from vehicle_agent.path import SPACING, draw_path
from vehicle_agent.route import Route, load_route

FIELDS: dict[str, Any] = {
    "route": "corner",
    "duration": 10,
    "start": {"x": [0, 0], "y": [0, 0], "yaw": [0, 0]},
    "way_points": [
        {"x": 2, "y": 0, "speed": 0.5, "at": 3},
        {"x": 2, "y": 2, "speed": 1.0},
        {"x": 0, "y": 2, "speed": 1.0, "at": 8},
    ],
}


def test_a_path_runs_smoothly_from_start_to_end() -> None:
    path = draw_path(Route.model_validate(FIELDS), np.random.default_rng(0))
    np.testing.assert_array_equal(path.points[0], [0, 0])
    legs = np.hypot(*np.diff(path.points[: path.end], axis=0).T)
    np.testing.assert_allclose(legs, SPACING, rtol=0.01)
    np.testing.assert_allclose(path.points[path.end], [0, 2], atol=1e-12)
    turns = np.diff(np.unwrap(np.arctan2(*np.diff(path.points[: path.end], axis=0).T[::-1])))
    assert np.abs(turns).max() < 0.08
    assert (path.points[: path.end] <= 2).all()
    # After the end it goes on straight.
    np.testing.assert_allclose(path.points[path.end :, 1], 2, atol=0.02)


def test_times_and_speeds_belong_to_their_way_points() -> None:
    path = draw_path(Route.model_validate(FIELDS), np.random.default_rng(0))
    (first, at), (last, end) = path.deadlines
    assert (at, end) == (3.0, 8.0)
    # The curve cuts the first corner: it passes the middle of the Bézier piece around (2, 0).
    np.testing.assert_allclose(path.points[first], [1.5, 0.25], atol=0.02)
    assert abs(path.speeds[first] - 0.5) < 0.02
    assert abs(last - path.end) <= 1
    np.testing.assert_allclose(np.diff(path.elapsed), SPACING / path.speeds[:-1])


def test_vehicles_differ_and_some_are_mirrored() -> None:
    route = load_route("parking-lot")
    assert route.mirror is not None
    paths = [draw_path(route, np.random.default_rng(seed)) for seed in range(20)]
    starts = np.array([path.start for path in paths])
    assert len(np.unique(starts[:, 0])) == 20
    mirrored = starts[:, 0] > route.mirror
    assert 3 < mirrored.sum() < 17
    assert (np.cos(starts[mirrored, 2]) > -0.5).all()
    again = draw_path(route, np.random.default_rng(0))
    np.testing.assert_array_equal(again.points, paths[0].points)
