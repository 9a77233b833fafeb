"""True trajectories that obey a scenario stay in the tube that it cuts, and what leaves nothing is told."""

import numpy as np
import pytest
from numpy.typing import NDArray

from reach_server.data.input_sets import InputSets
from reach_server.numeric.types import FloatArray
from reach_server.predicates.cut_kinds import CutMethod
from reach_server.sets import support
from reach_server.sets.raw import RawSets
from reach_server.tube.recursion import Recursion
from side_info import DiscPredicate, LinearPredicate, Scenario
from tests.reach_server.drives import LAYOUT, PROFILE, SVEA, inside, noise
from tests.reach_server.tube.trajectories import (
    COUNT,
    HORIZON,
    WORLD,
    Side,
    assert_all_inside,
    cut_methods,
    only,
    spread,
    svea_model,
    svea_truth,
    tube_of,
    two_vehicles,
    world_model,
    world_truth,
)

BOX = """
scenario: box
version: 1
state: {{x1: m, x2: m}}
time: {{zero: on_start, semantics: sampled}}
regions:
  box: {{box: {{x1: [{0}, {1}], x2: [{2}, {3}]}}}}
  disc: {{disc: {{center: {{x1: {4}, x2: {5}}}, radius: {6}}}}}
  slope: "x1 + 0.5*x2 <= {7}"
assume: always[{8} ms:100 s](box) and always[{8} ms:100 s](disc) and always[{8} ms:100 s](slope)
"""


def scenario_around(points: FloatArray, active_from: int) -> Scenario:
    """Predicates that cut off a part of the end points (K, 2), from a step on."""
    low, high = np.quantile(points, 0.1, axis=0), np.quantile(points, 0.9, axis=0)
    middle = points.mean(axis=0)
    radius = np.quantile(np.linalg.norm(points - middle, axis=1), 0.8)
    slope = np.quantile(points[:, 0] + 0.5 * points[:, 1], 0.8)
    begin = round(active_from * SVEA.dt * 1000)
    return Scenario.parse(BOX.format(low[0], high[0], low[1], high[1], *middle, radius, slope, begin))


def obeys(points: FloatArray, scenario: Scenario) -> NDArray[np.bool_]:
    """Whether points (..., 2) obey every predicate of ``BOX``."""
    x, y = points[..., 0], points[..., 1]
    held = np.ones(x.shape, dtype=bool)
    for predicate in scenario.predicates:
        if isinstance(predicate, DiscPredicate):
            middle = np.array(list(predicate.center.values()))
            held &= np.linalg.norm(points - middle, axis=-1) <= predicate.radius
        else:
            assert isinstance(predicate, LinearPredicate)
            height = predicate.coefficients.get("x1", 0.0) * x + predicate.coefficients.get("x2", 0.0) * y
            held &= (predicate.lower <= height) & (height <= predicate.upper)
    return held


@cut_methods
@pytest.mark.parametrize("frame", ["world", "body"])
@pytest.mark.parametrize("active_from", [0, 4])
def test_trajectories_that_obey_the_scenario_stay_in_the_cut_tube(
    cuts: CutMethod, frame: str, active_from: int
) -> None:
    rng = np.random.default_rng(active_from)
    if frame == "world":
        profile, layout, model, process = WORLD.profile, WORLD.layout, world_model(1), WORLD.process
        measurement, y, past = 8 * WORLD.measurement, np.array([0.4, -0.3]), np.zeros((1, 1))
        center, half = np.zeros((HORIZON, 1)), np.full((HORIZON, 1), 0.6)
        u = spread(rng, center, half, 6 * COUNT)
        truth = world_truth(rng, y - noise(rng, measurement, 6 * COUNT), u, past[0])
    else:
        profile, layout, model, process = PROFILE, LAYOUT, svea_model(1), np.diag(SVEA.process_noise)
        measurement, y, past = np.diag([0.02, 0.02, 0.4, 0.2]), np.array([1.0, 2.0, 0.5, 0.8]), np.zeros((2, 2))
        center, half = np.tile([0.1, 0.8], (HORIZON, 1)), np.tile([0.3, 0.4], (HORIZON, 1))
        u = spread(rng, center, half, 6 * COUNT)
        truth = svea_truth(rng, y - noise(rng, measurement, 6 * COUNT), u, past)
    scenario = scenario_around(truth[:, active_from:, :2].reshape(-1, 2), active_from)
    obedient = obeys(truth[:, active_from:, :2], scenario).all(axis=1)
    assert obedient.sum() > 50
    inputs = InputSets(past[None], center[None], half[None])
    start = RawSets.zonotope(y[None], measurement[None])
    motion = Recursion(inputs, model, process, layout)
    tube = tube_of(start, motion, Side(scenario, profile), cuts)
    free = tube_of(start, motion)
    assert (tube.ended < 0).all()
    assert tube.active[:, active_from:].any()
    assert not tube.active[:, :active_from].any()
    assert_all_inside(tube, truth[obedient], rng)
    if cuts != "frobenius":
        d = np.concatenate([np.eye(layout.n), -np.eye(layout.n)])
        last, last_free = only(tube.steps[-1]), only(free.steps[-1])
        width, width_free = (
            support.constrained_support(s.center, s.generators, s.matrix, s.offset, d)[0]
            for s in (last, last_free)
        )  # fmt: skip
        assert (width + np.roll(width, layout.n))[0] < 0.9 * (width_free + np.roll(width_free, layout.n))[0]


@cut_methods
def test_cuts_that_leave_nothing_are_told_and_not_applied(cuts: CutMethod) -> None:
    side = Side(Scenario.parse(BOX.format(5, 6, 5, 6, 5.5, 5.5, 1, 20, 0)), WORLD.profile)
    start = RawSets.zonotope(np.zeros((2, 2)), np.array([0.1, 10.0])[:, None, None] * np.eye(2))
    cut = side.cut_all(start, np.ones((2, side.literals.count), dtype=bool), cuts)
    assert cut.empty[0].any()
    assert not cut.empty[1].any()
    assert cut.active[1].any()
    assert inside(cut.sets, 0, np.array([[0.1, 0.1], [-0.1, -0.1]]), np.random.default_rng(0)).all()


def test_conflicting_cuts_of_a_constrained_set_are_found_empty_together() -> None:
    side = Side(Scenario.parse(BOX.format(-1, 1, -1, 1, 0, 0, 0.5, -0.9, 0)), WORLD.profile)
    start = RawSets.zonotope(np.zeros((1, 2)), np.eye(2)[None])
    assert side.cut_all(start, np.ones((1, side.literals.count), dtype=bool), "constrained").empty.any()


@pytest.mark.parametrize("cuts", ["zonotope", "constrained"])
def test_a_track_without_branches_ends_and_names_what_conflicts(cuts: CutMethod) -> None:
    """Box and slope have nothing in common near the start; the disc has no part in it."""
    text = BOX.format(-0.5, 0.5, -0.5, 0.5, 0, 0, 50, -0.9, 0)
    side = Side(Scenario.parse(text), WORLD.profile)
    start = RawSets.zonotope(np.zeros((2, 2)), np.stack([np.eye(2), 9 * np.eye(2)]))
    motion = Recursion(
        InputSets(np.zeros((2, 1, 1)), np.zeros((2, 2, 1)), np.zeros((2, 2, 1))), two_vehicles(world_model(0)),
        WORLD.process, WORLD.layout,
    )  # fmt: skip
    tube = tube_of(start, motion, side, cuts)
    assert tube.ended.tolist() == [0, 0]
    assert all(not len(step.track) for step in tube.steps)
    for row in tube.responsible:
        names = {side.literals.name(i) for i in np.flatnonzero(row).tolist()}
        assert "slope" in names
        assert names & {"box.x1", "box.x2"}
        assert "disc" not in names


@cut_methods
def test_an_inactive_cut_changes_nothing_beside_an_active_one(cuts: CutMethod) -> None:
    side = Side(Scenario.parse(BOX.format(-0.5, 0.5, -0.5, 0.5, 0, 0, 0.6, 0.3, 0)), WORLD.profile)
    start = RawSets.zonotope(np.zeros((2, 2)), np.broadcast_to(np.eye(2), (2, 2, 2)))
    asked = np.zeros((2, side.literals.count), dtype=bool)
    asked[0] = True
    cut = side.cut_all(start, asked, cuts)
    assert not cut.active[1].any()
    d = np.concatenate([np.eye(2), -np.eye(2)])
    sets = cut.sets
    heights = support.constrained_support(sets.center, sets.generators, sets.matrix, sets.offset, d)
    np.testing.assert_allclose(heights[1], 1.0, atol=1e-6)
    assert (heights[0] < 0.8).all()
