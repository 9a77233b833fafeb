"""Bounds of quadratic forms: no point of a zonotope beats them, and they are not much too large."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reach_server.predicates.concave import directions
from reach_server.predicates.remainders import greatest_curvature, greatest_quadratic, middle, upper_dot
from tests.examples import examples


@settings(max_examples=examples(100))
@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.integers(0, 40))
def test_no_quadratic_form_is_greater(seed: int, size: int, generators: int) -> None:
    rng = np.random.default_rng(seed)
    rows = 5
    mid = rng.normal(size=(rows, size, size)) * rng.choice([0.0, 1e-9, 1.0, 1e6], (rows, 1, 1))
    mid = mid + np.swapaxes(mid, 1, 2) - rng.choice([0.0, 5.0], (rows, 1, 1)) * np.eye(size)
    radius = np.abs(rng.normal(size=(rows, size, size))) * rng.choice([0.0, 0.1, 1.0], (rows, 1, 1))
    radius = radius + np.swapaxes(radius, 1, 2)
    bounds = mid - radius, mid + radius
    G = rng.normal(size=(rows, size, generators)) * rng.choice([1e-6, 1.0, 1e3], (rows, 1, 1))
    curvature = greatest_curvature(bounds)
    greatest = greatest_quadratic(bounds, G, curvature)
    for _ in range(30):
        sign = rng.uniform(-1, 1, (size, size))
        H = mid + radius * np.sign(sign + sign.T)
        assert (np.linalg.eigvalsh(H)[:, -1] <= curvature + 1e-12 * np.abs(H).sum(axis=(1, 2))).all()
        factors = np.sign(rng.normal(size=(rows, generators))) * rng.choice([1.0, rng.random()])
        d = (G @ factors[..., None])[..., 0]
        form = 0.5 * np.einsum("ri,rij,rj->r", d, H, d)
        assert (form <= greatest + 1e-12 * np.abs(form)).all()


def test_each_of_the_bounds_can_be_the_least() -> None:
    # x y over a diagonal segment: squares of one factor alone.
    saddle = np.array([[[0.0, 1.0], [1.0, 0.0]]])
    falling = np.array([[[1.0], [-1.0]]])
    np.testing.assert_allclose(greatest_quadratic((saddle, saddle), falling, np.array([1.0])), [0.0], atol=1e-14)
    rising = np.array([[[1.0], [1.0]]])
    np.testing.assert_allclose(greatest_quadratic((saddle, saddle), rising, np.array([1.0])), [1.0], rtol=1e-13)
    # Concave: nothing to add.
    bowl = -np.array([[[2.0, 0.4], [0.4, 1.0]]])
    assert greatest_quadratic((bowl, bowl), rising, greatest_curvature((bowl, bowl))) == 0.0


def test_nothing_is_bounded_by_an_unbounded_hessian() -> None:
    wild = np.array([[[-np.inf, 0.0], [0.0, -1.0]]]), np.array([[[np.inf, 0.0], [0.0, -1.0]]])
    curvature = greatest_curvature(wild)
    assert curvature == np.inf
    assert greatest_quadratic(wild, np.ones((1, 2, 1)), curvature) == np.inf
    # But for a set that is a point in that coordinate.
    assert greatest_quadratic(wild, np.array([[[0.0], [1.0]]]), curvature) == 0.0


def test_curvature_of_forms_that_are_flat_in_a_direction() -> None:
    axes = -np.diag([2.0, 0.0])[None]
    assert greatest_curvature((axes, axes)) == 0.0
    skew = -np.outer([1.0, 2.0], [1.0, 2.0])[None]
    assert 0.0 <= greatest_curvature((skew, skew))[0] <= 1e-12
    ellipse = -np.array([[2.72, 2.0], [2.0, 2.0]])[None]
    assert greatest_curvature((ellipse, ellipse)) < -0.3


def test_middle_covers_its_interval() -> None:
    low, high = np.array([0.1, -np.inf, 1.0]), np.array([0.3, 2.0, 1.0])
    mid, radius = middle((low, high))
    assert (mid - radius)[0] <= 0.1
    assert (mid + radius)[0] >= 0.3
    np.testing.assert_array_equal(radius[1:], [np.inf, 0.0])
    assert upper_dot(np.array([0.0, 2.0]), np.array([np.inf, 3.0])) >= 6.0


@pytest.mark.parametrize("dimension", range(1, 12))
def test_directions_come_in_opposite_pairs(dimension: int) -> None:
    found = directions(dimension)
    half = len(found) // 2
    np.testing.assert_allclose(found[half:], -found[:half], atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0)
    assert np.linalg.matrix_rank(found) == dimension
