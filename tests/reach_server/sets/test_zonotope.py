"""Zonotopes: what an operation returns holds every point that it must hold, and no more where it says exact."""

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from shapely import MultiPoint, Polygon

from reach_server.numeric.types import FloatArray
from reach_server.sets import Direction, Interval, SetError, Zonotope
from tests.reach_server.ugly import (
    ROUNDING,
    ZONOTOPES,
    Raw,
    assert_holds,
    assert_outlines,
    at,
    batched,
    corners,
    directions,
    extreme,
    members,
    moderate,
    named,
    of,
    random_sets,
)

every = pytest.mark.parametrize("case", ZONOTOPES, ids=named)
planar = pytest.mark.parametrize("case", [case for case in ZONOTOPES if case.n == 2], ids=named)


def free(case: Raw) -> Raw:
    """The set without its constraints."""
    return of(case.zonotope())


def supports(points: FloatArray, d: FloatArray) -> FloatArray:
    return np.asarray((points @ d.T).max(axis=0))


@every
def test_support_and_hull_are_those_of_the_corners(case: Raw) -> None:
    d = directions(case.n)
    np.testing.assert_allclose(
        case.zonotope().support(d), supports(corners(case), d), rtol=1e-9, atol=ROUNDING * case.size
    )
    lower, upper = case.zonotope().interval_hull()
    np.testing.assert_allclose(lower, corners(case).min(axis=0), rtol=1e-9, atol=ROUNDING * case.size)
    np.testing.assert_allclose(upper, corners(case).max(axis=0), rtol=1e-9, atol=ROUNDING * case.size)


@every
def test_images_sums_and_products_are_exact(case: Raw) -> None:
    z = case.zonotope()
    M = np.random.default_rng(1).normal(size=(2, case.n))
    d = directions(2)
    np.testing.assert_allclose(
        z.linear_map(M).support(d), supports(corners(case) @ M.T, d), rtol=1e-9, atol=ROUNDING * case.size
    )
    other = Zonotope(np.ones(case.n), 0.5 * np.eye(case.n))
    d = directions(case.n)
    np.testing.assert_allclose(
        z.minkowski_sum(other).support(d), z.support(d) + other.support(d), rtol=1e-9, atol=ROUNDING * case.size
    )
    np.testing.assert_allclose(
        z.translate(np.ones(case.n)).support(d), z.support(d) + d.sum(axis=1), rtol=1e-9, atol=ROUNDING * case.size
    )
    wide = directions(2 * case.n)
    np.testing.assert_allclose(
        z.cartesian_product(other).support(wide),
        z.support(wide[:, : case.n]) + other.support(wide[:, case.n :]),
        rtol=1e-9,
        atol=1e-9 * case.size,
    )
    axes = tuple(reversed(range(case.n)))
    np.testing.assert_allclose(
        z.project(axes).support(d), supports(corners(case)[:, axes], d), rtol=1e-9, atol=ROUNDING * case.size
    )


@every
@pytest.mark.parametrize("order", [0.5, 1, 1.5, 2, 10])
def test_a_reduced_set_holds_the_whole_set(case: Raw, order: float) -> None:
    reduced = case.zonotope().reduce_order(order)
    assert reduced.generators.shape[-1] <= max(int(order * case.n), case.n)
    assert_holds(of(reduced), corners(case)[:24])
    d = directions(case.n, 50)
    assert (reduced.support(d) >= supports(corners(case), d) - ROUNDING * case.size).all()


@every
def test_affine_maps_and_scaling_are_exact(case: Raw) -> None:
    rng = np.random.default_rng(2)
    z, M, t = case.zonotope(), rng.normal(size=(3, case.n)), rng.normal(size=3)
    d = directions(3)
    np.testing.assert_allclose(
        z.affine_map(M, t).support(d), supports(corners(case) @ M.T + t, d), rtol=1e-9, atol=ROUNDING * case.size
    )
    d = directions(case.n)
    for factor in (2.5, -1.0, 0.0):
        np.testing.assert_allclose(
            z.scale(factor).support(d), supports(factor * corners(case), d), rtol=1e-9, atol=ROUNDING * case.size
        )


@every
def test_the_hull_of_two_holds_both(case: Raw) -> None:
    rng = np.random.default_rng(4)
    z = case.zonotope()
    shift = rng.normal(size=case.n) * case.size
    others = [
        z.translate(shift),
        Zonotope.point(case.c + shift),
        z.linear_map(np.linalg.qr(rng.normal(size=(case.n, case.n)))[0]),
        Zonotope(case.c, case.size * rng.normal(size=(case.n, 9))),
    ]
    for other in others:
        for hull in (z.convex_hull(other), other.convex_hull(z)):
            assert hull.direction is Direction.OUTER
            assert hull.generators.shape[1] <= case.G.shape[1] + other.generators.shape[1] + 1
            source = Raw("", case.c, np.concatenate([case.G, other.generators, shift[:, None]], axis=1), case.A, case.b)
            assert_holds(of(hull), np.concatenate([corners(case)[:12], corners(of(other))[:12]]), source)


def test_the_hull_of_a_set_with_itself_and_of_moved_twins_is_tight() -> None:
    rng = np.random.default_rng(0)
    z, d = Zonotope(rng.normal(size=3), rng.normal(size=(3, 5))), directions(3, 30)
    mixed = Zonotope(z.center, rng.permutation(z.generators, axis=1) * rng.choice([-1, 1], 5))
    np.testing.assert_allclose(z.convex_hull(mixed).support(d), z.support(d), rtol=1e-9)
    moved = z.translate([1.0, 2.0, 3.0])
    np.testing.assert_allclose(
        z.convex_hull(moved).support(d), np.maximum(z.support(d), moved.support(d)), rtol=1e-9, atol=1e-9
    )


@moderate
@given(random_sets(rows=0))
def test_random_sets_reduce_to_enclosures(case: Raw) -> None:
    d = directions(case.n, 40)
    for order in (1, 1.5, 2):
        assert (
            case.zonotope().reduce_order(order).support(d) >= supports(corners(case), d) - ROUNDING * case.size
        ).all()


@planar
def test_polygon_and_area_agree_with_shapely(case: Raw) -> None:
    z = case.zonotope()
    true = MultiPoint(corners(case)).convex_hull
    vertices = z.polygon()
    scale = case.size**2
    np.testing.assert_allclose(z.volume(), true.area, rtol=1e-7, atol=1e-12 * scale)
    np.testing.assert_allclose(MultiPoint(vertices).convex_hull.area, true.area, rtol=1e-7, atol=1e-12 * scale)
    np.testing.assert_allclose(
        supports(vertices, directions(2)), supports(corners(case), directions(2)), rtol=1e-9, atol=ROUNDING * case.size
    )
    if true.area > 1e-6 * scale:
        assert Polygon(vertices).exterior.is_ccw


@pytest.mark.parametrize("case", [case for case in ZONOTOPES if case.n >= 3], ids=named)
def test_volume_agrees_with_the_convex_hull_of_the_corners(case: Raw) -> None:
    if np.linalg.matrix_rank(case.G) < case.n:
        assert case.zonotope().volume() == pytest.approx(0.0, abs=1e-12)
    else:
        assert case.zonotope().volume() == pytest.approx(ConvexHull(corners(case)).volume)


def test_volume_in_one_dimension_is_the_length() -> None:
    assert Zonotope(np.array([3.0]), np.array([[1.0, -0.5]])).volume() == pytest.approx(3.0)


@every
def test_points_are_told_apart(case: Raw) -> None:
    z = case.zonotope()
    assert z.contains_point(case.c)
    for point in members(case, 4):
        assert z.contains_point(case.c + (point - case.c) * (1 - 1e-9))
    for normal in directions(case.n, 3):
        found = extreme(case, normal)
        assert found is not None
        beyond = found[1] + 1e-4 * case.size * normal / np.linalg.norm(normal)
        assert not z.contains_point(beyond)
    assert not z.is_empty()


@every
def test_factors_reach_their_points(case: Raw) -> None:
    z = case.zonotope()
    for point in members(case, 3):
        factors = z.factors_of(case.c + (point - case.c) * (1 - 1e-9))
        assert (np.abs(factors) <= 1).all()
        assert np.abs(case.c + case.G @ factors - point).max() <= ROUNDING * case.size
    outside = z.factors_of(case.c + 2 * case.size + 1e-3 * np.abs(case.c))
    assert outside.shape == (case.G.shape[1],)
    assert np.isnan(outside).all()


@every
def test_bounds_never_fall_below_the_exact_ones(case: Raw) -> None:
    z, d = case.zonotope(), directions(case.n, 20)
    c, G = exact(case.c), exact(case.G)
    for row, value in zip(exact(d), z.support(d), strict=True):
        true = row @ c + np.abs(row @ G).sum()
        assert true <= Fraction(float(value)) <= true + Fraction(1e-14) * (np.abs(row) @ (np.abs(c) + np.abs(G).sum(1)))
    half = np.abs(G).sum(axis=1)
    lower, upper = z.interval_hull()
    assert (exact(lower) <= c - half).all()
    assert (exact(upper) >= c + half).all()
    box = Zonotope.from_interval((lower, upper))
    corner = np.abs(exact(box.generators)).sum(axis=1)
    assert (exact(box.center) - corner <= exact(lower)).all()
    assert (exact(box.center) + corner >= exact(upper)).all()


def exact(array: FloatArray) -> NDArray[np.object_]:
    """The same numbers as fractions."""
    return np.array([Fraction(float(x)) for x in array.ravel()] + [None], dtype=object)[:-1].reshape(array.shape)


@planar
def test_outer_polygons_hold_the_set(case: Raw) -> None:
    z = case.zonotope()
    for count in (3, 4, 16):
        vertices = z.polygon(count)
        assert vertices.shape == (count, 2)
        assert_outlines(vertices, corners(case), case.size)


@pytest.mark.parametrize("case", [c for c in ZONOTOPES if c.n == 2], ids=named)
@pytest.mark.parametrize("shape", [(3,), (2, 3), (0,)], ids=str)
def test_a_batch_gives_what_its_members_give(case: Raw, shape: tuple[int, ...]) -> None:
    wide = batched(case, shape)
    z = wide.zonotope()
    assert z.batch == shape
    d, M, H = directions(2), np.array([[1.0, 0.5], [0.0, 2.0]]), np.array([1.0, 0.4])
    q, r = wide.c @ H, 0.5 * np.abs(H @ wide.G).sum(axis=-1)
    results: dict[str, Any] = {
        "support": z.support(d),
        "lower": z.interval_hull()[0],
        "volume": z.volume(),
        "polygon": z.polygon(),
        "image": z.linear_map(M).support(d),
        "sum": z.minkowski_sum(z).support(d),
        "product": z.cartesian_product(z).support(directions(4)),
        "reduced": z.reduce_order(1).support(d),
        "tight": z.intersect_strip(H, q, r).support(d),
        "frobenius": z.intersect_strip(H, q, r, "frobenius").support(d),
        "halfspace": z.intersect_halfspace(H, q).support(d),
        "scaled": z.scale(q).support(d),
        "hull": z.convex_hull(z.linear_map(M)).support(d),
        "pca": z.reduce_order(1, "pca").support(d),
        "simple": z.simplify().support(d),
        "factors": z.factors_of(wide.c),
        "outer": z.polygon(8),
        "bracket": z.volume_bracket()[1],
        "contains": z.contains_point(wide.c),
        "misses": z.misses_strip(H, q, r),
        "empty": z.is_empty(),
    }
    for place in np.ndindex(*shape):
        one = at(wide, place).zonotope()
        expected: dict[str, Any] = {
            "support": one.support(d),
            "lower": one.interval_hull()[0],
            "volume": one.volume(),
            "polygon": one.polygon(),
            "image": one.linear_map(M).support(d),
            "sum": one.minkowski_sum(one).support(d),
            "product": one.cartesian_product(one).support(directions(4)),
            "reduced": one.reduce_order(1).support(d),
            "tight": one.intersect_strip(H, q[place], r[place]).support(d),
            "frobenius": one.intersect_strip(H, q[place], r[place], "frobenius").support(d),
            "halfspace": one.intersect_halfspace(H, q[place]).support(d),
            "scaled": one.scale(q[place]).support(d),
            "hull": one.convex_hull(one.linear_map(M)).support(d),
            "pca": one.reduce_order(1, "pca").support(d),
            "simple": one.simplify().support(d),
            "factors": one.factors_of(wide.c[place]),
            "outer": one.polygon(8),
            "bracket": one.volume_bracket()[1],
            "contains": one.contains_point(wide.c[place]),
            "misses": one.misses_strip(H, q[place], r[place]),
            "empty": one.is_empty(),
        }
        for name, value in expected.items():
            np.testing.assert_allclose(results[name][place], value, rtol=1e-9, atol=ROUNDING * case.size, err_msg=name)


@pytest.mark.parametrize(
    ("center", "generators"),
    [
        ([0.0, np.nan], np.eye(2)),
        ([0.0, np.inf], np.eye(2)),
        ([0.0, 0.0], np.eye(3)),
        ([], np.zeros((0, 0))),
        (0.0, np.eye(2)),
        (np.zeros((2, 2)), np.zeros((3, 2, 1))),
        (["a", "b"], np.eye(2)),
    ],
)
def test_what_is_no_zonotope_is_refused(center: FloatArray, generators: FloatArray) -> None:
    with pytest.raises(SetError):
        Zonotope(center, generators)


def test_arguments_of_operations_are_checked() -> None:
    z = Zonotope(np.zeros(2), np.eye(2))
    with pytest.raises(SetError, match="must not be negative"):
        z.intersect_strip([1, 0], 0.0, -1.0)
    with pytest.raises(SetError, match="H has shape"):
        z.intersect_strip([1, 0, 0], 0.0, 1.0)
    with pytest.raises(SetError, match="NaN"):
        z.linear_map([[np.nan, 0.0]])
    with pytest.raises(SetError, match="planar"):
        Zonotope(np.zeros(3), np.eye(3)).polygon()
    with pytest.raises(SetError, match="greater"):
        Zonotope.box([1.0], [0.0])


def test_arrays_cannot_be_written() -> None:
    z = Zonotope(np.zeros(2), np.eye(2))
    with pytest.raises(ValueError, match="read-only"):
        z.center[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        z.generators[0, 0] = 2.0


def test_a_box_holds_its_corners() -> None:
    box = Zonotope.box([-1.0, 2.0], [0.5, 2.0])
    np.testing.assert_allclose(box.interval_hull(), [[-1.0, 2.0], [0.5, 2.0]])


def test_boxes_of_intervals() -> None:
    interval = Interval(np.array([[-1.0, 2.0], [0.1, 0.3]]), np.array([[0.5, 2.0], [0.7, 1e9]]))
    box = Zonotope.from_interval(interval)
    assert box.batch == (2,)
    lower, upper = box.interval_hull()
    assert interval.lower.shape == lower.shape
    assert (lower <= interval.lower).all()
    assert (upper >= interval.upper).all()
    np.testing.assert_array_equal(lower[0], [-1.0, 2.0])
    for bad, message in [
        (Interval.empty((2,)), "empty"),
        (Interval(np.zeros(2), np.array([1.0, np.inf])), "unbounded"),
        ((1.0, 2.0), "interval"),
        (([1.0], [0.0]), "lower is greater"),
        (([], []), "at least one dimension"),
    ]:
        with pytest.raises(SetError, match=message):
            Zonotope.from_interval(bad)  # type: ignore[arg-type]


def test_points_are_sets_of_one_member() -> None:
    point = Zonotope.point([[1.0, 2.0], [3.0, 4.0]])
    assert point.batch == (2,)
    assert point.contains_point([[1.0, 2.0], [3.0, 4.0]]).all()
    assert not point.contains_point([[1.0, 2.1], [3.1, 4.0]]).any()
    np.testing.assert_array_equal(point.area(), [0.0, 0.0])


def test_directions_compose() -> None:
    z = Zonotope(np.zeros(2), np.ones((2, 5)))
    outer, inner = z.reduce_order(1), Zonotope(z.center, z.generators, Direction.INNER)
    assert z.linear_map(np.eye(2)).direction is Direction.EXACT
    assert outer.direction is outer.translate([1, 1]).direction is z.minkowski_sum(outer).direction is Direction.OUTER
    assert inner.scale(2.0).project([0]).direction is Direction.INNER
    bounding_nothing: list[Callable[[], Zonotope]] = [
        lambda: inner.minkowski_sum(outer),
        lambda: inner.reduce_order(1),
        lambda: inner.intersect_halfspace([1, 0], 0.0),
        lambda: outer.cartesian_product(inner),
        lambda: inner.convex_hull(z),
    ]
    for refused in bounding_nothing:
        with pytest.raises(SetError, match="do not compose"):
            refused()
    with pytest.raises(SetError, match="direction is 'outer'"):
        Zonotope(z.center, z.generators, "outer")  # type: ignore[arg-type]


@pytest.mark.parametrize("axes", [(), (2,), (-3,), (0.5,), 1, "ab", ((0, 1),)])
def test_axes_that_are_not_there_are_refused(axes: tuple[int, ...]) -> None:
    with pytest.raises(SetError, match="axes is"):
        Zonotope(np.zeros(2), np.eye(2)).project(axes)


def test_batches_that_do_not_go_together_are_named() -> None:
    z = Zonotope(np.zeros((2, 2)), np.eye(2))
    wrong: dict[str, Callable[[], object]] = {
        "matrix": lambda: z.linear_map(np.zeros((3, 2, 2))),
        "offset": lambda: z.translate(np.zeros((3, 2))),
        "factor": lambda: z.scale(np.zeros(3)),
        "H": lambda: z.intersect_halfspace(np.zeros((3, 2)), 0.0),
        "q": lambda: z.intersect_halfspace(np.zeros(2), np.zeros(3)),
        "r": lambda: z.intersect_strip(np.zeros(2), 0.0, np.zeros(3)),
        "d": lambda: z.support(np.zeros((3, 1, 2))),
        "x": lambda: z.contains_point(np.zeros((3, 2))),
        "other": lambda: z.minkowski_sum(Zonotope(np.zeros((3, 2)), np.eye(2))),
    }
    for name, refused in wrong.items():
        with pytest.raises(SetError, match=rf"^{name} has batch axes \(3,\).*\(2,\)"):
            refused()
