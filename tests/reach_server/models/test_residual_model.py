"""The residual function of systems that are known: every bound from data holds it, and the noise set the noise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet_bus.messages import Lipschitz
from reach_server.data.regressors import RegressorSpec, Transitions, transitions
from reach_server.models.residual_model import (
    Model,
    NoiseBounds,
    ResidualSet,
    apply,
    fit,
    least_squares,
    position_error,
    residual_set,
)
from reach_server.numeric.types import FloatArray
from tests.reach_server.drives import (
    LAYOUT,
    PROFILE,
    SVEA,
    World,
    block_of,
    dynamics,
    history,
    noise,
    step,
    svea_transitions,
)
from tests.reach_server.ugly import moderate
from vehicle_agent.svea import SPEED_COVERED

WORLD = World()
BOUNDS = NoiseBounds.of(PROFILE, LAYOUT)


def data_of(z: FloatArray, target: FloatArray) -> Transitions:
    return Transitions(z[None], target[None], np.ones((1, len(z)), dtype=bool), np.zeros((1, target.shape[1])))


def holds(found: ResidualSet, values: FloatArray, seed: int = 0) -> bool:
    """Whether values (K, n) pass the support inequality of the set, in axes and random directions."""
    n = values.shape[1]
    d = np.concatenate([np.eye(n), -np.eye(n), np.random.default_rng(seed).normal(size=(40, n))])
    d /= np.abs(found.generators[0]).sum(axis=1) + 1e-12
    height = d @ found.center[0] + np.abs(d @ found.generators[0]).sum(axis=1)
    return bool((values @ d.T <= height + 1e-9 * (1 + np.abs(height))).all())


def in_box(rng: np.random.Generator, center: FloatArray, half: FloatArray, count: int) -> FloatArray:
    share = rng.uniform(-1, 1, (count, len(center)))
    share[: count // 2] = np.sign(share[: count // 2])
    return np.asarray(center + share * half)


@moderate
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_world_residuals_lie_in_their_bounds(seed: int, membership: bool) -> None:
    drive = WORLD.drive(seed % 20)
    data = transitions(block_of(drive.measured, drive.inputs), WORLD.layout)
    assert WORLD.profile.lipschitz is not None
    model = fit(data, WORLD.layout, NoiseBounds.of(WORLD.profile, WORLD.layout), WORLD.profile.lipschitz)
    rng = np.random.default_rng(seed)
    center, half = rng.uniform(-2, 2, 4), rng.uniform(0, 1, 4) * rng.choice([0.0, 0.1, 1.0])
    xi = in_box(rng, center, half, 200)
    error = WORLD.f(xi) - apply(model.matrix, xi[None])[0]
    found = residual_set(model, center[None], half[None], membership=membership)
    assert not found.contradicted.any()
    assert holds(found, error)


def svea_model(seed: int) -> Model:
    drive = history(seed)
    return fit(transitions(block_of(drive.measured, drive.inputs), LAYOUT), LAYOUT, BOUNDS, PROFILE.lipschitz)


@moderate
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_body_frame_residuals_lie_in_their_bounds(seed: int, membership: bool) -> None:
    model = svea_model(seed % 4)
    rng = np.random.default_rng(seed)
    limit = np.array([SPEED_COVERED, *[SVEA.steering_limit, SVEA.velocity_limit] * 3])
    half = limit * rng.uniform(0, 0.5, 7) * rng.choice([0.0, 0.2, 1.0])
    center = rng.uniform(-1, 1, 7) * (limit - half)
    xi = in_box(rng, center, half, 200)
    error = dynamics(xi) - apply(model.matrix, xi[None])[0]
    found = residual_set(model, center[None], half[None], membership=membership)
    assert not found.contradicted.any()
    assert holds(found, error)


@pytest.mark.parametrize("seed", range(6))
def test_any_model_matrix_is_sound(seed: int) -> None:
    """The bounds are taken for the matrix, so also for one that least squares would never give."""
    drive = WORLD.drive(seed)
    data = transitions(block_of(drive.measured, drive.inputs), WORLD.layout)
    poor = Transitions(data.z, data.target, data.usable & (np.arange(160) < 12 + seed), data.newest)
    assert WORLD.profile.lipschitz is not None
    model = fit(poor, WORLD.layout, NoiseBounds.of(WORLD.profile, WORLD.layout), WORLD.profile.lipschitz)
    rng = np.random.default_rng(seed)
    for membership in (True, False):
        center, half = rng.uniform(-1, 1, 4), np.full(4, 0.3)
        xi = in_box(rng, center, half, 500)
        error = WORLD.f(xi) - apply(model.matrix, xi[None])[0]
        assert holds(residual_set(model, center[None], half[None], membership=membership), error)


def noise_set_holds(model: Model, errors: FloatArray) -> bool:
    zero = np.zeros((1, errors.shape[1]))
    return holds(ResidualSet(zero, model.noise, np.zeros(1, dtype=bool)), errors)


@pytest.mark.parametrize("seed", range(4))
def test_the_world_noise_set_holds_every_error(seed: int) -> None:
    drive = WORLD.drive(seed)
    data = transitions(block_of(drive.measured, drive.inputs), WORLD.layout)
    true = transitions(block_of(drive.truth, drive.inputs), WORLD.layout)
    assert WORLD.profile.lipschitz is not None
    model = fit(data, WORLD.layout, NoiseBounds.of(WORLD.profile, WORLD.layout), WORLD.profile.lipschitz)
    usable = data.usable[0]
    exact = WORLD.f(true.z[0, usable]) - apply(model.matrix, true.z)[0, usable]
    measured = data.target[0, usable] - apply(model.matrix, data.z)[0, usable]
    assert noise_set_holds(model, exact - measured)


@pytest.mark.parametrize("heading", [0.004, 0.3, 1.2])
@pytest.mark.parametrize("seed", range(3))
def test_the_body_noise_set_holds_every_error(heading: float, seed: int) -> None:
    """Corners of the noise of both samples, at small and at large errors of the heading."""
    rng = np.random.default_rng(seed)
    measurement = np.diag([0.02, 0.01, heading, 0.03])
    measurement[0, 1] = 0.01
    process = np.diag(SVEA.process_noise)
    count = 400
    xi = np.column_stack([rng.uniform(-1.7, 1.7, count), rng.uniform(-0.7, 0.7, (count, 6))])
    state = np.column_stack([rng.normal(size=(count, 2)), rng.uniform(-3, 3, count), xi[:, 0]])
    after = step(SVEA, state, xi[:, 5], xi[:, 2], noise(rng, process, count))
    before_y, after_y = state + noise(rng, measurement, count), after + noise(rng, measurement, count)
    # One block a transition: two samples each, without lags.
    layout = RegressorSpec(LAYOUT.n, LAYOUT.m, 0, LAYOUT.pose, LAYOUT.free, ())
    pair = np.stack([before_y, after_y], axis=1)
    turned = np.stack([transitions(block_of(p, np.zeros((2, 2))), layout).target[0, 0] for p in pair])
    z = xi.copy()
    z[:, 0] = before_y[:, 3]
    bounds = NoiseBounds(process, measurement)
    model = fit(data_of(z, turned), LAYOUT, bounds, PROFILE.lipschitz)
    exact = dynamics(xi) - apply(model.matrix, xi[None])[0]
    measured = turned - apply(model.matrix, z[None])[0]
    assert noise_set_holds(model, exact - measured)


def test_the_body_noise_set_holds_the_errors_of_a_drive() -> None:
    drive = history(1)
    model = svea_model(1)
    true_z, z, target = svea_transitions(drive)
    exact = dynamics(true_z) - apply(model.matrix, true_z[None])[0]
    assert noise_set_holds(model, exact - (target - apply(model.matrix, z[None])[0]))


@pytest.mark.parametrize("heading", [0.02, 0.3])
@pytest.mark.parametrize("turn", [0.0, 0.8, np.pi / 2, 4.0])
def test_the_position_error_holds_where_it_is_tight(turn: float, heading: float) -> None:
    """Long increments in one direction: what a wrong heading does to them is all of the error."""
    rng = np.random.default_rng(0)
    count, spread = 200, 1e-4
    true = 0.5 * np.array([np.cos(turn), np.sin(turn)])
    off = rng.choice([-1.0, 1.0], count) * heading
    shift = rng.choice([-1.0, 1.0], (count, 2)) * 2 * spread
    c, s = np.cos(off), np.sin(off)
    moved = true + shift
    measured = np.stack([c * moved[:, 0] + s * moved[:, 1], -s * moved[:, 0] + c * moved[:, 1]], axis=1)
    target = np.column_stack([measured, np.zeros((count, 2))])
    bounds = NoiseBounds(np.zeros((4, 0)), np.diag([spread, spread, heading, 0.0]))
    half = position_error(np.abs(target).max(axis=0)[None], LAYOUT, bounds)[0]
    assert (np.abs(measured - true) <= half).all()
    assert (half <= 1.5 * np.abs(measured - true).max(axis=0) + heading**2 + 4 * spread).all()


@pytest.mark.parametrize("membership", [True, False])
@pytest.mark.parametrize("seed", range(8))
def test_the_worst_function_that_agrees_with_a_datum_is_held(seed: int, membership: bool) -> None:
    """e grows from its datum as steeply as L allows, and every error takes what it can: bounds that are met."""
    rng = np.random.default_rng(seed)
    L = rng.uniform(0.1, 2.0, (2, 2))
    layout = RegressorSpec(2, 0, 0, None, (0, 1), ())
    measurement = np.diag(rng.uniform(0.01, 0.1, 2))
    bounds = NoiseBounds(np.diag(rng.uniform(0.01, 0.1, 2)), measurement)
    sign = rng.choice([-1.0, 1.0])
    center, half = rng.normal(size=2), rng.uniform(0, 0.5, 2)
    datum = rng.normal(size=2)
    far = center + half * np.where(center > datum, 1.0, -1.0)
    model = fit(data_of(datum[None], np.zeros((1, 2))), layout, bounds, Lipschitz(matrix=L.tolist(), of="residual"))
    # The true place of the datum is as far from the point asked for as its error allows, e there as far off.
    place = datum - measurement.sum(axis=1) * np.where(center > datum, 1.0, -1.0)
    assert model.held.tolist() == [1]
    start = model.residual[0, :, 0] + sign * np.abs(model.noise[0]).sum(axis=1)
    value = start + sign * (L * np.abs(far - place)).sum(axis=1)
    found = residual_set(model, center[None], half[None], membership=membership)
    assert holds(found, value[None])
    assert not holds(found, (value + sign * 0.01)[None])


@pytest.mark.parametrize("membership", [True, False])
def test_the_counterexample_to_the_printed_algorithm(membership: bool) -> None:
    """f(z) = z up to 1, slope -2 beyond; data {-1, 1}. The paper's set at z = 2 is [0, 4], and f(2) = -1."""
    layout = RegressorSpec(1, 0, 0, None, (0,), ())
    nothing = np.zeros((1, 0))
    data = data_of(np.array([[-1.0], [1.0]]), np.array([[-1.0], [1.0]]))
    model = fit(data, layout, NoiseBounds(nothing, nothing), Lipschitz(lower=[[-2.0]], upper=[[1.0]]))
    np.testing.assert_allclose(model.matrix, [[[0.0, 1.0]]], atol=1e-12)
    for z in np.linspace(-2, 2, 21):
        f = z if z <= 1 else 1 - 2 * (z - 1)
        found = residual_set(model, np.array([[z]]), np.zeros((1, 1)), membership=membership)
        assert holds(found, np.array([[f - z]]))


def test_set_membership_is_smaller_than_the_hull_and_never_larger() -> None:
    model = svea_model(2)
    rng = np.random.default_rng(0)
    for _ in range(20):
        center, half = np.array([[*rng.uniform(-1, 1, 1), *rng.uniform(-0.5, 0.5, 6)]]), np.full((1, 7), 0.05)
        small = residual_set(model, center, half, membership=True).generators
        large = residual_set(model, center, half, membership=False).generators
        widths = [np.abs(g[0]).sum(axis=1) for g in (small, large)]
        assert (widths[0] <= widths[1] + 1e-12).all()
        assert np.prod(widths[0] / widths[1]) < 0.5


def test_data_that_excludes_the_stated_bounds_is_said_to_and_the_hull_taken() -> None:
    z = np.linspace(-1, 1, 30)[:, None]
    layout = RegressorSpec(1, 0, 0, None, (0,), ())
    bounds = NoiseBounds(np.array([[0.001]]), np.array([[0.001]]))
    model = fit(data_of(z, np.sin(40 * z)), layout, bounds, Lipschitz(matrix=[[0.1]], of="residual"))
    found = residual_set(model, np.array([[0.0]]), np.array([[0.1]]), membership=True)
    assert found.contradicted.all()
    hull = residual_set(model, np.array([[0.0]]), np.array([[0.1]]), membership=False)
    np.testing.assert_array_equal(found.generators, hull.generators)
    np.testing.assert_array_equal(found.center, hull.center)


def test_a_set_far_from_the_data_grows() -> None:
    model = svea_model(0)
    near, far = (
        residual_set(model, np.full((1, 7), value), np.zeros((1, 7)), membership=True) for value in (0.0, 50.0)
    )
    assert (np.abs(far.generators).sum(axis=2) > 10 * np.abs(near.generators).sum(axis=2)).all()


def test_places_without_a_datum_do_not_count() -> None:
    drive = history(0)
    data = transitions(block_of(drive.measured, drive.inputs), LAYOUT)
    wrecked = Transitions(
        np.where(data.usable[..., None], data.z, 1e3),
        np.where(data.usable[..., None], data.target, 1e3),
        data.usable,
        data.newest,
    )
    for one, other in zip(
        (fit(d, LAYOUT, BOUNDS, PROFILE.lipschitz) for d in (data, wrecked)),
        (fit(d, LAYOUT, BOUNDS, PROFILE.lipschitz) for d in (wrecked, data)),
        strict=True,
    ):
        np.testing.assert_allclose(one.matrix, other.matrix, atol=1e-12)
        assert (one.held == data.usable.sum(axis=1)).all()
        a, b = (residual_set(m, np.zeros((1, 7)), np.full((1, 7), 0.1), membership=True) for m in (one, other))
        np.testing.assert_allclose(a.generators, b.generators, atol=1e-12)


def test_least_squares_agrees_with_numpy_and_says_where_data_is_deficient() -> None:
    rng = np.random.default_rng(0)
    z = rng.normal(size=(2, 60, 3)) * [1.0, 100.0, 1e-3] + [5.0, -2e3, 0.0]
    z[1, :, 1] = 7.0
    true = rng.normal(size=(2, 2, 4))
    target = apply(true, z) + 0.01 * rng.normal(size=(2, 60, 2))
    usable = rng.random((2, 60)) < 0.8
    matrix, deficient = least_squares(Transitions(z, target, usable, np.zeros((2, 2))))
    np.testing.assert_array_equal(deficient, [False, True])
    for v in range(2):
        design = np.column_stack([np.ones(60), z[v]])[usable[v]]
        expected = np.linalg.lstsq(design, target[v][usable[v]], rcond=None)[0].T
        np.testing.assert_allclose(
            apply(matrix, z)[v][usable[v]], design @ expected.T, atol=1e-7 * np.abs(target).max()
        )
    np.testing.assert_array_equal(matrix[1][:, 2], 0.0)


def test_process_noise_of_the_body_is_turned_any_way_in_the_world() -> None:
    layout = RegressorSpec.of(PROFILE, "world")
    world = NoiseBounds.of(PROFILE, layout).process
    rng = np.random.default_rng(0)
    w = noise(rng, np.diag(SVEA.process_noise), 500)
    angle = rng.uniform(-np.pi, np.pi, 500)
    w[:, :2] = np.stack(
        [np.cos(angle) * w[:, 0] - np.sin(angle) * w[:, 1], np.sin(angle) * w[:, 0] + np.cos(angle) * w[:, 1]], axis=1
    )
    assert (np.abs(w) <= np.abs(world).sum(axis=1) + 1e-12).all()
