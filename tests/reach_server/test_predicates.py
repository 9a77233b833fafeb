"""Predicates as cuts: nothing that obeys them is lost, and they act when they hold and not before."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely import Point, Polygon

from fleet_bus.messages import VehicleProfile, parse_profile
from reach_server.predicates import DISC_TANGENTS, activity, compile_cuts, tangents
from reach_server.windows import Floats
from side_info import Scenario, ScenarioError
from tests.reach_server.ugly import moderate

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


@pytest.mark.parametrize("count", [4, 8, DISC_TANGENTS, 64])
@pytest.mark.parametrize(("center", "radius"), [((0.0, 0.0), 1.0), ((0.3, -2.0), 1.4), ((1e4, -1e4), 1e-2)])
def test_tangents_hold_the_disc_and_little_else(center: tuple[float, float], radius: float, count: int) -> None:
    normals, bounds = tangents(np.array(center), radius, count)
    angle = np.linspace(0, 2 * np.pi, 1000)
    disc = np.array(center) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert (disc @ normals.T <= bounds + 1e-12 * np.abs(center).sum()).all()
    # The tangents touch: none is farther out than the disc.
    np.testing.assert_allclose((disc @ normals.T).max(axis=0), bounds, atol=1e-4 * radius)
    if count == DISC_TANGENTS:
        far = 10 * radius
        polygon = Polygon(np.array(center) + far * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]))
        for normal, bound in zip(normals, bounds, strict=True):
            side = np.array([-normal[1], normal[0]])
            foot = bound * normal + (np.array(center) @ side) * side
            corners = [foot - far * side, foot + far * side, foot + far * side - 2 * far * normal,
                       foot - far * side - 2 * far * normal]  # fmt: skip
            polygon = polygon.intersection(Polygon(corners))
        assert polygon.area <= 1.02 * np.pi * radius**2
        assert polygon.area >= Point(*center).buffer(radius).area


@moderate
@given(st.integers(0, 2**32 - 1))
def test_cuts_never_lose_a_state_that_obeys(seed: int) -> None:
    rng = np.random.default_rng(seed)
    made = scenario(
        "always[0:9 s](ring and lane and half)",
        "{ring: {disc: {center: {x1: 0.3, x2: -2.0}, radius: 1.4}}, "
        'lane: "abs(x1 + 2*x2 + 3) <= 1.5", half: "x2 - 0.5*x1 <= -1.5"}',
    )
    table = compile_cuts([made], PROFILE)
    states = rng.normal(size=(300, 3)) * [5.0, 1.5, 1.5] + [0.0, 0.3, -2.0]
    angle = rng.uniform(0, 2 * np.pi, 50)
    states[:50, 1:] = [0.3, -2.0] + 1.4 * np.stack([np.cos(angle), np.sin(angle)], axis=1) * (1 - 1e-12)
    x1, x2 = states[:, 1], states[:, 2]
    obeys = (
        (np.hypot(x1 - 0.3, x2 + 2.0) <= 1.4) & (np.abs(x1 + 2 * x2 + 3) <= 1.5) & (x2 - 0.5 * x1 <= -1.5)
    )  # fmt: skip
    heights = states @ table.normal.T
    kept = ((table.lower <= heights + 1e-12) & (heights <= table.upper + 1e-12)).all(axis=1)
    assert not (obeys & ~kept).any()
    # And what is kept obeys, but for what the tangents leave.
    worst = np.hypot(x1 - 0.3, x2 + 2.0)[kept].max(initial=0.0)
    assert worst <= 1.4 / np.cos(np.pi / DISC_TANGENTS) + 1e-9
    assert (np.abs(x1 + 2 * x2 + 3)[kept] <= 1.5 + 1e-9).all()


def test_regions_become_strips_over_the_states_of_the_profile() -> None:
    table = compile_cuts([scenario("always[0:9 s](P)", "{P: {box: {x1: [-1, 2], x2: [0, 5]}}}")], PROFILE)
    np.testing.assert_array_equal(table.normal, [[0, 1, 0], [0, 0, 1]])
    np.testing.assert_array_equal([table.lower, table.upper], [[-1, 0], [2, 5]])
    assert table.plane == (1, 2)
    assert table.scenario == ("s", "s")
    disc = compile_cuts([scenario("always[0:9 s](ring)", DISC)], PROFILE)
    assert disc.count == DISC_TANGENTS // 2
    np.testing.assert_array_equal(disc.normal[:, 0], 0.0)


def test_both_coordinates_of_a_disc_may_mean_the_same_state() -> None:
    same = PROFILE.model_copy(update={"maps_to": {"x1": "east", "x2": "east"}})
    table = compile_cuts([scenario("always[0:9 s](ring)", "{ring: {disc: {center: {x1: 1, x2: 0}, radius: 1}}}")], same)
    # (s - 1)² + s² <= 1 for s from 0 to 1
    for s in (0.0, 0.5, 1.0):
        heights = table.normal @ [0.0, s, 0.0]
        assert ((table.lower <= heights + 1e-9) & (heights <= table.upper + 1e-9)).all()


def times(*seconds: float) -> list[int]:
    return [round(s * 1e9) for s in seconds]


@pytest.mark.parametrize(
    ("slack", "expected"),
    [
        (0.0, [False, True, True, True, False, False]),
        (0.5, [False, False, True, False, False, False]),
        (2.0, [False] * 6),
    ],
)
def test_windows_include_their_ends_and_shrink_by_the_slack(slack: float, expected: list[bool]) -> None:
    made = scenario("always[1:3 s](P)", "{P: {box: {x1: [-1, 2]}}}")
    table = compile_cuts([made], PROFILE)
    elapsed = np.array(times(0.999999999, 1.0, 2.0, 3.0, 3.000000001, 60.0))
    found = activity(table, {"s": made}, "s", elapsed, round(slack * 1e9))
    np.testing.assert_array_equal(found[:, 0], expected)


def test_only_the_cuts_of_the_scenario_asked_for_are_active() -> None:
    first = scenario("always[0:9 s](P)", "{P: {box: {x1: [-1, 2]}}}", "first")
    second = scenario("always[0:1 s](ring) and always[5:9 s](ring)", DISC, "second")
    table = compile_cuts([first, second], PROFILE)
    by_name = {"first": first, "second": second}
    found = activity(table, by_name, "second", np.array([times(0.0, 3.0), times(5.0, 9.0)]), 0)
    assert found.shape == (2, 2, table.count)
    own: Floats = np.array([owner == "second" for owner in table.scenario], dtype=np.float64)
    np.testing.assert_array_equal(found.any(axis=(0, 1)), own.astype(bool))
    np.testing.assert_array_equal(found.sum(axis=2), [[8, 0], [8, 8]])


def test_states_that_the_profile_does_not_have_are_refused() -> None:
    without = PROFILE.model_copy(update={"maps_to": {}})
    with pytest.raises(ScenarioError, match="maps_to"):
        compile_cuts([scenario("always[0:9 s](ring)", DISC)], without)


def test_no_scenario_is_no_cut() -> None:
    table = compile_cuts((), PROFILE)
    assert table.count == 0
    assert table.normal.shape == (0, 3)
