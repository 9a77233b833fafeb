"""Constrained zonotopes against linear programs: nothing is lost, and what is said to be empty is empty."""

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from shapely import MultiPoint

from reach_server.numeric.types import FloatArray
from reach_server.sets import ConstrainedZonotope, Direction, SetError, Zonotope
from reach_server.sets.sampling import SampleMethod
from tests.reach_server.ugly import (
    EMPTY,
    INHABITED,
    ROUNDING,
    Raw,
    assert_holds,
    assert_outlines,
    at,
    batched,
    directions,
    extreme,
    gap,
    members,
    moderate,
    named,
    of,
    random_sets,
    raw,
)

HOW: tuple[SampleMethod, ...] = ("inside", "boundary", "factors")
inhabited = pytest.mark.parametrize("case", INHABITED, ids=named)
#: One of each kind of constraints, for what is slow.
SOME = tuple(case for case in INHABITED if case.name.startswith(("plain in the plane", "a segment,", "huge,", "tiny,")))
some = pytest.mark.parametrize("case", SOME, ids=named)


def true_support(case: Raw, d: FloatArray) -> FloatArray:
    found = [extreme(case, one) for one in d]
    return np.array([f[0] for f in found if f is not None])


@inhabited
def test_support_is_never_below_the_linear_program(case: Raw) -> None:
    d = directions(case.n, 4)
    bound, true = case.constrained().support(d), true_support(case, d)
    slack = ROUNDING * case.size * np.linalg.norm(d, axis=1)
    assert (bound >= true - slack).all()
    assert (bound <= case.zonotope().support(d) + slack).all()


def test_support_is_close_to_the_linear_program() -> None:
    for case in SOME:
        d = directions(case.n, 6)
        excess = (case.constrained().support(d) - true_support(case, d)) / (case.size * np.linalg.norm(d, axis=1))
        assert excess.max() < 1e-3, case.name


@inhabited
def test_an_inhabited_set_is_never_called_empty(case: Raw) -> None:
    assert not case.constrained().is_empty()


@pytest.mark.parametrize("case", EMPTY, ids=named)
def test_an_empty_set_is_found_empty(case: Raw) -> None:
    assert case.constrained().is_empty()
    for how in HOW:
        assert np.isnan(case.constrained().sample(np.random.default_rng(0), 3, how)).all()


@moderate
@given(random_sets())
@pytest.mark.slow
def test_random_sets_are_bounded_from_outside(case: Raw) -> None:
    constrained = case.constrained()
    assert not constrained.is_empty()
    d = directions(case.n, 3)
    found = [extreme(case, one) for one in d]
    for one, bound, f in zip(d, constrained.support(d), found, strict=True):
        if f is not None:
            assert bound >= f[0] - ROUNDING * case.size * np.linalg.norm(one)
    lower, upper = constrained.interval_hull()
    assert (lower <= upper + ROUNDING * case.size).all()


@moderate
@given(random_sets(), st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.1, 1.0]))
# The height of the strip and that of the point are rounded differently.
@example(raw("a point far away", [1e9, 1e9], [[], []]), 229, 0.0)
@pytest.mark.slow
def test_random_cuts_are_exact(case: Raw, seed: int, width: float) -> None:
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=case.n)
    reach = float(np.abs(normal @ case.G).sum())
    q, r = float(normal @ case.c) + rng.uniform(-1, 1) * reach, width * reach
    cut = case.constrained().intersect_strip(normal, q, r)
    inside = members(case, 2, [(normal, q - r, q + r)])
    assert_holds(of(cut), inside, case)
    if cut.is_empty():
        assert not len(inside)
    # Exact: no point of the result breaks the strip.
    for sign in (1.0, -1.0):
        found = extreme(of(cut), sign * normal)
        if found is not None and width:
            assert found[0] <= sign * q + r + ROUNDING * case.size * np.linalg.norm(normal)


@some
def test_half_spaces_and_strips_cut_exactly(case: Raw) -> None:
    normal = np.array([0.8, -0.6])
    best, worst = extreme(case, normal), extreme(case, -normal)
    assert best is not None
    assert worst is not None
    top, bottom = best[0], -worst[0]
    for share in (0.25, 1.0):
        bound = bottom + share * (top - bottom)
        cut = case.constrained().intersect_halfspace(normal, bound)
        assert_holds(of(cut), members(case, 2, [(normal, -np.inf, bound)]), case)
        assert cut.support([normal]) <= bound + ROUNDING * case.size
    past = case.constrained().intersect_halfspace(normal, bottom - 0.1 * case.size)
    assert past.is_empty()
    missed = case.constrained().intersect_strip(normal, top + case.size, 0.5 * case.size)
    assert missed.is_empty()
    far = case.constrained().intersect_strip(normal, 0.0, np.inf)
    np.testing.assert_allclose(far.support([normal]), case.constrained().support([normal]))


@some
def test_images_sums_and_products_are_exact(case: Raw) -> None:
    rng = np.random.default_rng(5)
    c, z = case.constrained(), Zonotope(np.zeros(2), case.size * rng.normal(size=(2, 3)) / 10)
    M = rng.normal(size=(2, 2))
    inner = members(case, 2)
    assert_holds(of(c.linear_map(M)), inner @ M.T)
    assert_holds(of(c.translate([1.0, 2.0])), inner + np.array([1.0, 2.0]), case)
    assert_holds(of(c.project((1,))), inner[:, 1:])
    others = z.sample(rng, len(inner))
    assert_holds(of(c.minkowski_sum(z)), inner + others)
    assert_holds(of(c.minkowski_sum(c)), inner + inner[::-1])
    assert_holds(of(c.cartesian_product(z)), np.concatenate([inner, others], axis=1))
    d, wide = directions(2, 3), directions(4, 2)
    twice = c.minkowski_sum(ConstrainedZonotope.from_zonotope(z))
    slack = ROUNDING * case.size
    for result, true, ways in (
        (c.linear_map(M), true_support(case, d @ M), d),
        (twice, true_support(case, d) + z.support(d), d),
        (c.cartesian_product(z), true_support(case, wide[:, :2]) + z.support(wide[:, 2:]), wide),
    ):
        exact = true_support(of(result), ways)
        np.testing.assert_allclose(exact, true, rtol=1e-5, atol=10 * slack)


@pytest.mark.parametrize("case", INHABITED[::3], ids=named)
def test_reductions_and_dropped_constraints_enclose(case: Raw) -> None:
    c, inner = case.constrained(), members(case, 2)
    for order in (1, 2, 4):
        reduced = c.reduce_order(order)
        rows = len(case.A)
        assert reduced.generators.shape[-1] <= max(int(order * case.n), case.n + rows)
        assert_holds(of(reduced), inner, case)
    for count in (0, 1):
        kept = c.keep_newest_constraints(count)
        assert kept.constraint_matrix.shape[-2] == min(count, len(case.A))
        assert_holds(of(kept), inner, case)
    assert_holds(of(c.enclosing_zonotope()), inner, case)


@some
def test_polygon_area_and_hull_are_outer(case: Raw) -> None:
    c, inner = case.constrained(), members(case, 12)
    true = MultiPoint(inner).convex_hull
    assert_outlines(c.polygon(), inner, case.size)
    assert c.area() >= true.area * (1 - ROUNDING) - ROUNDING * case.size**2
    assert c.volume() == c.area()
    lower, upper = c.interval_hull()
    assert (lower <= inner.min(axis=0) + ROUNDING * case.size).all()
    assert (upper >= inner.max(axis=0) - ROUNDING * case.size).all()


@some
def test_points_are_told_apart(case: Raw) -> None:
    c = case.constrained()
    inner = members(case, 3)
    middle = inner.mean(axis=0)
    for point in inner:
        assert c.contains_point(middle + (1 - 1e-6) * (point - middle))
    for d in directions(2, 2):
        found = extreme(case, d)
        assert found is not None
        assert not c.contains_point(found[1] + 1e-3 * case.size * d / np.linalg.norm(d))


@some
def test_samples_are_members(case: Raw) -> None:
    samples = case.constrained().sample(np.random.default_rng(1), 5)
    assert max(gap(case, x) for x in samples) <= ROUNDING


def scott(generators: list[list[float]], row: list[float], offset: float) -> ConstrainedZonotope:
    return ConstrainedZonotope(np.zeros(2), np.array(generators), np.array([row]), np.array([offset]))


def test_figure_1_of_scott_2016() -> None:
    c = scott([[1.5, -1.5, 0.5], [1, 0.5, -1]], [1, 1, 1], 1)
    lower, upper = c.interval_hull()
    np.testing.assert_allclose(lower, [-2.5, -1.5], atol=1e-4)
    np.testing.assert_allclose(upper, [3.5, 2.5], atol=1e-4)
    assert (lower <= [-2.5, -1.5]).all()
    assert (upper >= [3.5, 2.5]).all()


def test_figure_2_of_scott_2016() -> None:
    c = scott([[1, 0, 1], [1, 2, -1]], [-2, 1, -1], 2)
    lower, upper = c.interval_hull()
    np.testing.assert_allclose(lower, [-2, -2], atol=1e-4)
    np.testing.assert_allclose(upper, [0, 3], atol=1e-4)
    assert (lower <= [-2, -2]).all()
    assert (upper >= [0, 3]).all()


@pytest.mark.parametrize("case", SOME[::2], ids=named)
@pytest.mark.parametrize("shape", [(3,), (2, 2), (0,)], ids=str)
def test_a_batch_gives_what_its_members_give(case: Raw, shape: tuple[int, ...]) -> None:
    wide = batched(case, shape)
    c = wide.constrained()
    assert c.batch == shape
    d, H = directions(2, 2), np.array([1.0, 0.4])
    q, r = wide.c @ H, 0.3 * np.abs(H @ wide.G).sum(axis=-1)
    M = np.array([[1.0, 0.5], [0.0, 2.0]])
    z = Zonotope(np.zeros(2), np.eye(2) * case.size)

    def figures(c: ConstrainedZonotope, q: FloatArray, r: FloatArray, x: FloatArray) -> dict[str, Any]:
        return {
            "support": c.support(d),
            "lower": c.interval_hull()[0],
            "polygon": c.polygon(8),
            "area": c.area(),
            "image": c.linear_map(M).support(d),
            "sum": c.minkowski_sum(z).support(d),
            "twice": c.minkowski_sum(c).support(d),
            "product": c.cartesian_product(z).support(directions(4, 2)),
            "reduced": c.reduce_order(1).support(d),
            "strip": c.intersect_strip(H, q, r).support(d),
            "newest": c.keep_newest_constraints(1).support(d),
            "contains": c.contains_point(x),
            "empty": c.is_empty(),
        }

    results = figures(c, q, r, wide.c)
    for place in np.ndindex(*shape):
        for name, value in figures(at(wide, place).constrained(), q[place], r[place], wide.c[place]).items():
            scale = case.size**2 if name == "area" else case.size
            np.testing.assert_allclose(results[name][place], value, rtol=1e-7, atol=ROUNDING * scale, err_msg=name)


def test_one_missed_strip_leaves_the_rest_of_a_batch() -> None:
    c = ConstrainedZonotope(np.zeros((3, 2)), np.eye(2), np.zeros((0, 2)), np.zeros(0))
    cut = c.intersect_strip([1.0, 0.0], np.array([0.0, 5.0, 0.0]), np.array([0.5, 1.0, np.inf]))
    np.testing.assert_array_equal(cut.is_empty(), [False, True, False])
    np.testing.assert_allclose(cut.support([[1.0, 0.0]])[[0, 2], 0], [0.5, 1.0], atol=1e-4)


def test_constraints_without_generators() -> None:
    nothing = ConstrainedZonotope(np.zeros(2), np.zeros((2, 0)), np.zeros((1, 0)), np.ones(1))
    assert nothing.is_empty()
    assert not nothing.contains_point([0.0, 0.0])
    point = ConstrainedZonotope(np.ones(2), np.zeros((2, 0)), np.zeros((1, 0)), np.zeros(1))
    assert not point.is_empty()
    assert point.contains_point([1.0, 1.0])
    np.testing.assert_allclose(point.interval_hull(), np.ones((2, 2)))


@pytest.mark.parametrize(
    ("matrix", "offset"),
    [(np.ones((1, 3)), [1.0]), (np.ones((1, 2)), [1.0, 2.0]), ([[np.nan, 0.0]], [0.0]), ([[1.0, 0.0]], [np.inf])],
)
def test_constraints_that_do_not_fit_are_refused(matrix: FloatArray, offset: FloatArray) -> None:
    with pytest.raises(SetError):
        ConstrainedZonotope(np.zeros(2), np.eye(2), matrix, offset)


def test_planar_operations_refuse_other_dimensions() -> None:
    with pytest.raises(SetError, match="planar"):
        ConstrainedZonotope.from_zonotope(Zonotope(np.zeros(3), np.eye(3))).polygon()


@pytest.mark.parametrize("case", INHABITED[::3], ids=named)
@pytest.mark.parametrize("how", HOW)
def test_samples_of_every_kind_are_members(case: Raw, how: SampleMethod) -> None:
    samples = case.constrained().sample(np.random.default_rng(1), 4, how)
    assert samples.shape == (4, case.n)
    for x in samples:
        assert gap(case, x) <= ROUNDING


@pytest.mark.parametrize("n", [2, 3])
def test_samples_on_the_boundary_are_there_and_inner_ones_fill_the_set(n: int) -> None:
    rng = np.random.default_rng(n)
    A = rng.normal(size=(2, 8))
    case = Raw("", rng.normal(size=n), rng.normal(size=(n, 8)), A, A @ rng.uniform(-0.5, 0.5, 8))
    c = case.constrained()
    middle = c.sample(rng, 200, "inside").mean(axis=0)
    for x in c.sample(rng, 10, "boundary"):
        assert c.contains_point(middle + (1 - 1e-6) * (x - middle))
        assert not c.contains_point(middle + (1 + 1e-3) * (x - middle))
    lower, upper = c.interval_hull()
    inside = c.sample(rng, 500, "inside")
    assert (inside.max(axis=0) - inside.min(axis=0) > 0.5 * (upper - lower)).all()


def test_planar_samples_are_uniform() -> None:
    """A box cut by its diagonal: half of the triangle's area lies below 1 - sqrt(1/2)."""
    triangle = ConstrainedZonotope.box([0.0, 0.0], [1.0, 1.0]).intersect_halfspace([1.0, 1.0], 1.0)
    inside = triangle.sample(np.random.default_rng(0), 4000)
    np.testing.assert_allclose((inside < 1 - np.sqrt(0.5)).mean(axis=0), 0.5, atol=0.05)
    edge = triangle.sample(np.random.default_rng(0), 4000, "boundary")
    np.testing.assert_allclose((np.abs(edge.sum(axis=1) - 1) < 1e-9).mean(), np.sqrt(2) / (2 + np.sqrt(2)), atol=0.05)


@pytest.mark.parametrize("case", INHABITED[::3], ids=named)
def test_convex_hulls_are_exact(case: Raw) -> None:
    rng = np.random.default_rng(2)
    z = Zonotope(case.c + case.size * rng.normal(size=case.n), case.size * rng.normal(size=(case.n, 2)) / 4)
    hull = case.constrained().convex_hull(z)
    g = case.G.shape[1] + 2
    assert hull.generators.shape[-1] == 3 * g + 1
    assert hull.constraint_matrix.shape[-2] == len(case.A) + 2 * g
    assert_holds(of(hull), members(case, 1), of(hull))
    assert_holds(of(hull), z.sample(rng, 2), of(hull))
    d = directions(case.n, 2)
    wanted = np.maximum(case.constrained().support(d), z.support(d))
    slack = 1e-7 * (case.size + np.abs(case.c).max()) * np.linalg.norm(d, axis=1)
    found = hull.support(d)
    assert (found >= wanted - slack).all()
    assert (found <= wanted + slack).all()


def test_the_hull_with_an_empty_set_is_the_other() -> None:
    box = ConstrainedZonotope.box([0.0, 0.0], [1.0, 2.0])
    empty = box.intersect_halfspace([1.0, 0.0], -1.0)
    for hull in (box.convex_hull(empty), empty.convex_hull(box)):
        assert hull.area() == pytest.approx(2.0, rel=1e-9)
    assert empty.convex_hull(empty).is_empty()


@moderate
@given(random_sets(n=2), st.integers(0, 2**32 - 1))
@pytest.mark.slow
def test_intersections_are_exact(case: Raw, seed: int) -> None:
    rng = np.random.default_rng(seed)
    R = rng.normal(size=(1, 2))
    reach = np.abs(R @ case.G).sum()
    middle, radius = float(R[0] @ case.c) + rng.uniform(-1, 1) * reach, rng.uniform(0.05, 0.5) * (reach + case.size)
    band = Zonotope(np.array([middle]), np.array([[radius]]))
    both = case.constrained().intersection(band, R)
    strip = case.constrained().intersect_strip(R[0], middle, radius)
    if not both.is_empty():
        d = directions(2, 3)
        np.testing.assert_allclose(both.support(d), strip.support(d), atol=1e-7 * (case.size + np.abs(case.c).sum()))
    assert_holds(of(both), members(case, 2, [(R[0], middle - radius, middle + radius)]), case)
    whole = case.constrained().intersection(case.constrained())
    assert_holds(of(whole), members(case, 1), case)


def test_tangents_cut_a_disc_out_of_a_box() -> None:
    angle = 2 * np.pi * np.arange(16) / 16
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    cut = ConstrainedZonotope.box([-2.0, -2.0], [2.0, 2.0]).intersect_tangents(normals, np.ones(16))
    assert cut.area() == pytest.approx(16 * np.tan(np.pi / 16), rel=1e-9)
    one_by_one = ConstrainedZonotope.box([-2.0, -2.0], [2.0, 2.0])
    for normal in normals:
        one_by_one = one_by_one.intersect_halfspace(normal, 1.0)
    assert one_by_one.area() == pytest.approx(float(cut.area()), rel=1e-9)
    inactive = cut.intersect_tangents(normals, np.full(16, np.inf))
    assert inactive.area() == pytest.approx(float(cut.area()), rel=1e-9)
    assert inactive.simplify().constraint_matrix.shape == cut.constraint_matrix.shape


@pytest.mark.parametrize("radius", [0.2, 0.8])
def test_linearised_rows_keep_what_meets_the_predicate(radius: float) -> None:
    """``|x y - 1| <= r`` around (1, 1): the remainder of the product is ``(x - 1)(y - 1)``."""
    c = ConstrainedZonotope.box([0.5, 0.5], [1.5, 1.5])
    cut = c.intersect_linearised([1.0, 1.0], 0.0, (-0.25, 0.25), radius)
    points = np.random.default_rng(0).uniform(0.5, 1.5, (500, 2))
    kept = points[np.abs(points.prod(axis=1) - 1) <= radius]
    assert cut.contains_point(kept).all()
    assert cut.area() < 1.0 or radius > 0.7
    free = c.intersect_linearised([1.0, 1.0], 0.0, (-np.inf, np.inf), radius)
    assert free.area() == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize("case", INHABITED[::3], ids=named)
def test_containment_is_shown_and_never_wrongly(case: Raw) -> None:
    c = case.constrained()
    inner = members(case, 3)
    assert c.contains_set(c)
    larger = c.minkowski_sum(Zonotope(np.zeros(case.n), case.size * np.eye(case.n) / 10))
    assert larger.contains_set(c)
    assert not c.contains_set(larger)
    assert c.contains_set(Zonotope.point(inner.mean(axis=0)))
    far = inner[0] + 3 * case.size
    assert not c.contains_set(Zonotope.point(far))
    assert c.contains_set(ConstrainedZonotope(far, np.eye(case.n), np.ones((1, case.n)), np.array([case.n + 1.0])))
    if case.n <= 2:
        assert ConstrainedZonotope.from_zonotope(c.enclosing_zonotope()).contains_set(c)


def test_containment_in_space_sees_the_constraints_of_both() -> None:
    box = ConstrainedZonotope.box(-np.ones(3), np.ones(3))
    corner = box.intersect_halfspace([1.0, 1.0, 1.0], 0.0)
    smaller = box.intersect_halfspace([1.0, 1.0, 1.0], -0.5)
    assert box.contains_set(corner)
    assert not corner.contains_set(box)
    assert not smaller.contains_set(corner)
    assert corner.contains_set(smaller)


@pytest.mark.parametrize("case", [c for c in INHABITED[::2] if "far away, a corner" not in c.name], ids=named)
def test_factors_reach_the_points_they_are_of(case: Raw) -> None:
    inner = members(case, 1)
    middle = inner.mean(axis=0)
    factors = case.constrained().factors_of(middle)
    assert np.abs(factors).max(initial=0.0) <= 1.0
    np.testing.assert_allclose(case.c + case.G @ factors, middle, atol=ROUNDING * case.size)
    size = np.abs(case.A).sum(axis=1)
    assert (np.abs(case.A @ factors - case.b) <= ROUNDING * size).all()
    far = middle + 3 * case.size
    assert np.isnan(case.constrained().factors_of(far)).all()


@pytest.mark.parametrize("case", INHABITED[::3], ids=named)
def test_disjoint_sets_are_told_from_others(case: Raw) -> None:
    c = case.constrained()
    inner = members(case, 2)
    box = Zonotope(inner.mean(axis=0), case.size * np.eye(case.n) / 100)
    assert c.intersects(box)
    assert not c.intersects(box.translate(np.full(case.n, 3 * case.size)))
    assert c.intersects(c)


def test_an_empty_set_answers_like_one() -> None:
    empty = ConstrainedZonotope.box([0.0, 0.0], [1.0, 1.0]).intersect_halfspace([1.0, 0.0], -0.5)
    assert np.isneginf(empty.support([[1.0, 0.0], [0.0, 1.0]])).all()
    lower, upper = empty.interval_hull()
    assert np.isposinf(lower).all()
    assert np.isneginf(upper).all()
    assert empty.area() == 0.0
    assert not empty.contains_point([0.5, 0.5])
    assert not empty.contains_set(Zonotope.point([0.5, 0.5]))
    assert not empty.intersects(ConstrainedZonotope.box([0.0, 0.0], [1.0, 1.0]))
    assert empty.project((0,)).volume() == 0.0
    assert empty.cartesian_product(Zonotope.point([1.0])).volume() == 0.0


def test_volumes_in_space_are_bracketed() -> None:
    box = ConstrainedZonotope.box([-1.0, -1.0, -1.0], [1.0, 1.0, 1.0])
    half = box.intersect_halfspace([1.0, 1.0, 1.0], 0.0)
    inner, outer = half.volume_bracket()
    assert inner <= 4.0 <= outer
    assert outer - inner < 0.02
    assert half.volume() == outer
    corner = box.intersect_halfspace([-1.0, -1.0, -1.0], -2.0)
    inner, outer = corner.volume_bracket()
    assert inner <= 1 / 6 <= outer <= 0.17
    flat = box.intersect_strip([0.0, 0.0, 1.0], 0.5, 0.0)
    inner, outer = flat.volume_bracket()
    assert inner == 0.0
    assert 0.0 <= outer < 1e-9
    many = ConstrainedZonotope.box(-np.ones(7), np.ones(7)).intersect_halfspace(np.ones(7), 0.0)
    inner, outer = many.volume_bracket()
    assert inner <= 64.0 <= outer <= 128.0 * (1 + 1e-9)


def test_segments_have_their_length() -> None:
    c = ConstrainedZonotope(np.ones(1), np.array([[1.0, 2.0]]), np.ones((1, 2)), np.ones(1))
    inner, outer = c.volume_bracket()
    true = of(c)
    top, bottom = extreme(true, np.array([1.0])), extreme(true, np.array([-1.0]))
    assert top is not None
    assert bottom is not None
    assert inner <= top[0] + bottom[0] <= outer
    assert outer == pytest.approx(top[0] + bottom[0], rel=1e-9)


def test_directions_of_operands_compose() -> None:
    box = ConstrainedZonotope.box([0.0, 0.0], [1.0, 1.0])
    outer = box.keep_newest_constraints(0).reduce_order(1)
    assert outer.direction is Direction.EXACT
    reduced = box.minkowski_sum(box).reduce_order(1)
    assert reduced.direction is Direction.OUTER
    assert box.minkowski_sum(reduced).direction is Direction.OUTER
    assert box.convex_hull(Zonotope(np.zeros(2), np.eye(2), Direction.OUTER)).direction is Direction.OUTER
    with pytest.raises(SetError, match="other is a float"):
        box.minkowski_sum(1.0)  # type: ignore[arg-type]
