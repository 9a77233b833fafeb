"""Compiled bounds of the residual function against slow ones that say the same, on data of all kinds."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.optimize import linprog

from reach_server.models.residual_model import Model, ResidualSet, residual_set, thin_directions
from reach_server.numeric.types import FloatArray
from tests.reach_server.ugly import moderate


def random_model(seed: int, n: int = 3, p: int = 4, count: int = 12, size: float = 1.0) -> Model:
    """A model M = 0 of one vehicle whose data agrees with its bounds: residuals of a function with slopes below L."""
    rng = np.random.default_rng(seed)
    slope = rng.uniform(0, 1, (n, p)) * (rng.random((n, p)) < 0.7)
    z_noise = rng.uniform(0, 0.1, p) * size
    z = rng.normal(size=(count, p)) * size
    noise = np.concatenate([np.diag(rng.uniform(0, 0.2, n)), rng.normal(size=(n, 2)) * 0.3], axis=1) * size
    true = z + rng.uniform(-1, 1, z.shape) * z_noise
    # Slopes of the sine never exceed those of L.
    e = np.sin(true / size) @ slope.T * size
    residual = e + rng.uniform(-1, 1, (count, noise.shape[1])) @ noise.T
    low, high = residual.min(axis=0), residual.max(axis=0)
    return Model(
        np.zeros((1, n, 1 + p)), np.ascontiguousarray(z.T[None]), np.ascontiguousarray(residual.T[None]),
        np.array([count]), low[None], high[None], noise[None], slope[None], z_noise[None],
        thin_directions(noise[None]), np.array([False]), np.zeros((1, n)),
    )  # fmt: skip


def drifts(model: Model, center: FloatArray, half: FloatArray) -> FloatArray:
    """Bounds (T, n) of how far e on the box is from e at each datum."""
    z = model.z[0].T
    return np.asarray((np.abs(center - z) + half + model.z_noise[0]) @ model.slope[0].T)


def hull_of(model: Model, center: FloatArray, half: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Center and generators of the residual hull."""
    drift = drifts(model, center, half)
    width = (model.high[0] - model.low[0]) / 2 + np.abs(model.noise[0]).sum(axis=1)
    weight = 1 / np.maximum(width, 1e-6 * width.max())
    nearest = int(np.argmin(drift @ weight))
    box = (model.high[0] - model.low[0]) / 2 + drift[nearest]
    return (model.high[0] + model.low[0]) / 2, np.column_stack([np.diag(box), model.noise[0]])


def heights(found: ResidualSet, d: FloatArray) -> FloatArray:
    """Support (K,) in the directions (K, n)."""
    return np.asarray(d @ found.center[0] + np.abs(d @ found.generators[0]).sum(axis=1))


def exact_support(model: Model, center: FloatArray, half: FloatArray, d: FloatArray, size: float) -> float:
    """Support of all values of e that agree with every datum: a linear program over e and the noise of each datum, in
    units of ``size``, as its tolerances are absolute."""
    residual, noise, drift = (a / size for a in (model.residual[0].T, model.noise[0], drifts(model, center, half)))
    (count, n), g = residual.shape, noise.shape[1]
    # e = r_j + N a_j + t_j with |a_j| <= 1 and |t_j| <= drift_j.
    equal = np.zeros((count * n, n + count * (g + n)))
    for j in range(count):
        rows, first = slice(j * n, (j + 1) * n), n + j * (g + n)
        equal[rows, :n] = np.eye(n)
        equal[rows, first : first + g] = -noise
        equal[rows, first + g : first + g + n] = -np.eye(n)
    bounds: list[tuple[float | None, float | None]] = [(None, None)] * n
    for j in range(count):
        bounds += [(-1.0, 1.0)] * g + [(-float(t), float(t)) for t in drift[j]]
    cost = np.zeros(equal.shape[1])
    cost[:n] = -d
    solved = linprog(cost, A_eq=equal, b_eq=residual.ravel(), bounds=bounds)
    assert solved.status == 0
    return -float(solved.fun or 0.0) * size


@moderate
@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 2, 3, 5]), st.sampled_from([1e-9, 1.0, 1e6]))
def test_the_hull_is_that_of_the_formula(seed: int, n: int, size: float) -> None:
    model, rng = random_model(seed, n, size=size), np.random.default_rng(seed)
    center, half = rng.normal(size=4) * size, rng.uniform(0, 1, 4) * size
    found = residual_set(model, center[None], half[None], membership=False)
    middle, generators = hull_of(model, center, half)
    d = np.concatenate([np.eye(n), rng.normal(size=(30, n))])
    expected = d @ middle + np.abs(d @ generators).sum(axis=1)
    np.testing.assert_allclose(heights(found, d), expected, rtol=1e-12, atol=1e-12 * size)
    assert (heights(found, d) >= expected - 1e-15 * np.abs(expected)).all()


@moderate
@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 2, 3]), st.sampled_from([1e-9, 1.0, 1e6]))
@pytest.mark.slow
def test_set_membership_holds_what_agrees_with_all_data(seed: int, n: int, size: float) -> None:
    model, rng = random_model(seed, n, count=6, size=size), np.random.default_rng(seed)
    center, half = rng.normal(size=4) * size, rng.uniform(0, 0.5, 4) * size
    found = residual_set(model, center[None], half[None], membership=True)
    assert not found.contradicted.any()
    for d in np.concatenate([np.eye(n), -np.eye(n), rng.normal(size=(4, n))]):
        exact = exact_support(model, center, half, d, size)
        assert exact <= heights(found, d[None])[0] + 1e-7 * size


@moderate
# Of this model every slope is 0: no bound is known, and the hull is taken.
@example(seed=9, n=1)
@given(seed=st.integers(0, 2**32 - 1), n=st.sampled_from([1, 2, 3, 5]))
def test_set_membership_is_never_larger_than_the_hull_of_the_same_data(seed: int, n: int) -> None:
    model, rng = random_model(seed, n), np.random.default_rng(seed)
    center, half = rng.normal(size=4), rng.uniform(0, 0.5, 4)
    plane = (0, 1) if n > 1 else None
    small, hull = (residual_set(model, center[None], half[None], membership=m, plane=plane) for m in (True, False))
    assert size_of(small, n) <= size_of(hull, n) * (1 + 1e-9)
    # Without a bound of slopes no datum speaks about other regressors, and the hull is the set.
    if not model.slope.any():
        np.testing.assert_array_equal(small.generators, hull.generators)
    # In the axes it comes to what the bounds of single data say, or less.
    elif not model.directions.any():
        drift, reach = drifts(model, center, half), np.abs(model.noise[0]).sum(axis=1)
        residual = model.residual[0].T
        width = (residual + drift).min(axis=0) - (residual - drift).max(axis=0) + 2 * reach
        assert (2 * np.abs(small.generators[0]).sum(axis=1) <= width * (1 + 1e-9)).all()


def size_of(found: ResidualSet, n: int) -> float:
    """Area in the plane times the widths of the other coordinates."""
    g = found.generators[0]
    if n == 1:
        return float(2 * np.abs(g).sum())
    cross = np.outer(g[0], g[1])
    return float(2 * np.abs(cross - cross.T).sum() * np.prod(2 * np.abs(g[2:]).sum(axis=1)))


def test_without_any_bound_of_slopes_the_hull_is_taken() -> None:
    model = random_model(0)
    model = replace(model, slope=np.zeros_like(model.slope))
    zero = np.zeros((1, 4))
    small, hull = (residual_set(model, zero, zero, membership=m) for m in (True, False))
    np.testing.assert_array_equal(small.generators, hull.generators)


@pytest.mark.parametrize("wrong", [np.inf, np.nan])
def test_a_set_that_is_not_finite_stays_so(wrong: float) -> None:
    model = random_model(1)
    half = np.full((1, 4), wrong)
    for membership in (True, False):
        found = residual_set(model, np.zeros((1, 4)), half, membership=membership)
        assert not np.isfinite(found.generators).all()
