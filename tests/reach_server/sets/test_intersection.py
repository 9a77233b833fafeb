"""Generalised intersections, tangents and linearised rows keep every member that they must keep."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import linprog
from shapely import MultiPoint

from reach_server.numeric.types import FloatArray
from reach_server.sets import Direction, SetError, Zonotope
from reach_server.sets.halfspace import StripMethod
from tests.reach_server.ugly import (
    ZONOTOPES,
    Raw,
    assert_holds,
    corners,
    directions,
    members,
    moderate,
    named,
    of,
    random_sets,
)

every = pytest.mark.parametrize("case", ZONOTOPES, ids=named)
methods = pytest.mark.parametrize("method", ["tight", "frobenius"])


def common(a: Raw, b: Raw, matrix: FloatArray, count: int = 6) -> FloatArray:
    """Extreme points (K, n) of ``{x in a : matrix @ x in b}`` by linear programs over both sets' factors."""
    size = np.maximum(np.abs(b.G).sum(axis=1) + np.abs(matrix @ a.G).sum(axis=1), 1e-300)
    equations = np.concatenate([matrix @ a.G, -b.G], axis=1) / size[:, None]
    right = (b.c - matrix @ a.c) / size
    found = []
    for d in directions(a.n, count):
        cost = d @ a.G
        solution = linprog(
            np.concatenate([-cost / (np.abs(cost).max(initial=0.0) or 1.0), np.zeros(b.G.shape[1])]),
            A_eq=equations,
            b_eq=right,
            bounds=(-1, 1),
        ) if equations.shape[1] else None  # fmt: skip
        if solution is not None and solution.status == 0 and solution.x is not None:
            found.append(a.c + a.G @ solution.x[: a.G.shape[1]])
    return np.array(found).reshape(-1, a.n)


@every
def test_an_intersection_keeps_the_common_points(case: Raw) -> None:
    rng = np.random.default_rng(3)
    width = np.abs(case.G).sum(axis=1)
    for shift in (0.0, 0.6, 1.4):
        other = Raw(
            "", case.c + shift * width, np.diag(width) @ rng.normal(size=(case.n, 4)) / 2, np.zeros((0, 4)), np.zeros(0)
        )
        result = case.zonotope().intersection(other.zonotope())
        assert result.direction is Direction.OUTER
        assert_holds(of(result), common(case, other, np.eye(case.n)), case)


@moderate
@given(random_sets(rows=0), st.integers(1, 3), st.integers(0, 2**32 - 1))
@pytest.mark.slow
def test_preimages_keep_the_common_points(case: Raw, k: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(k, case.n))
    image = np.abs(matrix @ case.G).sum(axis=1)
    # Of an image smaller than the rounding of its center nobody knows whether anything is common.
    assume(not case.c.any() or (image > 1e-12 * np.abs(matrix) @ np.abs(case.c)).all())
    other = Raw("", matrix @ (case.c + 0.5 * case.G.sum(axis=1)), np.diag(image) / 2, np.zeros((0, k)), np.zeros(0))
    result = case.zonotope().intersection(other.zonotope(), matrix)
    assert_holds(of(result), common(case, other, matrix, 3), case)


@pytest.mark.parametrize("exponent", [-320, -308, -158, -149, -20, 0, 20, 149])
def test_a_preimage_does_not_depend_on_the_unit(exponent: int) -> None:
    """Squares of such generators are zero, or infinite."""
    unit = 10.0**exponent
    rng = np.random.default_rng(3)
    generators, matrix = rng.normal(size=(3, 4)) * unit, rng.normal(size=(2, 3))
    case = Raw("", np.zeros(3), generators, np.zeros((0, 4)), np.zeros(0))
    half = np.abs(matrix @ generators).sum(axis=1) / 4
    other = Raw("", matrix @ generators.sum(axis=1) / 2, np.diag(half), np.zeros((0, 2)), np.zeros(0))
    result = case.zonotope().intersection(other.zonotope(), matrix)
    assert np.isfinite(result.center).all()
    assert_holds(of(result), common(case, other, matrix, 3), case)
    if exponent > -300:
        assert np.abs(result.generators).sum() < np.abs(generators).sum()


def test_planar_intersections_are_close_to_the_exact_ones() -> None:
    ratios = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        first = Raw("", np.zeros(2), rng.normal(size=(2, 4)), np.zeros((0, 4)), np.zeros(0))
        second = Raw("", rng.normal(size=2), rng.normal(size=(2, 4)), np.zeros((0, 4)), np.zeros(0))
        true = MultiPoint(corners(first)).convex_hull.intersection(MultiPoint(corners(second)).convex_hull)
        if true.area > 0.05:
            result = first.zonotope().intersection(second.zonotope())
            ratios.append(float(result.area()) / true.area)
            smaller = min(first.zonotope().area(), second.zonotope().area())
            assert float(result.area()) <= smaller * (1 + 1e-9)
    assert min(ratios) >= 1 - 1e-9
    assert np.median(ratios) < 1.4


def test_a_set_inside_the_other_is_left_alone() -> None:
    rng = np.random.default_rng(0)
    large, small = Zonotope(np.zeros(3), 10 * np.eye(3)), Zonotope(np.zeros(3), rng.normal(size=(3, 5)) / 5)
    d = directions(3, 20)
    for result in (large.intersection(small), small.intersection(large)):
        np.testing.assert_allclose(result.support(d), small.support(d), rtol=1e-9)


@pytest.mark.parametrize("shape", [(3,), (2, 3), (0,)], ids=str)
def test_batches_of_intersections(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    a = Zonotope(rng.normal(size=(*shape, 3)), rng.normal(size=(*shape, 3, 4)))
    b = Zonotope(rng.normal(size=(*shape, 2)), rng.normal(size=(*shape, 2, 3)))
    matrix, d = rng.normal(size=(*shape, 2, 3)), directions(3)
    whole = a.intersection(b, matrix).support(d)
    for place in np.ndindex(*shape):
        one = Zonotope(a.center[place], a.generators[place]).intersection(
            Zonotope(b.center[place], b.generators[place]), matrix[place]
        )
        np.testing.assert_allclose(whole[place], one.support(d), rtol=1e-7)
    assert a.intersection(Zonotope(np.zeros(3), np.eye(3))).batch == shape
    assert Zonotope(np.zeros(3), np.eye(3)).intersection(a).batch == shape


def disc(center: FloatArray, radius: FloatArray, count: int = 16) -> tuple[FloatArray, FloatArray]:
    angle = 2 * np.pi * np.arange(count) / count
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return normals, normals @ center + radius


@methods
def test_tangents_of_a_disc_keep_its_points(method: StripMethod) -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        case = Raw("", rng.normal(size=2), rng.normal(size=(2, 5)), np.zeros((0, 5)), np.zeros(0))
        middle, radius = rng.normal(size=2) * 2, np.asarray(rng.uniform(0.5, 3.0))
        H, q = disc(middle, radius)
        result = case.zonotope().intersect_tangents(H, q, method)
        points = case.zonotope().sample(rng, 200)
        kept = points[np.linalg.norm(points - middle, axis=1) <= radius]
        assert_holds(of(result), kept[:20], case)
        assert result.direction is Direction.OUTER
        if method == "tight":
            assert result.area() <= case.zonotope().area() * (1 + 1e-9)


@every
@methods
def test_tangent_stacks_keep_every_member(case: Raw, method: StripMethod) -> None:
    H = directions(case.n, 3, seed=5)
    for share in (0.2, 0.7, 1.5):
        q = H @ case.c + share * np.abs(H @ case.G).sum(axis=1)
        strips = [(h, -np.inf, float(bound)) for h, bound in zip(H, q, strict=True)]
        result = case.zonotope().intersect_tangents(H, q, method)
        assert_holds(of(result), members(case, 2, strips), case)


def test_tangents_at_infinity_change_nothing_and_none_at_all_either() -> None:
    z = Zonotope(np.zeros(2), np.eye(2))
    for H, q in [(np.eye(2), np.full(2, np.inf)), (np.zeros((0, 2)), np.zeros(0))]:
        np.testing.assert_allclose(z.intersect_tangents(H, q).interval_hull()[1], [1.0, 1.0])
    mixed = z.intersect_tangents(np.eye(2), np.array([[0.0, np.inf], [np.inf, np.inf]]))
    np.testing.assert_allclose(mixed.interval_hull()[1], [[0.0, 1.0], [1.0, 1.0]], atol=1e-12)


def circle(x: FloatArray) -> FloatArray:
    return np.asarray((x**2).sum(axis=-1) - 1.0)


@methods
@pytest.mark.slow
def test_linearised_rows_keep_the_points_that_obey_the_curved_one(method: StripMethod) -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        case = Raw("", rng.normal(size=2) * 0.7, 0.4 * rng.normal(size=(2, 4)), np.zeros((0, 4)), np.zeros(0))
        z = case.zonotope()
        reach = np.abs(case.G).sum(axis=1)
        # |x|² - 1 about the center: the remainder is that of the square.
        remainder = (np.asarray(0.0), np.asarray((reach**2).sum()))
        r = np.asarray(rng.uniform(0.0, 0.5))
        result = z.intersect_linearised(2 * case.c, circle(case.c), remainder, r, method)
        points = z.sample(rng, 400)
        kept = points[np.abs(circle(points)) <= r]
        assert_holds(of(result), kept[:20], case)
        assert result.direction is Direction.OUTER


def test_the_linearised_row_is_the_formula_of_the_paper() -> None:
    rng = np.random.default_rng(0)
    G, c, J, h0, low, high, r = rng.normal(size=(3, 6)), rng.normal(size=3), rng.normal(size=3), 0.3, -0.2, 0.1, 0.4
    result = Zonotope(c, G).intersect_linearised(J, h0, (low, high), r, "frobenius")
    half, mid = (high - low) / 2, (high + low) / 2
    slope = G @ G.T @ J / (J @ G @ G.T @ J + (r + half) ** 2)
    np.testing.assert_allclose(result.center, c - slope * (h0 + mid), rtol=1e-12)
    expected = np.column_stack([G - np.outer(slope, J @ G), slope * r, -slope * half])
    d = directions(3)
    np.testing.assert_allclose(result.support(d), d @ result.center + np.abs(d @ expected).sum(axis=1), rtol=1e-9)


@pytest.mark.parametrize(("remainder", "r"), [((-np.inf, np.inf), 1.0), ((-0.1, 0.1), np.inf)])
def test_useless_rows_change_nothing(remainder: tuple[float, float], r: float) -> None:
    z = Zonotope(np.array([1.0, 2.0]), np.eye(2))
    for method in ("tight", "frobenius"):
        result = z.intersect_linearised([1.0, 1.0], 0.5, remainder, r, method)
        np.testing.assert_array_equal(result.interval_hull(), z.interval_hull())


def test_a_remainder_unbounded_on_one_side_still_cuts_on_the_other() -> None:
    z = Zonotope(np.zeros(2), np.eye(2))
    result = z.intersect_linearised([1.0, 0.0], 0.0, (-0.1, np.inf), 0.2)
    np.testing.assert_allclose(result.interval_hull(), [[-1.0, -1.0], [0.3, 1.0]])


def test_rows_far_away_are_sound() -> None:
    z = Zonotope(np.array([1e9, -1e9]), np.eye(2))
    cut = z.intersect_linearised([1.0, 1.0], 0.0, (0.0, 0.0), 0.5)
    for point in z.sample(np.random.default_rng(0), 200):
        if abs(point.sum()) <= 0.5:
            assert cut.contains_point(point)


def test_bad_arguments_are_refused() -> None:
    z = Zonotope(np.zeros(2), np.eye(2))
    with pytest.raises(SetError, match="remainder: lower is greater than upper"):
        z.intersect_linearised([1, 0], 0.0, (1.0, 0.0), 1.0)
    with pytest.raises(SetError, match="remainder must be a pair"):
        z.intersect_linearised([1, 0], 0.0, 1.0, 1.0)  # type: ignore[arg-type]
    with pytest.raises(SetError, match="r must not be negative"):
        z.intersect_linearised([1, 0], 0.0, (0.0, 1.0), -1.0)
    with pytest.raises(SetError, match=r"q has shape \(3,\), expected \(..., 2\)"):
        z.intersect_tangents(np.eye(2), np.zeros(3))
    with pytest.raises(SetError, match=r"matrix has shape \(3, 2\), expected \(..., 2, 2\)"):
        z.intersection(z, np.ones((3, 2)))
    with pytest.raises(SetError, match="method is 'best', expected one of tight, frobenius"):
        z.intersect_halfspace([1, 0], 0.0, "best")  # type: ignore[arg-type]
