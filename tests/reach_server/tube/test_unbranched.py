"""Tubes in one loop: as those that go step by step, and around what obeys the cuts."""

from textwrap import dedent

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from shapely import MultiPoint

from reach_server.numeric.types import FloatArray, IndexArray
from reach_server.predicates import Context, Literals
from reach_server.predicates.cut_kinds import CutMethod
from reach_server.sets.polygon import outer_polygon
from reach_server.sets.raw import RawSets
from reach_server.tube.branching import Branches, Hypotheses, SideInformation, propagate
from reach_server.tube.cut_schedule import CutSchedule, CutScheduler
from reach_server.tube.summaries import PlaneStrips, summarize
from reach_server.tube.unbranched import UnbranchedTubes, box_tubes
from side_info import Scenario
from side_info.progression import TRUE, Grid, Table
from tests.reach_server.ugly import assert_outlines, moderate

STATES = {"x1": 0, "x2": 1, "v": 2}
PLANE = (0, 1)
N = 4
STEP = 100_000_000

methods = pytest.mark.parametrize("cuts", ["zonotope", "frobenius"])


class Boxes:
    """Boxes that shrink or grow at random: center (B, N, n), generators (B, N, n, n), and a point to start from."""

    def __init__(self, count: int, seed: int = 0, size: float = 0.3) -> None:
        rng = np.random.default_rng(seed)
        self.center = rng.normal(size=(count, N, 3)) * 0.2
        angle = rng.uniform(0, np.pi, count)
        turn = np.zeros((count, 3, 3))
        turn[:, 2, 2] = 1.0
        turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
        turn[:, 1, 0], turn[:, 0, 1] = np.sin(angle), -np.sin(angle)
        self.generators = turn[:, None] * (rng.uniform(0.2, 1.0, (count, N, 1, 3)) * size)
        self.start = self.center[:, 0] * 0.5
        self.points = np.zeros((count, 3, 0))

    @property
    def horizon(self) -> int:
        return N

    def begin(self, start: RawSets, vehicle: IndexArray) -> RawSets:
        return start

    def advance(self, sets: RawSets, k: int, vehicle: IndexArray) -> tuple[RawSets, NDArray[np.bool_]]:
        moved = RawSets.zonotope(self.center[vehicle, k], self.generators[vehicle, k])
        return moved, np.zeros(len(vehicle), dtype=bool)

    def with_start(self) -> tuple[FloatArray, FloatArray]:
        """The sets without cuts at steps 0 to N."""
        g = np.concatenate([np.zeros((len(self.start), 1, 3, 3)), self.generators], axis=1)
        return np.concatenate([self.start[:, None], self.center], axis=1), g

    def tubes(self, schedule: CutSchedule, cuts: CutMethod = "zonotope") -> UnbranchedTubes:
        return box_tubes(self.center, self.generators, self.start, self.points, schedule, PLANE, cuts)


class Side:
    """A scenario over boxes: its table, its literals and what it asks for from the start on."""

    def __init__(self, assume: str, **predicates: str) -> None:
        regions = "\n".join(f'  {name}: "{region}"' for name, region in predicates.items())
        text = f"""
            scenario: s
            version: 1
            state: {{x1: m, x2: m, v: m/s}}
            time: {{zero: on_start, semantics: sampled}}
            assume: "{assume}"
            regions:\n"""
        text = dedent(text) + regions
        scenario = Scenario.parse(text)
        self.table, self.literals = Table(), Literals(3, PLANE, np.zeros((3, 0)))

        def literal(number: int, margin_ns: int) -> int:
            predicate = scenario.predicates[number]
            return self.literals.add(predicate, STATES, scenario="s", name=predicate.name)

        self.root = self.table.add(scenario.side_information, Grid(STEP), literal)

    def schedule(self, boxes: Boxes, *, known: bool = True) -> CutSchedule:
        count = len(boxes.center)
        center, generators = boxes.with_start()
        plans = CutScheduler(self.table, self.literals, 3, PLANE)
        tested, root = np.ones(count, dtype=bool), np.full(count, self.root)
        return plans.of(np.arange(count), root, tested, N, center if known else None, generators if known else None)

    def branches(
        self, boxes: Boxes, cuts: CutMethod = "zonotope"
    ) -> tuple[list[Branches], NDArray[np.bool_], NDArray[np.int64]]:
        """By the general way, of tracks that ask: branches at each step, what acted and the step of the end."""
        count = len(boxes.center)
        rows = np.arange(count)
        start = RawSets.zonotope(boxes.start, boxes.points)
        tracks = Hypotheses(rows, start, rows, np.full(count, self.root), np.ones(count, dtype=bool))
        side = SideInformation(self.table, self.literals, lambda k, track: _nothing, cuts, PLANE)
        tube = propagate(tracks, boxes, side, 3)
        return tube.steps[1:], tube.active, tube.ended


def _nothing(literal: int, rows: IndexArray) -> Context:
    zero = np.zeros(len(rows))
    return Context(zero, zero, zero, np.zeros((len(rows), 3)), np.zeros((len(rows), 3)))


ROAD = {"lane": "x1 >= -0.1 and x1 <= 0.2", "slow": "v <= 0.1", "far": "x1 >= 50", "here": "x1 <= 40"}


@methods
def test_one_loop_comes_to_what_the_steps_come_to(cuts: CutMethod) -> None:
    side, boxes = Side("always[0:1 s](lane and slow)", **ROAD), Boxes(60)
    schedule = side.schedule(boxes)
    assert schedule.unbranched.all()
    found = boxes.tubes(schedule, cuts)
    steps, active, ended = side.branches(boxes, cuts)
    np.testing.assert_array_equal(found.ended, ended)
    whole = np.flatnonzero(ended < 0)
    assert 5 < len(whole) < 60
    literals = found.active_literals(schedule, side.literals.count)
    np.testing.assert_array_equal(literals[whole], active[whole])
    strips = PlaneStrips.of(side.literals, range(side.literals.count), 3, PLANE)
    for k, step in enumerate(steps):
        own = np.isin(step.track, whole)
        sets = RawSets.zonotope(step.sets.center[own], step.sets.generators[own])
        free = RawSets.zonotope(boxes.center[whole, k], boxes.generators[whole, k])
        area = summarize(sets, step.within[own], strips, PLANE).area
        area_free = summarize(free, step.within[own] & False, strips, PLANE).area
        np.testing.assert_allclose(found.area_free[whole, k], area_free)
        smaller = area if cuts == "frobenius" else np.minimum(area, area_free)
        np.testing.assert_allclose(found.area[whole, k], smaller, rtol=1e-9, atol=1e-12)


@moderate
@given(st.integers(0, 2**32 - 1), st.sampled_from(["zonotope", "frobenius"]))
@pytest.mark.slow
def test_tubes_hold_what_obeys_the_cuts(seed: int, cuts: CutMethod) -> None:
    side, boxes = Side("always[0:1 s](lane and slow)", **ROAD), Boxes(3, seed)
    found = boxes.tubes(side.schedule(boxes), cuts)
    rng = np.random.default_rng(seed)
    factors = np.sign(rng.uniform(-1, 1, (500, 3))) * rng.uniform(0, 1, (500, 3)) ** 0.3
    for b in range(3):
        for k in range(N):
            points = boxes.center[b, k] + factors @ boxes.generators[b, k].T
            obeys = (points[:, 0] >= -0.1) & (points[:, 0] <= 0.2) & (points[:, 2] <= 0.1)
            points = points if found.ended[b] >= 0 else points[obeys]
            if not len(points):
                continue
            relative = points - found.center[b, k]
            assert_outlines(outer_polygon(found.heights[b, k]), relative[:, :2], 1.0)
            assert (found.hull[b, k, 0] <= relative.min(axis=0)).all()
            assert (found.hull[b, k, 1] >= relative.max(axis=0)).all()
            assert found.area[b, k] >= MultiPoint(relative[:, :2]).convex_hull.area * (1 - 1e-9)
            for d in rng.normal(size=(10, 3)):
                assert (relative @ d <= np.abs(d @ found.generators[b, k]).sum() + 1e-9).all()


def test_a_vehicle_alone_has_the_tube_that_it_has_among_others() -> None:
    side, boxes = Side("always[0:1 s](lane and slow)", **ROAD), Boxes(20)
    schedule = side.schedule(boxes)
    whole = boxes.tubes(schedule)
    for row in (0, 7, 19):
        one = box_tubes(
            boxes.center[[row]], boxes.generators[[row]], boxes.start[[row]], boxes.points[[row]],
            schedule.rows(np.array([row])), PLANE, "zonotope",
        )  # fmt: skip
        columns = min(one.generators.shape[3], whole.generators.shape[3])
        np.testing.assert_array_equal(one.center[0], whole.center[row])
        np.testing.assert_array_equal(one.generators[0, ..., :columns], whole.generators[row, ..., :columns])
        np.testing.assert_array_equal(one.heights[0], whole.heights[row])
        np.testing.assert_array_equal(one.area[0], whole.area[row])


def test_without_cuts_the_boxes_stay_and_what_is_not_finite_is_told() -> None:
    boxes = Boxes(3)
    boxes.generators[1, 2, 0, 0] = np.inf
    boxes.center[2, 1, 1] = np.nan
    found = boxes.tubes(CutSchedule.nothing(3, N, 3))
    np.testing.assert_array_equal(found.bounded, [True, False, False])
    np.testing.assert_array_equal(found.generators[0], boxes.generators[0])
    sides = np.abs(np.linalg.det(2 * boxes.generators[0, :, :2, :2]))
    np.testing.assert_allclose(found.area[0], sides)
    np.testing.assert_array_equal(found.ended, -1)


def test_an_alternative_that_no_set_can_meet_needs_no_branch() -> None:
    side, boxes = Side("lane until[0:5 s] far", **ROAD), Boxes(40)
    assert not side.schedule(boxes, known=False).unbranched.any()
    schedule = side.schedule(boxes)
    found = boxes.tubes(schedule)
    _, active, ended = side.branches(boxes)
    # Where the lane misses a set, too, no alternative is left, and the steps have to tell why.
    np.testing.assert_array_equal(schedule.unbranched & (found.ended < 0), ended < 0)
    whole = ended < 0
    assert 0 < whole.sum() < 40
    np.testing.assert_array_equal(found.active_literals(schedule, side.literals.count)[whole], active[whole])


def test_an_alternative_that_another_covers_needs_no_branch() -> None:
    # All sets are here: that it is fulfilled now covers that it will be.
    side, boxes = Side("eventually[0:5 s](here) and always[0:5 s](lane)", **ROAD), Boxes(10, size=0.01)
    boxes.center, boxes.start = 0.1 * boxes.center, 0.1 * boxes.start
    schedule = side.schedule(boxes)
    assert schedule.unbranched.all()
    reached = Side("eventually[0:0.2 s](lane)", **ROAD)
    # Of some sets a part is in the lane: there are two ways to go on.
    assert not reached.schedule(Boxes(40)).unbranched.all()


def test_predicates_that_depend_on_the_set_and_several_obligations_need_branches() -> None:
    boxes = Boxes(2)
    curved = Side("always[0:1 s](ring)", ring="x1*x1 + x2*x2 >= 0.01")
    assert not curved.schedule(boxes).unbranched.any()
    side = Side("always[0:1 s](lane)", **ROAD)
    plans = CutScheduler(side.table, side.literals, 3, PLANE)
    schedule = plans.of(
        np.array([1, 1]), np.array([side.root, side.root]), np.ones(2, dtype=bool), N, *boxes.with_start()
    )
    np.testing.assert_array_equal(schedule.unbranched, [True, False])
    assert not schedule.asked.any()
    never = plans.of(np.array([0]), np.array([TRUE]), np.ones(2, dtype=bool), N, None, None)
    assert never.unbranched.all()
    assert not never.asked.any()


def test_a_set_of_now_that_may_not_be_cut_is_not() -> None:
    side = Side("always[0:1 s](lane)", **ROAD)
    plans = CutScheduler(side.table, side.literals, 3, PLANE)
    rows = np.arange(2)
    schedule = plans.of(rows, np.full(2, side.root), np.array([True, False]), N, None, None)
    np.testing.assert_array_equal(schedule.asked[:, 0].any(axis=1), [True, False])
    assert schedule.asked[:, 1:].any(axis=2).all()
