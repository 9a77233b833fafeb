"""True trajectories stay in the tube at every step: Monte Carlo with corners of every set that is assumed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fleet_bus.messages import VehicleProfile
from reach_server.data.input_sets import InputSets
from reach_server.data.regressors import RegressorSpec, Transitions, transitions
from reach_server.models.residual_model import Model, NoiseBounds, fit
from reach_server.numeric.slot_table import take_rows
from reach_server.numeric.types import FloatArray
from reach_server.predicates import Context, Literals
from reach_server.predicates.apply import CutSets, cut_sets
from reach_server.predicates.cut_kinds import CutMethod
from reach_server.sets import support
from reach_server.sets.raw import RawSets
from reach_server.tube.branching import Branches, Hypotheses, SideInformation, Tube, propagate
from reach_server.tube.recursion import Recursion
from reach_server.tube.rotation_kernel import turn_one
from side_info import DiscPredicate, LinearPredicate, Scenario
from side_info.progression import TRUE, Grid, Table
from tests.reach_server.drives import LAYOUT, PROFILE, SVEA, World, block_of, dynamics, history, inside, noise
from tests.reach_server.ugly import Raw, assert_holds, gap, moderate
from vehicle_agent.svea import step as svea_step

WORLD = World()
HORIZON = 10
COUNT = 3000

cut_methods = pytest.mark.parametrize("cuts", ["zonotope", "constrained", "frobenius"])


class Side:
    """A scenario as the tube sees it: its table, its literals over the states of a profile, and its root."""

    def __init__(self, scenario: Scenario | None, profile: VehicleProfile, step_ns: int = SVEA.dt_ns) -> None:
        n = len(profile.state)
        self.table = Table()
        self.literals = Literals(n, (0, 1), np.zeros((n, 0)))
        self.root = TRUE
        if scenario is not None:
            index = scenario.state_indices(profile)

            def literal(number: int, margin_ns: int) -> int:
                predicate = scenario.predicates[number]
                return self.literals.add(predicate, index, scenario=scenario.name, name=predicate.name)

            self.root = self.table.add(scenario.side_information, Grid(step_ns), literal)

    @staticmethod
    def contexts(literal: int, rows: NDArray[np.intp]) -> Context:
        """Nothing that a predicate of these tests refers to."""
        zero = np.zeros(len(rows))
        return Context(zero, zero, zero, np.zeros((len(rows), 4)), np.zeros((len(rows), 4)))

    def side(self, cuts: CutMethod = "zonotope") -> SideInformation:
        """For ``propagate``."""
        return SideInformation(self.table, self.literals, lambda k, track: self.contexts, cuts, (0, 1))

    def cut_all(self, start: RawSets, asked: NDArray[np.bool_], cuts: CutMethod) -> CutSets:
        """Sets cut by the literals asked for."""
        return cut_sets(start, asked, self.literals, self.contexts, cuts, 2, (0, 1))


def tube_of(
    start: RawSets,
    motion: Recursion,
    side: Side | None = None,
    cuts: CutMethod = "zonotope",
) -> Tube:
    """One tube per row of ``start``, all with the side information, or none."""
    known = Side(None, WORLD.profile) if side is None else side
    rows = np.arange(len(start.center))
    tracks = Hypotheses(rows, start, rows, np.full(len(rows), known.root), np.ones(len(rows), dtype=bool))
    return propagate(tracks, motion, known.side(cuts), motion.layout.n)


def spread(rng: np.random.Generator, center: FloatArray, half: FloatArray, count: int) -> FloatArray:
    """Members (count, …) of a box, a third at corners, a third at one corner for good (extreme for all steps)."""
    share = rng.uniform(-1, 1, (count, *center.shape))
    third = count // 3
    share[:third] = np.sign(share[:third])
    share[third : 2 * third] = np.sign(rng.uniform(-1, 1, (third, 1, *center.shape[1:])))
    return np.asarray(center + share * half)


def world_truth(rng: np.random.Generator, start: FloatArray, u: FloatArray, past: FloatArray) -> FloatArray:
    """States (COUNT, HORIZON + 1, 2) from initial states under inputs (COUNT, HORIZON, 1)."""
    states = [start]
    for k in range(u.shape[1]):
        lagged = u[:, k - 1] if k else np.broadcast_to(past, (len(start), 1))
        xi = np.concatenate([states[-1], u[:, k], lagged], axis=1)
        states.append(WORLD.f(xi) + noise(rng, WORLD.process, len(start)))
    return np.stack(states, axis=1)


def svea_truth(rng: np.random.Generator, start: FloatArray, u: FloatArray, past: FloatArray) -> FloatArray:
    """States (COUNT, HORIZON + 1, 4); ``past`` (2, 2) are the last inputs, newest first."""
    states = [start]
    steering = [np.full(len(start), past[1, 0]), np.full(len(start), past[0, 0]), *u[..., 0].T]
    for k in range(u.shape[1]):
        w = noise(rng, np.diag(SVEA.process_noise), len(start))
        states.append(svea_step(SVEA, states[-1], steering[k], u[:, k, 1], w))
    return np.stack(states, axis=1)


def two_vehicles(model: Model) -> Model:
    """The same model for two vehicles."""
    return Model(**{name: np.concatenate([getattr(model, name)] * 2) for name in Model.__slots__})


def world_model(seed: int) -> Model:
    drive = WORLD.drive(seed)
    data = transitions(block_of(drive.measured, drive.inputs), WORLD.layout)
    return fit(data, WORLD.layout, NoiseBounds.of(WORLD.profile, WORLD.layout), WORLD.profile.lipschitz)


def svea_model(seed: int) -> Model:
    drive = history(seed)
    bounds = NoiseBounds.of(PROFILE, LAYOUT)
    return fit(transitions(block_of(drive.measured, drive.inputs), LAYOUT), LAYOUT, bounds, PROFILE.lipschitz)


def assert_all_inside(tube: Tube, truth: FloatArray, rng: np.random.Generator) -> None:
    """Every true state lies in one of the branches of the only track."""
    for k, step in enumerate(tube.steps):
        sets = step.sets
        held = np.any([inside(sets, row, truth[:, k], rng) for row in range(len(step.track))], axis=0)
        assert held.all(), (k, int((~held).sum()))
        if len(step.track) == 1:
            case = Raw("", sets.center[0], sets.generators[0], sets.matrix[0], sets.offset[0])
            assert_holds(case, truth[:2, k])


def only(step: Branches) -> RawSets:
    """The set of a step, where every track has one branch."""
    assert np.array_equal(step.track, np.arange(len(step.track)))
    return step.sets


@pytest.mark.parametrize("membership", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_world_trajectories_stay_inside(seed: int, membership: bool) -> None:
    rng = np.random.default_rng(seed)
    y, past = rng.uniform(-1, 1, 2), rng.uniform(-1, 1, (1, 1))
    center, half = rng.uniform(-0.5, 0.5, (HORIZON, 1)), rng.uniform(0, 0.5, (HORIZON, 1))
    start = RawSets.zonotope(y[None], WORLD.measurement[None])
    inputs = InputSets(past[None], center[None], half[None])
    tube = tube_of(start, Recursion(inputs, world_model(seed), WORLD.process, WORLD.layout, membership))
    u = spread(rng, center, half, COUNT)
    truth = world_truth(rng, y - noise(rng, WORLD.measurement, COUNT), u, past[0])
    assert_all_inside(tube, truth, rng)


def svea_tube(
    seed: int, heading: float, wide: bool, membership: bool, order: int = 5
) -> tuple[Tube, FloatArray, np.random.Generator]:
    rng = np.random.default_rng(seed)
    measurement = np.diag([0.01, 0.02, heading, 0.05])
    y = np.array([3.0, -2.0, rng.uniform(-3, 3), rng.uniform(-1, 1)])
    limit = np.array([SVEA.steering_limit, SVEA.velocity_limit])
    past = rng.uniform(-1, 1, (2, 2)) * limit
    half = limit * (rng.uniform(0.3, 1.0) if wide else 0.02) * np.ones((HORIZON, 1))
    center = rng.uniform(-1, 1, (HORIZON, 2)) * (limit - half)
    motion = Recursion(
        InputSets(past[None], center[None], half[None]), svea_model(seed), np.diag(SVEA.process_noise), LAYOUT,
        membership, order,
    )  # fmt: skip
    tube = tube_of(RawSets.zonotope(y[None], measurement[None]), motion)
    truth = svea_truth(rng, y - noise(rng, measurement, COUNT), spread(rng, center, half, COUNT), past)
    return tube, truth, rng


@pytest.mark.parametrize("membership", [True, False])
@pytest.mark.parametrize("wide", [True, False])
@pytest.mark.parametrize("heading", [0.01, 0.5, 1.4, 2.5])
def test_body_trajectories_stay_inside(heading: float, wide: bool, membership: bool) -> None:
    """Headings that are known well, badly, and beyond where the rotation is enclosed as a whole."""
    tube, truth, rng = svea_tube(int(10 * heading), heading, wide, membership)
    assert_all_inside(tube, truth, rng)


def test_a_linear_system_without_noise_gets_its_reachable_set_and_nothing_else() -> None:
    """Inputs act now and, by their lags, twice more; the exact set is a sum over matrix powers."""
    rng = np.random.default_rng(0)
    A = np.array([[0.9, 0.2], [-0.3, 0.8]])
    B = rng.normal(size=(3, 2, 2))
    layout = RegressorSpec(2, 2, 2, None, (0, 1), ())
    z = rng.normal(size=(1, 60, 8))
    target = z @ np.column_stack([A, *B]).T
    data = Transitions(z, target, np.ones((1, 60), dtype=bool), target[:, -1])
    nothing = np.zeros((2, 0))
    model = fit(data, layout, NoiseBounds(nothing, nothing), None)
    start = RawSets.zonotope(np.array([[1.0, 2.0]]), 0.3 * rng.normal(size=(1, 2, 3)))
    past, center, half = rng.normal(size=(1, 2, 2)), rng.normal(size=(1, 6, 2)), rng.uniform(0, 1, (1, 6, 2))
    motion = Recursion(InputSets(past, center, half), model, nothing, layout, order=50)
    tube = tube_of(start, motion)
    d = rng.normal(size=(30, 2))
    middle, G = start.center[0], start.generators[0]
    # inputs[k] is the input of step k, as (center, generators over the input factors of all steps)
    known = {-1: past[0, 0], -2: past[0, 1]} | {k: center[0, k] for k in range(6)}
    held: dict[int, FloatArray] = {k: np.zeros((2, 12)) for k in (-1, -2)}
    for k in range(6):
        held[k] = np.zeros((2, 12))
        held[k][:, 2 * k : 2 * k + 2] = np.diag(half[0, k])
    H = np.zeros((2, 12))
    for k in range(6):
        middle = A @ middle + sum(B[lag] @ known[k - lag] for lag in range(3))
        G, H = A @ G, A @ H + sum(B[lag] @ held[k - lag] for lag in range(3))
        exact = d @ middle + np.abs(d @ G).sum(axis=1) + np.abs(d @ H).sum(axis=1)
        sets = only(tube.steps[k + 1])
        bound = d @ sets.center[0] + np.abs(d @ sets.generators[0]).sum(axis=1)
        np.testing.assert_allclose(bound, exact, rtol=1e-9)


def test_a_car_without_noise_gets_little_more_than_it_reaches() -> None:
    """Increments linear in speed and lagged steering: what is left of looseness is of second order in the heading."""
    rng = np.random.default_rng(1)
    true = np.zeros((4, 8))
    true[0, 1], true[2, 6], true[3, 1], true[3, 3] = 0.05, 0.3, -0.2, 0.2
    z = rng.normal(size=(1, 80, 7))
    target = np.concatenate([np.ones((1, 80, 1)), z], axis=2) @ true.T
    data = Transitions(z, target, np.ones((1, 80), dtype=bool), target[:, -1])
    nothing = np.zeros((4, 0))
    model = fit(data, LAYOUT, NoiseBounds(nothing, nothing), None)
    y = np.array([1.0, 2.0, 0.7, 1.0])
    start_half = np.diag([0.0, 0.0, 0.02, 0.05])
    past, center, half = np.zeros((2, 2)), np.tile([0.1, 1.0], (6, 1)), np.tile([0.03, 0.2], (6, 1))
    inputs = InputSets(past[None], center[None], half[None])
    motion = Recursion(inputs, model, nothing, LAYOUT, order=50)
    tube = tube_of(RawSets.zonotope(y[None], start_half[None]), motion)
    count = 40_000
    u = spread(rng, center, half, count)
    steering = [np.zeros(count), np.zeros(count), *u[..., 0].T]
    state = y - noise(rng, start_half, count)
    for k in range(6):
        forward, angle = 0.05 * state[:, 3], state[:, 2]
        state = state + np.stack(
            [np.cos(angle) * forward, np.sin(angle) * forward, 0.3 * steering[k], 0.2 * (u[:, k, 1] - state[:, 3])],
            axis=1,
        )
        assert inside(only(tube.steps[k + 1]), 0, state, rng).all()
        width = 2 * np.abs(only(tube.steps[k + 1]).generators[0]).sum(axis=1)
        assert (np.ptp(state, axis=0) > 0.9 * width).all()


def test_few_generators_cost_size_and_no_trajectory() -> None:
    tight, truth, rng = svea_tube(1, 0.1, wide=True, membership=True)
    coarse, _, _ = svea_tube(1, 0.1, wide=True, membership=True, order=1)
    assert_all_inside(coarse, truth, rng)
    assert max(s.sets.generators.shape[2] for s in coarse.steps) <= 8
    size = [np.abs(t.steps[-1].sets.generators).sum() for t in (tight, coarse)]
    assert size[0] <= size[1]


def test_tubes_are_not_absurdly_wide() -> None:
    """With a known plan and a good model the set of the first step is a small multiple of what is reached."""
    tube, truth, _ = svea_tube(3, 0.006, wide=False, membership=True)
    reached = np.ptp(truth[:, 1], axis=0)
    width = 2 * np.abs(only(tube.steps[1]).generators[0]).sum(axis=1)
    assert (width < 15 * reached).all()


def turned(
    center: FloatArray, generators: FloatArray, step: FloatArray, steps: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """State plus turned increment over the same factors, of one vehicle."""
    shift, moved, rest = step[0].copy(), steps[0].copy(), np.empty(4)
    used = moved.shape[1]
    turn_one(center[0], generators[0], used, shift, moved, used, (0, 1, 2), rest)
    columns = np.zeros((len(shift), 2))
    columns[0], columns[1] = rest[::2], rest[1::2]
    return (center[0] + shift)[None], np.concatenate([generators[0] + moved, columns], axis=1)[None]


@moderate
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 0.05, 0.7, 1.4999, 1.5001, 4.0]),
    st.sampled_from([0.0, 0.01, 1.0]),
)
@pytest.mark.slow
def test_turned_increments_are_enclosed(seed: int, rho: float, size: float) -> None:
    """x + R(θ) d over common factors, by brute force: corners, edges and the inside of the factor box."""
    rng = np.random.default_rng(seed)
    g = int(rng.integers(1, 6))
    center, generators = rng.normal(size=(1, 4)), rng.normal(size=(1, 4, g))
    generators[:, 2] *= rho / np.abs(generators[:, 2]).sum()
    step_center, steps = rng.normal(size=(1, 4)), size * rng.normal(size=(1, 4, g))
    new_center, new = turned(center, generators, step_center, steps)
    xi = rng.uniform(-1, 1, (4000, g))
    xi[:1500] = np.sign(xi[:1500])
    xi[1500:2500] = np.where(rng.random((1000, g)) < 0.7, np.sign(xi[1500:2500]), xi[1500:2500])
    x, d = center[0] + xi @ generators[0].T, step_center[0] + xi @ steps[0].T
    cos, sin = np.cos(x[:, 2]), np.sin(x[:, 2])
    after = x + d
    after[:, 0] = x[:, 0] + cos * d[:, 0] - sin * d[:, 1]
    after[:, 1] = x[:, 1] + sin * d[:, 0] + cos * d[:, 1]
    sets = RawSets.zonotope(new_center, new)
    assert inside(sets, 0, after, rng, 200).all()


def test_a_turn_keeps_the_correlation_of_heading_and_position() -> None:
    """A car that drives a metre with a heading known to ±0.1 ends on an arc, not in a box."""
    generators = np.zeros((1, 3, 1))
    generators[0, 2, 0] = 0.1
    center, new = turned(np.zeros((1, 3)), generators, np.array([[1.0, 0.0, 0.0]]), np.zeros((1, 3, 1)))
    across = new[0, 1]
    assert across[0] == pytest.approx(0.1)
    assert np.abs(across[1:]).sum() < 1e-3
    assert center[0, 0] == pytest.approx(1 - 0.25 * 0.01)


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


def test_known_inputs_act_through_their_lags() -> None:
    """A steering command acts two samples later, and the input box that holds it reuses its factor then."""
    rng = np.random.default_rng(0)
    center, half = np.tile([0.2, 1.0], (3, 1)), np.zeros((3, 2))
    half[0, 0] = 0.3
    past = np.array([[0.1, 1.0], [-0.1, 1.0]])
    y = np.array([0.0, 0.0, 0.0, 1.0])
    motion = Recursion(InputSets(past[None], center[None], half[None]), svea_model(0), np.zeros((4, 0)), LAYOUT)
    tube = tube_of(RawSets.zonotope(y[None], np.zeros((1, 4, 0))), motion)
    u = spread(rng, center, half, 500)
    steering = [np.full(500, -0.1), np.full(500, 0.1), u[:, 0, 0]]
    state = np.broadcast_to(y, (500, 4))
    for k in range(3):
        state = svea_step(SVEA, state, steering[k], u[:, k, 1])
        assert inside(only(tube.steps[k + 1]), 0, state, rng).all()


def test_two_vehicles_get_what_each_gets_alone() -> None:
    rng = np.random.default_rng(0)
    y = rng.normal(size=(2, 4))
    inputs = InputSets(rng.normal(size=(2, 2, 2)) * 0.1, np.zeros((2, 5, 2)), np.full((2, 5, 2), 0.1))
    start = RawSets.zonotope(y, np.broadcast_to(0.01 * np.eye(4), (2, 4, 4)))
    process = np.diag(SVEA.process_noise)
    both = tube_of(start, Recursion(inputs, two_vehicles(svea_model(1)), process, LAYOUT))
    for v in range(2):
        row = slice(v, v + 1)
        alone = tube_of(take_rows(start, row), Recursion(take_rows(inputs, row), svea_model(1), process, LAYOUT))
        for k in range(6):
            sets, one = only(both.steps[k]), only(alone.steps[k])
            np.testing.assert_allclose(sets.center[v], one.center[0], atol=1e-12)
            width, width_alone = (np.abs(s.generators[i]).sum(axis=1) for s, i in ((sets, v), (one, 0)))
            np.testing.assert_allclose(width, width_alone, rtol=1e-9)


def test_reduction_drops_the_oldest_rows_only_and_encloses() -> None:
    rng = np.random.default_rng(0)
    G, A = rng.normal(size=(1, 3, 30)), rng.normal(size=(1, 11, 30))
    factor = rng.uniform(-1, 1, 30)
    sets = RawSets(np.zeros((1, 3)), G, A, A @ factor)
    reduced = sets.reduced(20)
    assert reduced.matrix.shape[1] == 8
    case = Raw("", reduced.center[0], reduced.generators[0], reduced.matrix[0], reduced.offset[0])
    assert gap(case, G[0] @ factor) < 1e-6


def test_dynamics_of_the_tests_are_those_of_the_simulator() -> None:
    rng = np.random.default_rng(0)
    state, u = rng.normal(size=(20, 4)), rng.uniform(-0.7, 0.7, (20, 6))
    after = svea_step(SVEA, state, u[:, 4], u[:, 1])
    d = dynamics(np.column_stack([state[:, 3], u]))
    np.testing.assert_allclose(after[:, 2:] - state[:, 2:], d[:, 2:], atol=1e-12)
