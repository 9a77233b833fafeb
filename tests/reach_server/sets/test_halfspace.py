"""Strips over batches with a plane, and the sizes that ``tight`` compares."""

from fractions import Fraction

import numpy as np
import pytest

from reach_server.numeric.types import FloatArray
from reach_server.sets import Zonotope
from reach_server.sets.halfspace import StripMethod, bounds, intersect_strip, log_size, strip_bounds
from reach_server.sets.polygon import zonotope_area


def random_batch(
    rng: np.random.Generator, count: int, n: int, g: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    center, generators, normal = (
        rng.normal(size=(count, n)),
        rng.normal(size=(count, n, g)),
        rng.normal(size=(count, n)),
    )
    middle = (normal * center).sum(axis=1)
    reach = np.abs((normal[:, None] @ generators)[:, 0]).sum(axis=1)
    bounds = middle[:, None] + np.sort(rng.uniform(-1.1, 1.1, (count, 2)), axis=1) * reach[:, None]
    return center, generators, normal, bounds[:, 0], bounds[:, 1]


@pytest.mark.parametrize("n", [2, 3, 5])
@pytest.mark.parametrize("method", ["tight", "frobenius"])
def test_members_inside_the_strip_stay(n: int, method: StripMethod) -> None:
    rng = np.random.default_rng(n)
    center, generators, normal, lower, upper = random_batch(rng, 200, n, 6)
    factors = rng.uniform(-1, 1, (400, 200, 6))
    factors[:200] = np.sign(factors[:200])
    points = center + (generators @ factors[..., None])[..., 0]
    heights = (normal * points).sum(axis=-1)
    inside = (lower <= heights) & (heights <= upper)
    for plane in (None, (0, 1)):
        c, G, empty = intersect_strip(center, generators, normal, lower, upper, method=method, plane=plane)
        assert not (empty & inside.any(axis=0)).any()
        for d in rng.normal(size=(30, n)):
            reach = c @ d + np.abs(d @ G).sum(axis=-1)
            assert (~inside | (points @ d <= reach + 1e-9)).all()


def test_tight_is_never_larger_in_the_plane_and_cuts_as_the_design_says() -> None:
    center, generators, normal, lower, upper = random_batch(np.random.default_rng(1), 2000, 2, 5)
    before = zonotope_area(generators)
    tight = zonotope_area(intersect_strip(center, generators, normal, lower, upper)[1])
    frobenius = zonotope_area(intersect_strip(center, generators, normal, lower, upper, method="frobenius")[1])
    assert (tight <= before * (1 + 1e-9)).all()
    assert np.median(tight / before) < 0.75
    assert (tight <= frobenius * (1 + 1e-9)).mean() > 0.99
    # The paper's choice alone makes many sets larger than they were.
    assert (frobenius > before * (1 + 1e-9)).mean() > 0.1


def test_a_coordinate_in_which_the_set_is_a_point_does_not_hide_the_cut() -> None:
    generators = np.zeros((1, 4, 3))
    generators[0, :2] = [[1.0, 0.0, 0.3], [0.0, 1.0, 0.2]]
    _, G, _ = intersect_strip(
        np.zeros((1, 4)), generators, np.eye(4)[0], np.array([-0.5]), np.array([0.5]), plane=(0, 1)
    )
    assert np.abs(G[0, 0]).sum() == pytest.approx(0.5)
    np.testing.assert_array_equal(G[0, 2:], 0.0)
    assert np.isfinite(log_size(G, (0, 1))).all()


def test_bounds_are_tightened_to_the_set() -> None:
    center, generators, normal = np.zeros(2), np.eye(2), np.array([1.0, 0.0])

    def bounds_of(lower: float, upper: float) -> tuple[float, float, bool, bool]:
        q, r, cuts, empty = strip_bounds(center, generators, normal, np.array(lower), np.array(upper))
        return float(q), float(r), bool(cuts), bool(empty)

    for ends, middle, radius, acts in [
        ((-np.inf, np.inf), 0.0, 1.0, False),
        ((-5.0, 5.0), 0.0, 1.0, False),
        ((0.0, 5.0), 0.5, 0.5, True),
    ]:
        q, r, cuts, empty = bounds_of(*ends)
        assert (q, cuts, empty) == (middle, acts, False)
        # The radius holds the rounding of sums over the set.
        assert radius < r < radius * (1 + 1e-14)
    assert bounds_of(2.0, 5.0)[2:] == (False, True)
    assert bounds_of(1.0, 5.0)[3] is False
    # Rounding of the border is no proof of emptiness.
    assert bounds_of(1.0 + 1e-12, 5.0)[3] is False
    assert bounds_of(1.0 + 1e-6, 5.0)[3] is True


def test_what_cancellation_leaves_is_no_proof_of_emptiness() -> None:
    # H·c is 0 up to 1e-4, the rounding of 1e12 * 0.1 - 1e11; the strip around it is thinner than that.
    center, normal = np.array([1e12, -1e11 * 3]), np.array([0.3, 1.0])
    middle = float((normal * center).sum())
    assert abs(middle) < 1e-3
    point = np.zeros((2, 1))
    for shift in (1e-5, -1e-5):
        bound = np.array(middle + shift)
        assert not strip_bounds(center, point, normal, bound, bound)[3]
    heights = np.array([[1e9], [-3e8]]) + np.array([[0.0], [1e-8]])
    assert not strip_bounds(np.zeros(2), heights, normal, np.array(1e-8), np.array(1e-7))[3]


@pytest.mark.parametrize("method", ["tight", "frobenius"])
@pytest.mark.parametrize("size", [1e-160, 1e-300, 5e-324])
def test_sets_that_are_hardly_more_than_a_point(method: StripMethod, size: float) -> None:
    for generators in (np.array([[size, 1.0], [0.0, 1e-9]]), np.array([[size], [1.0]]), np.array([[1.0], [size]])):
        z = Zonotope(np.zeros(2), generators)
        for normal in (np.array([1.0, 0.0]), np.array([0.0, 1.0])):
            reach = np.abs(normal @ generators).sum()
            cut = z.intersect_strip(normal, 0.25 * reach, 0.5 * reach, method)
            assert cut.contains_point([0.0, 0.0])


def test_bounds_of_a_strip_are_rounded_outwards() -> None:
    for q, r in [(0.1, 0.2), (1e16, 1.0), (-1 / 3, 1e-30), (0.0, 1.0)]:
        lower, upper = bounds(q, r, ())
        assert Fraction(float(lower)) <= Fraction(q) - Fraction(r)
        assert Fraction(float(upper)) >= Fraction(q) + Fraction(r)
    lower, upper = bounds([0.0, 1.0], np.inf, (2,))
    np.testing.assert_array_equal([lower, upper], [[-np.inf] * 2, [np.inf] * 2])


def test_a_zero_normal_holds_everywhere_or_nowhere() -> None:
    zero = np.zeros(2)
    _, _, cuts, empty = strip_bounds(zero, np.eye(2), zero, np.array([-1.0, 1.0]), np.array([1.0, 2.0]))
    np.testing.assert_array_equal(cuts, False)
    np.testing.assert_array_equal(empty, [False, True])
