"""All linear models that agree with the data: never made one by one, equal to what making them gives, and outer."""

from dataclasses import fields

import numpy as np
import pytest

from benchmarks.containment import held_by
from fleet_bus.errors import UsageError
from fleet_bus.messages import Lipschitz
from fleet_lab.systems import Drives, System, continuations, correlated, delayed, drive, linear, members, stiff
from reach_server.data.input_sets import InputSets, future_inputs
from reach_server.data.regressors import RegressorSpec, Transitions, lagged_inputs, transitions
from reach_server.data.window import Block
from reach_server.models.matrix_zonotope import LinearModels, LinearMotion, fit, l1_norms
from reach_server.models.residual_model import NoiseBounds
from reach_server.numeric.slot_table import take_rows
from reach_server.numeric.types import FloatArray
from reach_server.sets.raw import RawSets
from tests.reach_server.drives import LAYOUT
from vehicle_agent.angles import wrap

SYSTEMS = {system.name: system for system in (linear(), delayed(), correlated())}
LENGTH = 120


def block_of(system: System, drives: Drives, last: int) -> Block:
    """The samples of all vehicles up to ``last``, as they are received."""
    x, u = (np.swapaxes(a[last + 1 - LENGTH : last + 1], 0, 1) for a in (drives.measured, drives.inputs))
    yes = np.ones(x.shape[:2], dtype=bool)
    t = np.arange(LENGTH, dtype=np.int64)[None] * system.profile.sample_time_ns
    return Block(np.repeat(t, len(x), axis=0), x, u, yes, yes, yes & (np.arange(LENGTH) > 0))


def models_of(
    system: System, seed: int, vehicles: int = 4, *, stated: bool = True
) -> tuple[LinearModels, Drives, Block, RegressorSpec, NoiseBounds]:
    drives = drive(system, vehicles, LENGTH + 20, np.random.default_rng(seed))
    layout = RegressorSpec.of(system.profile)
    bounds = NoiseBounds.of(system.profile, layout)
    block = block_of(system, drives, LENGTH - 1)
    models = fit(transitions(block, layout), layout, bounds, system.profile.lipschitz if stated else None)
    return models, drives, block, layout, bounds


def dynamics_of(system: System) -> tuple[FloatArray, FloatArray]:
    """(A, M): what the steps of a linear system multiply states and regressors by."""
    n, m, lags = system.n, system.limits.shape[1], system.profile.input_lags
    z = np.eye(n + m * (lags + 1))
    M = system.step(z[:, :n], z[:, n:].reshape(-1, lags + 1, m), np.zeros((len(z), n))).T
    return M[:, :n], M


def heights(center: FloatArray, generators: FloatArray, d: FloatArray) -> FloatArray:
    return np.asarray(d @ center + np.abs(d @ generators).sum(axis=1))


@pytest.mark.parametrize("seed", range(4))
def test_the_product_is_that_with_every_generator_of_the_matrix_zonotope(seed: int) -> None:
    """Made as published: a generator matrix g_i d_t for every datum, each times every generator of the set."""
    rng = np.random.default_rng(seed)
    n, m, T = 2, 1, 12
    layout = RegressorSpec(n, m, 0, None, (0, 1), ())
    bounds = NoiseBounds(0.1 * rng.normal(size=(n, 2)), 0.01 * rng.normal(size=(n, 3)))
    data = Transitions(
        rng.normal(size=(1, T, n + m)), rng.normal(size=(1, T, n)), np.ones((1, T), dtype=bool), np.zeros((1, n))
    )
    models = fit(data, layout, bounds)
    D = data.z[0].T
    inverse = np.linalg.pinv(D)
    matrix = data.target[0].T @ inverse
    np.testing.assert_allclose(models.matrix[0], matrix, atol=1e-12)
    made = [np.outer(g, row) for g in models.noise[0].T for row in inverse]
    start = RawSets.zonotope(rng.normal(size=(1, n)), 0.3 * rng.normal(size=(1, n, 4)))
    inputs = InputSets(np.zeros((1, 0, m)), rng.normal(size=(1, 1, m)), rng.uniform(0, 1, (1, 1, m)))
    motion = LinearMotion(inputs, models, bounds.process, layout, retained_generators=500)
    rows = np.arange(1)
    found, _ = motion.advance(motion.begin(start, rows), 0, rows)
    center = np.concatenate([start.center[0], inputs.center[0, 0]])
    generators = np.zeros((n + m, 5))
    generators[:n, :4], generators[n:, 4] = start.generators[0], inputs.half[0, 0]
    products = [matrix @ generators, bounds.process]
    products += [G @ np.column_stack([center, generators]) for G in made]
    expected = np.concatenate(products, axis=1)
    d = rng.normal(size=(60, n))
    np.testing.assert_allclose(
        heights(found.center[0], found.generators[0], d), heights(matrix @ center, expected, d), rtol=1e-9
    )
    assert found.generators.shape[2] < 20 < expected.shape[1]


def test_norms_are_those_of_the_rows_one_by_one() -> None:
    rng = np.random.default_rng(0)
    inverse, vectors = rng.normal(size=(3, 7, 4)), rng.normal(size=(5, 4, 6))
    vehicle = np.array([2, 0, 0, 1, 2])
    expected = [np.abs(inverse[v] @ vectors[row]).sum(axis=0) for row, v in enumerate(vehicle)]
    np.testing.assert_allclose(l1_norms(inverse, vehicle, vectors), expected, rtol=1e-12)


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("name", SYSTEMS)
def test_what_the_measurement_noise_does_is_bounded_with_slopes_and_without(name: str, stated: bool) -> None:
    system = SYSTEMS[name]
    A, M = dynamics_of(system)
    rng = np.random.default_rng(0)
    for seed in range(5):
        models, _, block, layout, _ = models_of(system, seed, stated=stated)
        assert models.determined.all()
        assert not models.contradicted.any()
        data = transitions(block, layout)
        # Every column of N: what the true dynamics leave of the measured data.
        columns = data.target - data.z @ M.T
        zero = np.zeros((len(models.noise), system.n))
        assert held_by(zero, models.noise, np.where(data.usable[..., None], columns, 0.0)).all()
        v = members(rng, system.noise("measurement"), (len(zero), 50))
        assert held_by(zero, models.noise, v - v[:, ::-1] @ A.T).all()


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("name", SYSTEMS)
def test_no_state_that_can_be_reached_lies_outside(name: str, stated: bool) -> None:
    system = SYSTEMS[name]
    horizon = 10
    for seed in range(3):
        models, drives, block, layout, bounds = models_of(system, seed, stated=stated)
        u = lagged_inputs(block, layout)[:, -1].reshape(len(block.x), layout.lags + 1, layout.m)
        later = np.swapaxes(drives.inputs[LENGTH : LENGTH + horizon - 1], 0, 1)
        tolerance = system.plan_tolerance
        inputs = future_inputs(
            system.profile, u[:, 1:], u[:, 0], block.input_known[:, -1], horizon,
            None if tolerance is None else later,
            None if tolerance is None else np.broadcast_to(tolerance, (len(later), layout.m)),
        )  # fmt: skip
        rows = np.arange(len(block.x))
        motion = LinearMotion(inputs, models, bounds.process, layout)
        measurement = np.broadcast_to(bounds.measurement, (len(rows), *bounds.measurement.shape))
        sets = motion.begin(RawSets.zonotope(block.x[:, -1], measurement), rows)
        states = continuations(system, drives, LENGTH - 1, 200, horizon, np.random.default_rng(seed))
        for h in range(horizon):
            sets, wrong = motion.advance(sets, h, rows)
            assert not wrong.any()
            n = system.n
            assert held_by(sets.center[:, :n], sets.generators[:, :n], states[:, :, h]).all(), h
            # Useful, too: a few times what is reached.
            reached = np.ptp(states[:, :, h], axis=1)
            assert (2 * np.abs(sets.generators[:, :n]).sum(axis=2) < 30 * reached).all()


def test_without_noise_the_set_is_the_reachable_one() -> None:
    rng = np.random.default_rng(0)
    A, B = np.array([[0.9, 0.2], [-0.3, 0.8]]), rng.normal(size=(2, 2, 1))
    layout = RegressorSpec(2, 1, 1, None, (0, 1), ())
    nothing = NoiseBounds(np.zeros((2, 0)), np.zeros((2, 0)))
    z = rng.normal(size=(1, 30, 4))
    data = Transitions(z, z @ np.column_stack([A, *B]).T, np.ones((1, 30), dtype=bool), np.zeros((1, 2)))
    models = fit(data, layout, nothing)
    inputs = InputSets(rng.normal(size=(1, 1, 1)), rng.normal(size=(1, 5, 1)), rng.uniform(0, 1, (1, 5, 1)))
    motion = LinearMotion(inputs, models, nothing.process, layout, retained_generators=100)
    rows = np.arange(1)
    sets = motion.begin(RawSets.zonotope(np.ones((1, 2)), 0.1 * np.eye(2)[None]), rows)
    middle, spread = np.ones(2), np.zeros((2, 2 + 5))
    spread[:, :2] = 0.1 * np.eye(2)
    held_center, held = inputs.past[0, 0], np.zeros((1, 7))
    for k in range(5):
        sets, _ = motion.advance(sets, k, rows)
        now = np.zeros((1, 7))
        now[0, 2 + k] = inputs.half[0, k, 0]
        middle = A @ middle + B[0] @ inputs.center[0, k] + B[1] @ held_center
        spread = A @ spread + B[0] @ now + B[1] @ held
        held_center, held = inputs.center[0, k], now
        d = rng.normal(size=(20, 2))
        np.testing.assert_allclose(
            heights(sets.center[0, :2], sets.generators[0, :2], d), heights(middle, spread, d), rtol=1e-8
        )


def test_data_that_does_not_determine_the_model_is_told() -> None:
    system = SYSTEMS["linear"]
    drives = drive(system, 3, LENGTH, np.random.default_rng(0))
    drives.inputs[:, 0] = 0.0
    layout = RegressorSpec.of(system.profile)
    bounds = NoiseBounds.of(system.profile, layout)
    data = transitions(block_of(system, drives, LENGTH - 1), layout)
    few = data.usable.copy()
    few[1, 3:] = False
    models = fit(Transitions(data.z, data.target, few, data.newest), layout, bounds)
    np.testing.assert_array_equal(models.determined, [False, False, True])
    assert all(np.isfinite(getattr(take_rows(models, [2]), f.name)).all() for f in fields(models))


def test_noise_as_large_as_the_states_needs_slopes_from_the_profile() -> None:
    system = SYSTEMS["linear"]
    layout = RegressorSpec.of(system.profile)
    loud = NoiseBounds(system.noise("process"), 2.0 * np.eye(3))
    data = transitions(block_of(system, drive(system, 1, LENGTH, np.random.default_rng(0)), LENGTH - 1), layout)
    assert not fit(data, layout, loud).determined.any()
    assert fit(data, layout, loud, system.profile.lipschitz).determined.all()
    magnitude = Lipschitz(matrix=[[1.0] * 4] * 3, of="dynamics")
    assert fit(data, layout, loud, magnitude).determined.all()
    # Slopes of the residual function say nothing about A.
    assert not fit(data, layout, loud, Lipschitz(matrix=[[1.0] * 4] * 3, of="residual")).determined.any()


def test_places_without_a_datum_do_not_count() -> None:
    system = SYSTEMS["delay"]
    models, _, block, layout, bounds = models_of(system, 0)
    data = transitions(block, layout)
    wrecked = Transitions(
        np.where(data.usable[..., None], data.z, np.nan), np.where(data.usable[..., None], data.target, np.inf),
        data.usable, data.newest,
    )  # fmt: skip
    other = fit(wrecked, layout, bounds, system.profile.lipschitz)
    for f in fields(models):
        np.testing.assert_array_equal(getattr(models, f.name), getattr(other, f.name))


def test_a_system_that_is_not_linear_contradicts_itself() -> None:
    """The stiff one, told to have next to no noise."""
    system = stiff()
    layout = RegressorSpec.of(system.profile)
    data = transitions(block_of(system, drive(system, 2, LENGTH, np.random.default_rng(0)), LENGTH - 1), layout)
    quiet = NoiseBounds(1e-4 * system.noise("process"), 1e-4 * system.noise("measurement"))
    models = fit(data, layout, quiet)
    assert models.contradicted.all()
    inputs = InputSets(np.zeros((2, 0, 1)), np.zeros((2, 1, 1)), np.zeros((2, 1, 1)))
    motion = LinearMotion(inputs, models, quiet.process, layout)
    start = motion.begin(RawSets.zonotope(np.zeros((2, 2)), np.zeros((2, 2, 0))), np.arange(2))
    assert motion.advance(start, 0, np.arange(2))[1].all()


def test_equal_data_gives_equal_sets_whatever_else_is_in_the_batch() -> None:
    models, _, block, layout, bounds = models_of(SYSTEMS["delay"], 0, vehicles=5)
    alone = fit(transitions(take_rows(block, [3]), layout), layout, bounds, SYSTEMS["delay"].profile.lipschitz)
    for f in fields(models):
        np.testing.assert_array_equal(getattr(models, f.name)[3:4], getattr(alone, f.name))
    rng = np.random.default_rng(0)
    inputs = InputSets(rng.normal(size=(5, 3, 1)), rng.normal(size=(5, 2, 1)), rng.uniform(0, 1, (5, 2, 1)))
    start = RawSets.zonotope(block.x[:, -1], rng.normal(size=(5, 2, 3)))

    def after(which: list[int], fitted: LinearModels) -> RawSets:
        motion = LinearMotion(take_rows(inputs, which), fitted, bounds.process, layout)
        rows = np.arange(len(which))
        sets = motion.begin(take_rows(start, which), rows)
        for k in range(2):
            sets, _ = motion.advance(sets, k, rows)
        return sets

    for one, other in (
        (after([3], alone), take_rows(after(list(range(5)), models), [3])),
        (after([4, 3], take_rows(models, [4, 3])), take_rows(after(list(range(5)), models), [4, 3])),
    ):
        np.testing.assert_array_equal(one.center, other.center)
        np.testing.assert_array_equal(one.generators, other.generators)


def test_an_angle_is_held_in_the_turn_of_the_data() -> None:
    """A heading that goes round and round: the model speaks about the turn of the newest sample."""
    rng = np.random.default_rng(0)
    u = rng.uniform(0.2, 0.6, (1, 80, 1))
    heading = np.concatenate([[0.0], np.cumsum(u[0, :-1, 0])])
    x = np.stack([wrap(heading), 0.5 * np.sin(heading)], axis=1)[None]
    layout = RegressorSpec(2, 1, 0, None, (0, 1), (0,))
    yes = np.ones((1, 80), dtype=bool)
    block = Block(np.arange(80, dtype=np.int64)[None], x, u, yes, yes, yes & (np.arange(80) > 0))
    data = transitions(block, layout)
    models = fit(data, layout, NoiseBounds(np.diag([1e-9, 1.0]), np.zeros((2, 0))))
    assert models.newest[0, 0] == pytest.approx(heading[-1])
    assert models.matrix[0, 0] == pytest.approx([1.0, 0.0, 1.0])


def test_increments_of_a_body_frame_are_refused() -> None:
    zero = np.zeros((1, 4, 7))
    data = Transitions(zero, np.zeros((1, 4, 4)), np.ones((1, 4), dtype=bool), np.zeros((1, 4)))
    with pytest.raises(UsageError, match="frame: world"):
        fit(data, LAYOUT, NoiseBounds(np.zeros((4, 0)), np.zeros((4, 0))))
