"""True trajectories stay in the tube at every step: Monte Carlo with corners of every set that is assumed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reach_server.data.input_sets import InputSets
from reach_server.data.regressors import RegressorSpec, Transitions
from reach_server.models.residual_model import NoiseBounds, fit
from reach_server.numeric.slot_table import take_rows
from reach_server.numeric.types import FloatArray
from reach_server.sets.raw import RawSets
from reach_server.tube.recursion import Recursion
from reach_server.tube.rotation_kernel import turn_one
from tests.reach_server.drives import LAYOUT, SVEA, dynamics, inside, noise
from tests.reach_server.tube.trajectories import (
    COUNT,
    HORIZON,
    WORLD,
    assert_all_inside,
    only,
    spread,
    svea_model,
    svea_tube,
    tube_of,
    two_vehicles,
    world_model,
    world_truth,
)
from tests.reach_server.ugly import Raw, gap, moderate
from vehicle_agent.svea import step as svea_step


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
