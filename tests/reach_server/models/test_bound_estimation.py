"""Bounds from data: consistent, near the truth where it is known, and never contradicted by their own data."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog

from fleet_bus.errors import UsageError
from fleet_bus.messages import Lipschitz
from fleet_lab.systems import System, drive, linear, systems
from reach_server.data.regressors import RegressorSpec, Transitions, transitions
from reach_server.data.window import Block
from reach_server.models.bound_estimation import ConsistentBounds, consistent_bounds, nearest, noise_added, violations
from reach_server.models.residual_model import NoiseBounds, apply, fit, least_squares, residual_set
from reach_server.numeric.types import FloatArray
from tests.reach_server.drives import LAYOUT, PROFILE, block_of, history

KNOWN = {system.name: system for system in systems()}


def data_of(
    system: System, samples: int = 200, vehicles: int = 1, seed: int = 0
) -> tuple[Transitions, RegressorSpec, FloatArray]:
    drives = drive(system, vehicles, samples, np.random.default_rng(seed))
    x, u = (np.swapaxes(a, 0, 1) for a in (drives.measured, drives.inputs))
    yes = np.ones(x.shape[:2], dtype=bool)
    t = np.zeros(x.shape[:2], dtype=np.int64)
    block = Block(t, x, u, yes, yes, yes & (np.arange(samples) > 0))
    layout = RegressorSpec.of(system.profile)
    return transitions(block, layout), layout, np.abs(system.noise("measurement")).sum(axis=1)


def excesses(
    data: Transitions, layout: RegressorSpec, matrix: FloatArray, z_v: FloatArray, found: ConsistentBounds
) -> FloatArray:
    """By how much (V, n) the worst pair of kept data exceeds the bounds: all pairs, one by one."""
    gated = Transitions(data.z, data.target, found.retained, data.newest)
    residual = data.target - apply(matrix, data.z)
    z_noise = np.concatenate([z_v[list(layout.free)], np.zeros(layout.regressors - len(layout.free))])
    added = noise_added(gated, layout, matrix, z_v)
    worst = []
    for v, retained in enumerate(found.retained):
        r, z = residual[v, retained], data.z[v, retained]
        distance = np.abs(z[:, None] - z[None]) + 2 * z_noise
        allowed = 2 * (found.w + added[v]) + distance @ found.slope.T
        worst.append((np.abs(r[:, None] - r[None]) - allowed).max(axis=(0, 1)))
    return np.array(worst)


@pytest.mark.parametrize("name", KNOWN)
def test_no_pair_contradicts_the_bounds_and_none_would_do_with_less(name: str) -> None:
    system = KNOWN[name]
    data, layout, z_v = data_of(system)
    matrix, _ = least_squares(data)
    found = consistent_bounds(data, layout, matrix, z_v)
    size = np.ptp(data.target[0][data.usable[0]], axis=0)
    assert (excesses(data, layout, matrix, z_v, found) <= 1e-9 * size).all()
    tighter = ConsistentBounds(0.9 * found.w, 0.9 * found.slope, found.retained)
    residual = (data.target - apply(matrix, data.z))[0][found.retained[0]]
    binding = (found.w > 1e-6 * size) | (found.slope > 1e-6).any(axis=1)
    missed = excesses(data, layout, matrix, z_v, tighter)[0] > 1e-6 * np.ptp(residual, axis=0)
    assert binding.any()
    np.testing.assert_array_equal(missed[binding], True)


@pytest.mark.parametrize("name", KNOWN)
def test_set_membership_is_not_contradicted_by_the_data_that_the_bounds_are_from(name: str) -> None:
    """At any place, near the data and far from it."""
    system = KNOWN[name]
    data, layout, z_v = data_of(system)
    matrix, _ = least_squares(data)
    found = consistent_bounds(data, layout, matrix, z_v)
    gated = Transitions(data.z, data.target, found.retained, data.newest)
    bounds = NoiseBounds(np.diag(found.w), np.diag(z_v))
    model = fit(gated, layout, bounds, Lipschitz(matrix=found.slope.tolist(), of="residual"))
    np.testing.assert_allclose(model.matrix, matrix, atol=1e-9 * np.abs(matrix).max())
    rng = np.random.default_rng(0)
    span = np.ptp(data.z[0][found.retained[0]], axis=0)
    for share in (0.0, 0.5, 3.0):
        center = data.z[0][rng.integers(0, 150)] + share * span * rng.normal(size=len(span))
        sets = residual_set(model, center[None], np.zeros((1, len(span))), membership=True)
        assert not sets.contradicted.any()


def test_the_linear_program_finds_what_one_over_all_pairs_finds() -> None:
    """Noise and slopes known, few data: the whole program at once by HiGHS."""
    data, layout, z_v = data_of(KNOWN["kink"], samples=45)
    matrix, _ = least_squares(data)
    found = consistent_bounds(data, layout, matrix, z_v)
    retained = found.retained[0]
    z, residual = data.z[0, retained], (data.target - apply(matrix, data.z))[0, retained]
    z_noise = np.concatenate([z_v[list(layout.free)], np.zeros(layout.regressors - len(layout.free))])
    weight = 1 / np.ptp(z, axis=0)
    others = np.where(np.eye(len(z), dtype=bool), np.inf, (np.abs(z[:, None] - z[None]) * weight).sum(axis=2)).argmin(1)
    costs = np.append(1.0, np.abs(z - z[others]).mean(axis=0) + 2 * z_noise)
    added = noise_added(Transitions(data.z, data.target, found.retained, data.newest), layout, matrix, z_v)[0]
    j, k = np.triu_indices(len(z), 1)
    rows = np.column_stack([np.full(len(j), 2.0), np.abs(z[j] - z[k]) + 2 * z_noise])
    for i in range(layout.n):
        needed = np.abs(residual[j, i] - residual[k, i]) - 2 * added[i]
        best = linprog(costs, A_ub=-rows, b_ub=-needed, bounds=(0, None))
        assert best.fun is not None
        reached = float(costs @ np.append(found.w[i], found.slope[i]))
        # What violations are left to w costs a little.
        assert best.fun - 1e-12 <= reached <= best.fun + 1e-3 * np.ptp(residual[:, i])


def test_bounds_of_a_known_system_are_found_again() -> None:
    data, layout, z_v = data_of(linear(), samples=1000)
    matrix, _ = least_squares(data)
    found = consistent_bounds(data, layout, matrix, z_v)
    assert found.retained.sum() == data.usable.sum()
    np.testing.assert_allclose(found.w, 0.01, rtol=0.1)
    assert (found.slope < 0.01).all()
    lower, upper = found.derivatives(matrix)
    assert (lower <= matrix[0, :, 1:]).all()
    assert (matrix[0, :, 1:] <= upper).all()


def test_bounds_of_several_vehicles_agree_with_each_but_not_across() -> None:
    """Each vehicle has its own model, so pairs of two vehicles say nothing."""
    data, layout, z_v = data_of(KNOWN["stiff"], vehicles=3)
    matrix, _ = least_squares(data)
    together = consistent_bounds(data, layout, matrix, z_v)
    assert (excesses(data, layout, matrix, z_v, together) <= 1e-9 * np.abs(data.target).max(axis=(0, 1))).all()
    moved = Transitions(data.z, data.target + np.arange(3)[:, None, None] * 1e3, data.usable, data.newest)
    shifted, _ = least_squares(moved)
    apart = consistent_bounds(moved, layout, shifted, z_v)
    np.testing.assert_allclose(apart.w, together.w, rtol=1e-6, atol=1e-9)
    lower, upper = together.derivatives(matrix)
    for one in matrix:
        assert (lower <= one[:, 1:] - together.slope + 1e-12).all()
        assert (one[:, 1:] + together.slope <= upper + 1e-12).all()


def test_outliers_are_gated_and_nothing_else() -> None:
    data, layout, z_v = data_of(linear(), samples=400)
    target = data.target.copy()
    wrong = np.array([50, 120, 300])
    target[0, wrong, 1] += np.array([5.0, -4.0, 6.0])
    wrecked = Transitions(data.z, target, data.usable, data.newest)
    matrix, _ = least_squares(data)
    found = consistent_bounds(wrecked, layout, matrix, z_v)
    np.testing.assert_array_equal(np.flatnonzero(data.usable[0] & ~found.retained[0]), wrong)
    clean = consistent_bounds(data, layout, matrix, z_v)
    np.testing.assert_allclose(found.w, clean.w, rtol=0.05)


@pytest.mark.parametrize("name", KNOWN)
def test_what_measurement_noise_adds_is_what_the_noise_set_of_the_model_has(name: str) -> None:
    system = KNOWN[name]
    data, layout, z_v = data_of(system)
    model = fit(data, layout, NoiseBounds(np.zeros((layout.n, 0)), np.diag(z_v)), system.profile.lipschitz)
    np.testing.assert_allclose(
        noise_added(data, layout, model.matrix, z_v), np.abs(model.noise).sum(axis=2), rtol=1e-9, atol=1e-12
    )


def test_bounds_without_data_or_variation() -> None:
    layout = RegressorSpec(1, 1, 0, None, (0,), ())
    z = np.column_stack([np.linspace(-1, 1, 20), np.full(20, 0.3)])[None]
    usable = np.ones((1, 20), dtype=bool)
    data = Transitions(z, 0.5 * z[..., :1] + 0.1, usable, np.zeros((1, 1)))
    matrix, _ = least_squares(data)
    found = consistent_bounds(data, layout, matrix, np.zeros(1))
    assert found.w == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(found.slope, 0.0, atol=1e-12)
    with pytest.raises(UsageError, match="two transitions"):
        consistent_bounds(
            Transitions(z, data.target, usable & (np.arange(20) < 1), data.newest), layout, matrix, np.zeros(1)
        )


def test_kernels_agree_with_all_pairs() -> None:
    rng = np.random.default_rng(0)
    z, values, slope = rng.normal(size=(40, 3)), rng.normal(size=40), rng.uniform(0, 0.4, 3)
    excess, other = violations(z, values, np.argsort(values), slope, 0.3)
    all_pairs = values[:, None] - values - 0.3 - np.abs(z[:, None] - z[None]) @ slope
    np.testing.assert_allclose(excess, np.maximum(all_pairs.max(axis=1), 0.0), atol=1e-12)
    positive = excess > 0
    assert positive.any()
    np.testing.assert_allclose(all_pairs[positive, other[positive]], excess[positive], atol=1e-12)
    weight = np.array([1.0, 0.0, 2.0])
    asked: NDArray[np.intp] = np.array([0, 7, 39])
    distance = np.abs(z[asked, None] - z[None]) @ weight
    distance[range(3), asked] = np.inf
    np.testing.assert_array_equal(nearest(z, weight, asked), distance.argmin(axis=1))


@pytest.mark.slow
def test_a_real_scale_window_of_the_simulated_car() -> None:
    drive_of_car = history(0, 1000)
    data = transitions(block_of(drive_of_car.measured, drive_of_car.inputs), LAYOUT)
    matrix, _ = least_squares(data)
    assert PROFILE.noise.measurement is not None
    z_v = np.abs(PROFILE.noise.measurement.matrix()).sum(axis=1)
    found = consistent_bounds(data, LAYOUT, matrix, z_v)
    assert (excesses(data, LAYOUT, matrix, z_v, found) <= 1e-9).all()
    # Never more than what is true of the car: its own bounds are among those that agree with the data.
    assert PROFILE.noise.process is not None
    assert PROFILE.lipschitz is not None
    true_w = np.abs(PROFILE.noise.process.matrix()).sum(axis=1)
    slopes = matrix[0, :, 1:]
    true_slope = np.maximum(
        np.abs(np.array(PROFILE.lipschitz.lower) - slopes), np.abs(np.array(PROFILE.lipschitz.upper) - slopes)
    )
    assert (found.w + found.slope.sum(axis=1) <= true_w + true_slope.sum(axis=1)).all()
