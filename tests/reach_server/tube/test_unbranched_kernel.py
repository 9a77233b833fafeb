"""Tubes of a recursion in one loop: as those that go step by step, and around true trajectories."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from reach_server.data.input_sets import InputSets
from reach_server.data.regressors import transitions
from reach_server.models.residual_model import Model, NoiseBounds, fit
from reach_server.numeric.slot_table import take_rows
from reach_server.numeric.types import FloatArray
from reach_server.predicates import Context, Literals
from reach_server.predicates.cut_kinds import CutMethod
from reach_server.sets.raw import RawSets
from reach_server.tube.branching import Hypotheses, SideInformation, Tube, propagate
from reach_server.tube.cut_schedule import CutSchedule, CutScheduler
from reach_server.tube.recursion import Recursion
from reach_server.tube.summaries import PlaneStrips, summarize
from reach_server.tube.unbranched import UnbranchedTubes
from reach_server.tube.unbranched_kernel import recursion_tubes
from side_info import Scenario
from side_info.progression import Grid, Table
from tests.reach_server.drives import LAYOUT, PROFILE, SVEA, block_of, history, inside, noise
from vehicle_agent.svea import step as svea_step

STEPS, PLANE = 6, (0, 1)
PROCESS = np.diag(SVEA.process_noise)
MEASUREMENT = np.diag([0.02, 0.02, 0.1, 0.05])
SCENARIO = """
scenario: road
version: 1
state: {{x1: m, x2: m, v: m/s}}
time: {{zero: on_start, semantics: sampled}}
regions:
  lane: "x2 >= {low} and x2 <= {high}"
  slow: "v <= {v}"
assume: always[0 ms:100 s](lane and slow)
"""


class Fleet:
    """Cars that start around one place, at different headings and speeds, under boxes of inputs."""

    def __init__(self, count: int, *, known: bool = False, membership: bool = True, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        data = transitions(block_of(history(1).measured, history(1).inputs), LAYOUT)
        one = fit(data, LAYOUT, NoiseBounds.of(PROFILE, LAYOUT), PROFILE.lipschitz)
        self.model: Model = take_rows(one, np.zeros(count, dtype=np.intp))
        self.y = np.column_stack([
            rng.normal(size=(count, 2)), rng.uniform(-3, 3, count), rng.uniform(0.3, 1.2, count)
        ])  # fmt: skip
        self.start = RawSets.zonotope(self.y, np.broadcast_to(MEASUREMENT, (count, 4, 4)))
        past, center = rng.uniform(-0.3, 0.3, (count, 2, 2)), rng.uniform(-0.3, 0.6, (count, STEPS, 2))
        half = np.zeros_like(center) if known else rng.uniform(0.0, 0.2, center.shape)
        self.inputs = InputSets(past, center, half)
        self.motion = Recursion(self.inputs, self.model, PROCESS, LAYOUT, membership)

    def tubes(self, schedule: CutSchedule, cuts: CutMethod = "zonotope") -> UnbranchedTubes:
        return recursion_tubes(self.motion, self.start, np.arange(len(self.y)), schedule, PLANE, cuts)

    def truth(self, b: int, rng: np.random.Generator, count: int) -> FloatArray:
        """True states (count, STEPS + 1, 4)."""
        states = [self.y[b] - noise(rng, MEASUREMENT, count)]
        u = self.inputs.center[b] + self.inputs.half[b] * np.sign(rng.uniform(-1, 1, (count, STEPS, 2)))
        past = self.inputs.past[b]
        steering = [np.full(count, past[1, 0]), np.full(count, past[0, 0]), *u[..., 0].T]
        for k in range(STEPS):
            w = noise(rng, PROCESS, count)
            states.append(svea_step(SVEA, states[-1], steering[k], u[:, k, 1], w))
        return np.stack(states, axis=1)


class Road:
    """A lane along the first axis and a speed limit, from the start on."""

    def __init__(self, low: float, high: float, v: float) -> None:
        scenario = Scenario.parse(SCENARIO.format(low=low, high=high, v=v))
        self.table, self.literals = Table(), Literals(4, PLANE, np.zeros((4, 0)))

        def literal(number: int, margin_ns: int) -> int:
            predicate = scenario.predicates[number]
            return self.literals.add(predicate, {"x1": 0, "x2": 1, "v": 3}, scenario="road", name=predicate.name)

        self.root = self.table.add(scenario.side_information, Grid(SVEA.dt_ns), literal)

    def schedule(self, count: int) -> CutSchedule:
        plans = CutScheduler(self.table, self.literals, 4, PLANE)
        yes = np.ones(count, dtype=bool)
        return plans.of(np.arange(count), np.full(count, self.root), yes, STEPS, None, None)

    def branches(self, fleet: Fleet, cuts: CutMethod) -> Tube:
        rows = np.arange(len(fleet.y))
        tracks = Hypotheses(rows, fleet.start, rows, np.full(len(rows), self.root), np.ones(len(rows), dtype=bool))
        side = SideInformation(self.table, self.literals, lambda k, track: _nothing, cuts, PLANE)
        return propagate(tracks, fleet.motion, side, 4)


def _nothing(literal: int, rows: NDArray[np.intp]) -> Context:
    zero = np.zeros(len(rows))
    return Context(zero, zero, zero, np.zeros((len(rows), 4)), np.zeros((len(rows), 4)))


@pytest.mark.parametrize("membership", [True, False])
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("cuts", ["zonotope", "frobenius"])
def test_one_loop_comes_to_what_the_steps_come_to(cuts: CutMethod, known: bool, membership: bool) -> None:
    fleet, road = Fleet(12, known=known, membership=membership), Road(-0.8, 0.8, 0.9)
    schedule = road.schedule(12)
    assert schedule.unbranched.all()
    found, tube = fleet.tubes(schedule, cuts), road.branches(fleet, cuts)
    np.testing.assert_array_equal(found.ended, tube.ended)
    assert (tube.ended < 0).sum() > 3
    assert (tube.ended >= 0).any()
    strips = PlaneStrips.of(road.literals, range(road.literals.count), 4, PLANE)
    whole = np.flatnonzero(tube.ended < 0)
    literals = found.active_literals(schedule, road.literals.count)
    np.testing.assert_array_equal(literals[whole], tube.active[whole])
    for k, step in enumerate(tube.steps[1:]):
        own = np.isin(step.track, whole)
        sets = take_rows(step.sets, own)
        area = summarize(sets, step.within[own], strips, PLANE).area
        smaller = area if cuts == "frobenius" else np.minimum(area, found.area_free[whole, k])
        np.testing.assert_allclose(found.area[whole, k], smaller, rtol=1e-6)


@pytest.mark.parametrize("known", [True, False])
def test_without_cuts_the_sets_are_those_of_the_steps(known: bool) -> None:
    fleet = Fleet(5, known=known)
    found = fleet.tubes(CutSchedule.nothing(5, STEPS, 4))
    assert found.bounded.all()
    assert not found.contradicted.any()
    sets, rows = fleet.motion.begin(fleet.start, np.arange(5)), np.arange(5)
    for k in range(STEPS):
        sets, _ = fleet.motion.advance(sets, k, rows)
        most = sets.generators.shape[2]
        np.testing.assert_array_equal(found.center[:, k], sets.center[:, :4])
        np.testing.assert_array_equal(found.generators[:, k, :, :most], sets.generators[:, :4])
        np.testing.assert_array_equal(found.free_generators[:, k], found.generators[:, k])
        assert (found.used[:, k] <= most).all()


@pytest.mark.parametrize("seed", range(3))
def test_true_trajectories_that_obey_stay_inside(seed: int) -> None:
    fleet, road = Fleet(4, seed=seed), Road(-1.5, 1.5, 1.0)
    found = fleet.tubes(road.schedule(4))
    rng = np.random.default_rng(seed)
    for b in range(4):
        truth = fleet.truth(b, rng, 2000)
        obeys = ((np.abs(truth[..., 1]) <= 1.5) & (truth[..., 3] <= 1.0)).all(axis=1)
        for k in range(STEPS):
            free = RawSets.zonotope(found.free_center[b : b + 1, k], found.free_generators[b : b + 1, k])
            assert inside(free, 0, truth[:, k + 1], rng).all()
            cut = RawSets.zonotope(found.center[b : b + 1, k], found.generators[b : b + 1, k])
            points = truth[obeys if found.ended[b] < 0 else slice(None), k + 1]
            assert inside(cut, 0, points, rng).all()
            relative = points - found.center[b, k]
            assert (relative >= found.hull[b, k, 0]).all()
            assert (relative <= found.hull[b, k, 1]).all()


def test_a_vehicle_alone_has_the_tube_that_it_has_among_others() -> None:
    fleet, road = Fleet(12), Road(-0.8, 0.8, 0.9)
    schedule, order = road.schedule(12), np.array([7, 0, 11, 3])
    whole = fleet.tubes(schedule)
    some = recursion_tubes(fleet.motion, fleet.start, order, schedule.rows(order), PLANE, "zonotope")
    for name in ("center", "used", "area", "area_free", "heights", "hull", "active", "ended", "generators"):
        np.testing.assert_array_equal(getattr(some, name), getattr(whole, name)[order])


def test_sets_that_outgrow_all_numbers_are_told() -> None:
    fleet = Fleet(3)
    matrix = fleet.model.matrix.copy()
    matrix[1, 3, 1] = 1e200
    fleet.motion = Recursion(fleet.inputs, replace(fleet.model, matrix=matrix), PROCESS, LAYOUT)
    found = fleet.tubes(CutSchedule.nothing(3, STEPS, 4))
    np.testing.assert_array_equal(found.bounded, [True, False, True])
