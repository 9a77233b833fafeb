"""True trajectories stay in the tube at every step: Monte Carlo with corners of every set that is assumed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fleet_bus.messages import VehicleProfile
from reach_server.model import Model, NoiseBounds, fit
from reach_server.predicates import CutTable, compile_cuts
from reach_server.regression import Layout, Transitions, transitions
from reach_server.sets import support
from reach_server.tube import CutMethod, FactorSet, InputSets, Tube, _turn, apply_cuts, propagate
from side_info import DiscPredicate, Scenario
from tests.reach_server.drives import (
    LAYOUT,
    PROFILE,
    SVEA,
    Floats,
    World,
    block_of,
    dynamics,
    history,
    inside,
    noise,
)
from tests.reach_server.ugly import Raw, assert_holds, gap, moderate
from vehicle_agent.svea import step as svea_step

WORLD = World()
HORIZON = 10
COUNT = 3000

cut_methods = pytest.mark.parametrize("cuts", ["zonotope", "constrained", "frobenius"])


def no_cuts(profile: VehicleProfile) -> CutTable:
    return compile_cuts((), profile)


def spread(rng: np.random.Generator, center: Floats, half: Floats, count: int) -> Floats:
    """Members (count, …) of a box, a third at corners, a third at one corner for good (extreme for all steps)."""
    share = rng.uniform(-1, 1, (count, *center.shape))
    third = count // 3
    share[:third] = np.sign(share[:third])
    share[third : 2 * third] = np.sign(rng.uniform(-1, 1, (third, 1, *center.shape[1:])))
    return np.asarray(center + share * half)


def world_truth(rng: np.random.Generator, start: Floats, u: Floats, past: Floats) -> Floats:
    """States (COUNT, HORIZON + 1, 2) from initial states under inputs (COUNT, HORIZON, 1)."""
    states = [start]
    for k in range(u.shape[1]):
        lagged = u[:, k - 1] if k else np.broadcast_to(past, (len(start), 1))
        xi = np.concatenate([states[-1], u[:, k], lagged], axis=1)
        states.append(WORLD.f(xi) + noise(rng, WORLD.process, len(start)))
    return np.stack(states, axis=1)


def svea_truth(rng: np.random.Generator, start: Floats, u: Floats, past: Floats) -> Floats:
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


def assert_all_inside(tube: Tube, truth: Floats, rng: np.random.Generator, row: int = 0) -> None:
    for k, sets in enumerate(tube.steps):
        held = inside(sets, row, truth[:, k], rng)
        assert held.all(), (k, int((~held).sum()))
        case = Raw("", sets.center[row], sets.generators[row], sets.matrix[row], sets.offset[row])
        assert_holds(case, truth[:2, k])


@pytest.mark.parametrize("membership", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_world_trajectories_stay_inside(seed: int, membership: bool) -> None:
    rng = np.random.default_rng(seed)
    y, past = rng.uniform(-1, 1, 2), rng.uniform(-1, 1, (1, 1))
    center, half = rng.uniform(-0.5, 0.5, (HORIZON, 1)), rng.uniform(0, 0.5, (HORIZON, 1))
    start = FactorSet.zonotope(y[None], WORLD.measurement[None])
    tube = propagate(
        start, InputSets(past[None], center[None], half[None]), world_model(seed), WORLD.process, WORLD.layout,
        no_cuts(WORLD.profile), np.zeros((1, HORIZON + 1, 0), dtype=bool), membership=membership,
    )  # fmt: skip
    u = spread(rng, center, half, COUNT)
    truth = world_truth(rng, y - noise(rng, WORLD.measurement, COUNT), u, past[0])
    assert_all_inside(tube, truth, rng)


def svea_tube(
    seed: int, heading: float, wide: bool, membership: bool, kept_generators: int = 32
) -> tuple[Tube, Floats, np.random.Generator]:
    rng = np.random.default_rng(seed)
    measurement = np.diag([0.01, 0.02, heading, 0.05])
    y = np.array([3.0, -2.0, rng.uniform(-3, 3), rng.uniform(-1, 1)])
    limit = np.array([SVEA.steering_limit, SVEA.velocity_limit])
    past = rng.uniform(-1, 1, (2, 2)) * limit
    half = limit * (rng.uniform(0.3, 1.0) if wide else 0.02) * np.ones((HORIZON, 1))
    center = rng.uniform(-1, 1, (HORIZON, 2)) * (limit - half)
    tube = propagate(
        FactorSet.zonotope(y[None], measurement[None]), InputSets(past[None], center[None], half[None]),
        svea_model(seed), np.diag(SVEA.process_noise), LAYOUT, no_cuts(PROFILE),
        np.zeros((1, HORIZON + 1, 0), dtype=bool), membership=membership, kept_generators=kept_generators,
    )  # fmt: skip
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
    layout = Layout(2, 2, 2, None, (0, 1), ())
    z = rng.normal(size=(1, 60, 8))
    target = z @ np.column_stack([A, *B]).T
    data = Transitions(z, target, np.ones((1, 60), dtype=bool), target[:, -1])
    nothing = np.zeros((2, 0))
    model = fit(data, layout, NoiseBounds(nothing, nothing), None)
    start = FactorSet.zonotope(np.array([[1.0, 2.0]]), 0.3 * rng.normal(size=(1, 2, 3)))
    past, center, half = rng.normal(size=(1, 2, 2)), rng.normal(size=(1, 6, 2)), rng.uniform(0, 1, (1, 6, 2))
    table, active = no_cuts(WORLD.profile), np.zeros((1, 7, 0), dtype=bool)
    tube = propagate(
        start, InputSets(past, center, half), model, nothing, layout, table, active, kept_generators=200
    )  # fmt: skip
    d = rng.normal(size=(30, 2))
    middle, G = start.center[0], start.generators[0]
    # inputs[k] is the input of step k, as (center, generators over the input factors of all steps)
    known = {-1: past[0, 0], -2: past[0, 1]} | {k: center[0, k] for k in range(6)}
    held: dict[int, Floats] = {k: np.zeros((2, 12)) for k in (-1, -2)}
    for k in range(6):
        held[k] = np.zeros((2, 12))
        held[k][:, 2 * k : 2 * k + 2] = np.diag(half[0, k])
    H = np.zeros((2, 12))
    for k in range(6):
        middle = A @ middle + sum(B[lag] @ known[k - lag] for lag in range(3))
        G, H = A @ G, A @ H + sum(B[lag] @ held[k - lag] for lag in range(3))
        exact = d @ middle + np.abs(d @ G).sum(axis=1) + np.abs(d @ H).sum(axis=1)
        sets = tube.steps[k + 1]
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
    tube = propagate(
        FactorSet.zonotope(y[None], start_half[None]), InputSets(past[None], center[None], half[None]), model,
        nothing, LAYOUT, no_cuts(PROFILE), np.zeros((1, 7, 0), dtype=bool), kept_generators=200,
    )  # fmt: skip
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
        assert inside(tube.steps[k + 1], 0, state, rng).all()
        width = 2 * np.abs(tube.steps[k + 1].generators[0]).sum(axis=1)
        assert (np.ptp(state, axis=0) > 0.9 * width).all()


def test_few_generators_cost_size_and_no_trajectory() -> None:
    tight, truth, rng = svea_tube(1, 0.1, wide=True, membership=True)
    coarse, _, _ = svea_tube(1, 0.1, wide=True, membership=True, kept_generators=0)
    assert_all_inside(coarse, truth, rng)
    assert max(s.generators.shape[2] for s in coarse.steps) <= 8
    size = [np.abs(t.steps[-1].generators).sum() for t in (tight, coarse)]
    assert size[0] <= size[1]


def test_tubes_are_not_absurdly_wide() -> None:
    """With a known plan and a good model the set of the first step is a small multiple of what is reached."""
    tube, truth, _ = svea_tube(3, 0.006, wide=False, membership=True)
    reached = np.ptp(truth[:, 1], axis=0)
    width = 2 * np.abs(tube.steps[1].generators[0]).sum(axis=1)
    assert (width < 15 * reached).all()


@moderate
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 0.05, 0.7, 1.4999, 1.5001, 4.0]),
    st.sampled_from([0.0, 0.01, 1.0]),
)
def test_turned_increments_are_enclosed(seed: int, rho: float, size: float) -> None:
    """x + R(θ) d over common factors, by brute force: corners, edges and the inside of the factor box."""
    rng = np.random.default_rng(seed)
    g = int(rng.integers(1, 6))
    center, generators = rng.normal(size=(1, 4)), rng.normal(size=(1, 4, g))
    generators[:, 2] *= rho / np.abs(generators[:, 2]).sum()
    step_center, steps = rng.normal(size=(1, 4)), size * rng.normal(size=(1, 4, g))
    new_center, new = _turn(center, generators, step_center, steps, (0, 1, 2))
    xi = rng.uniform(-1, 1, (4000, g))
    xi[:1500] = np.sign(xi[:1500])
    xi[1500:2500] = np.where(rng.random((1000, g)) < 0.7, np.sign(xi[1500:2500]), xi[1500:2500])
    x, d = center[0] + xi @ generators[0].T, step_center[0] + xi @ steps[0].T
    cos, sin = np.cos(x[:, 2]), np.sin(x[:, 2])
    after = x + d
    after[:, 0] = x[:, 0] + cos * d[:, 0] - sin * d[:, 1]
    after[:, 1] = x[:, 1] + sin * d[:, 0] + cos * d[:, 1]
    sets = FactorSet.zonotope(new_center, new)
    assert inside(sets, 0, after, rng, 200).all()


def test_a_turn_keeps_the_correlation_of_heading_and_position() -> None:
    """A car that drives a metre with a heading known to ±0.1 ends on an arc, not in a box."""
    generators = np.zeros((1, 3, 1))
    generators[0, 2, 0] = 0.1
    center, new = _turn(np.zeros((1, 3)), generators, np.array([[1.0, 0.0, 0.0]]), np.zeros((1, 3, 1)), (0, 1, 2))
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
assume: always[0:100 s](box) and always[0:100 s](disc) and always[0:100 s](slope)
"""


def scenario_around(points: Floats) -> Scenario:
    """Predicates that cut off a part of the end points (K, 2)."""
    low, high = np.quantile(points, 0.1, axis=0), np.quantile(points, 0.9, axis=0)
    middle = points.mean(axis=0)
    radius = np.quantile(np.linalg.norm(points - middle, axis=1), 0.8)
    slope = np.quantile(points[:, 0] + 0.5 * points[:, 1], 0.8)
    return Scenario.parse(BOX.format(low[0], high[0], low[1], high[1], *middle, radius, slope))


def obeys(points: Floats, scenario: Scenario) -> NDArray[np.bool_]:
    """Whether points (..., 2) obey every predicate of ``BOX``."""
    x, y = points[..., 0], points[..., 1]
    held = np.ones(x.shape, dtype=bool)
    for predicate in (*scenario.regions["box"], *scenario.regions["disc"], *scenario.regions["slope"]):
        if isinstance(predicate, DiscPredicate):
            middle = np.array(list(predicate.center.values()))
            held &= np.linalg.norm(points - middle, axis=-1) <= predicate.radius
        else:
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
    scenario = scenario_around(truth[:, active_from:, :2].reshape(-1, 2))
    obedient = obeys(truth[:, active_from:, :2], scenario).all(axis=1)
    assert obedient.sum() > 50
    table = compile_cuts([scenario], profile)
    active = np.zeros((1, HORIZON + 1, table.count), dtype=bool)
    active[:, active_from:] = True
    inputs = InputSets(past[None], center[None], half[None])
    start = FactorSet.zonotope(y[None], measurement[None])
    tube = propagate(start, inputs, model, process, layout, table, active, cuts=cuts)
    free = propagate(start, inputs, model, process, layout, table, np.zeros_like(active), cuts=cuts)
    assert not tube.empty.any()
    assert tube.cut[:, active_from:].any()
    assert not tube.cut[:, :active_from].any()
    assert_all_inside(tube, truth[obedient], rng)
    if cuts != "frobenius":
        d = np.concatenate([np.eye(layout.n), -np.eye(layout.n)])
        last, last_free = tube.steps[-1], free.steps[-1]
        width, width_free = (
            support.constrained_support(s.center, s.generators, s.matrix, s.offset, d)[0]
            for s in (last, last_free)
        )  # fmt: skip
        assert (width + np.roll(width, layout.n))[0] < 0.9 * (width_free + np.roll(width_free, layout.n))[0]


@cut_methods
def test_cuts_that_leave_nothing_are_told_and_not_applied(cuts: CutMethod) -> None:
    scenario = Scenario.parse(BOX.format(5, 6, 5, 6, 5.5, 5.5, 1, 20))
    table = compile_cuts([scenario], WORLD.profile)
    start = FactorSet.zonotope(np.zeros((2, 2)), np.array([0.1, 10.0])[:, None, None] * np.eye(2))
    state, empty, acted = apply_cuts(start, table, np.ones((2, table.count), dtype=bool), cuts, 2)
    assert empty[0].any()
    assert not empty[1].any()
    assert acted[1].any()
    assert inside(state, 0, np.array([[0.1, 0.1], [-0.1, -0.1]]), np.random.default_rng(0)).all()


def test_conflicting_cuts_of_a_constrained_set_are_found_empty_together() -> None:
    text = BOX.format(-1, 1, -1, 1, 0, 0, 0.5, -0.9)
    table = compile_cuts([Scenario.parse(text)], WORLD.profile)
    start = FactorSet.zonotope(np.zeros((1, 2)), np.eye(2)[None])
    _, empty, _ = apply_cuts(start, table, np.ones((1, table.count), dtype=bool), "constrained", 2)
    assert empty.any()


@cut_methods
def test_an_inactive_cut_changes_nothing_beside_an_active_one(cuts: CutMethod) -> None:
    table = compile_cuts([Scenario.parse(BOX.format(-0.5, 0.5, -0.5, 0.5, 0, 0, 0.6, 0.3))], WORLD.profile)
    start = FactorSet.zonotope(np.zeros((2, 2)), np.broadcast_to(np.eye(2), (2, 2, 2)))
    active = np.zeros((2, table.count), dtype=bool)
    active[0] = True
    state, _, acted = apply_cuts(start, table, active, cuts, 2)
    assert not acted[1].any()
    d = np.concatenate([np.eye(2), -np.eye(2)])
    heights = support.constrained_support(state.center, state.generators, state.matrix, state.offset, d)
    np.testing.assert_allclose(heights[1], 1.0, atol=1e-6)
    assert (heights[0] < 0.8).all()


def test_known_inputs_act_through_their_lags() -> None:
    """A steering command acts two samples later, and the input box that holds it reuses its factor then."""
    rng = np.random.default_rng(0)
    center, half = np.tile([0.2, 1.0], (3, 1)), np.zeros((3, 2))
    half[0, 0] = 0.3
    past = np.array([[0.1, 1.0], [-0.1, 1.0]])
    y = np.array([0.0, 0.0, 0.0, 1.0])
    tube = propagate(
        FactorSet.zonotope(y[None], np.zeros((1, 4, 0))), InputSets(past[None], center[None], half[None]),
        svea_model(0), np.zeros((4, 0)), LAYOUT, no_cuts(PROFILE), np.zeros((1, 4, 0), dtype=bool),
    )  # fmt: skip
    u = spread(rng, center, half, 500)
    steering = [np.full(500, -0.1), np.full(500, 0.1), u[:, 0, 0]]
    state = np.broadcast_to(y, (500, 4))
    for k in range(3):
        state = svea_step(SVEA, state, steering[k], u[:, k, 1])
        assert inside(tube.steps[k + 1], 0, state, rng).all()


def test_two_vehicles_get_what_each_gets_alone() -> None:
    rng = np.random.default_rng(0)
    y = rng.normal(size=(2, 4))
    inputs = InputSets(rng.normal(size=(2, 2, 2)) * 0.1, np.zeros((2, 5, 2)), np.full((2, 5, 2), 0.1))
    start = FactorSet.zonotope(y, np.broadcast_to(0.01 * np.eye(4), (2, 4, 4)))
    nothing = np.zeros((2, 6, 0), dtype=bool)
    table, process = no_cuts(PROFILE), np.diag(SVEA.process_noise)
    both = propagate(start, inputs, two_vehicles(svea_model(1)), process, LAYOUT, table, nothing)
    for v in range(2):
        row = slice(v, v + 1)
        alone = propagate(
            FactorSet(start.center[row], start.generators[row], start.matrix[row], start.offset[row]),
            InputSets(inputs.past[row], inputs.center[row], inputs.half[row]),
            svea_model(1), process, LAYOUT, table, nothing[row],
        )  # fmt: skip
        for k in range(6):
            np.testing.assert_allclose(both.steps[k].center[v], alone.steps[k].center[0], atol=1e-12)
            width, width_alone = (np.abs(s.steps[k].generators[i]).sum(axis=1) for s, i in ((both, v), (alone, 0)))
            np.testing.assert_allclose(width, width_alone, rtol=1e-9)


def test_reduction_drops_the_oldest_rows_only_and_encloses() -> None:
    rng = np.random.default_rng(0)
    G, A = rng.normal(size=(1, 3, 30)), rng.normal(size=(1, 11, 30))
    factor = rng.uniform(-1, 1, 30)
    sets = FactorSet(np.zeros((1, 3)), G, A, A @ factor)
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
