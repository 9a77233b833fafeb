"""Exact planar outlines and areas against polygon clipping (Shapely) and linear programs (HiGHS)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely import MultiPoint, Polygon

from reach_server.numeric.types import FloatArray
from reach_server.sets import ConstrainedZonotope, SetError, Zonotope, outline
from reach_server.sets import polygon as planar
from tests.reach_server.ugly import CONSTRAINED, INHABITED, Raw, directions, extreme, moderate, named

PLANAR = tuple(case for case in INHABITED if case.n == 2)


def band(normal: FloatArray, middle: float, radius: float, span: float) -> Polygon:
    """The strip ``|normal·x - middle| <= radius`` as far as ``span``."""
    size = np.linalg.norm(normal)
    across, along = normal / size, np.array([-normal[1], normal[0]]) * span / size
    foot, half = across * middle / size, across * radius / size
    return Polygon([foot + along + half, foot - along + half, foot - along - half, foot + along - half])


def cut_zonotope(rng: np.random.Generator) -> tuple[ConstrainedZonotope, Polygon]:
    """A zonotope cut by strips, and the same by polygon clipping."""
    z = Zonotope(np.zeros(2), rng.normal(size=(2, int(rng.integers(2, 20)))) * 10 ** rng.uniform(-6, 6))
    c, true = ConstrainedZonotope.from_zonotope(z), Polygon(z.polygon())
    span = float(10 * np.abs(z.generators).sum() + np.abs(z.center).sum())
    for _ in range(int(rng.integers(1, 8))):
        normal = rng.normal(size=2)
        reach = float(np.abs(normal @ z.generators).sum())
        middle, radius = float(normal @ z.center) + rng.uniform(-0.5, 0.5) * reach, rng.uniform(0.1, 0.7) * reach
        c = c.intersect_strip(normal, middle, radius)
        true = true.intersection(band(normal, middle, radius, span))
    return c, true


def close(vertices: FloatArray, true: Polygon) -> None:
    """Outer, and nowhere farther than 1e-9 of the extent from the true polygon."""
    size = max(true.bounds[2] - true.bounds[0], true.bounds[3] - true.bounds[1])
    ours = MultiPoint(vertices).convex_hull
    assert ours.buffer(1e-12 * size).covers(true)
    assert true.buffer(1e-9 * size).covers(ours)


@moderate
@given(st.integers(0, 2**32 - 1))
def test_outlines_and_areas_are_those_of_polygon_clipping(seed: int) -> None:
    c, true = cut_zonotope(np.random.default_rng(seed))
    if true.area == 0.0:
        assert np.isnan(c.polygon()).all()
        assert c.area() == 0.0
        return
    close(c.polygon(), true)
    inner, outer = c.area_bracket()
    assert c.area() == outer
    assert outer >= true.area * (1 - 1e-12)
    # Slivers: what is left of a large zonotope carries its rounding.
    rounding = 1e-12 * float(np.abs(c.generators).sum()) * true.length
    assert outer <= true.area * (1 + 1e-9) + rounding
    assert true.area * (1 - 1e-9) - rounding <= inner <= outer
    far = c.translate([1e3, -1e6])
    assert far.area() == outer


@pytest.mark.parametrize(("g", "rows"), [(6, 1), (12, 4), (40, 10)])
def test_outlines_of_general_constraints_agree_with_linear_programs(g: int, rows: int) -> None:
    rng = np.random.default_rng(g)
    A = rng.normal(size=(rows, g))
    case = Raw("", rng.normal(size=2), rng.normal(size=(2, g)), A, A @ rng.uniform(-0.5, 0.5, g))
    found = outline.outline(case.c, case.G, case.A, case.b)
    assert found.exact
    edges = np.roll(found.inner, -1, axis=0) - found.inner
    across = np.stack([edges[:, 1], -edges[:, 0]], axis=-1)[np.linalg.norm(edges, axis=1) > 1e-6]
    for d in (*directions(2, 20), *across[:: max(len(across) // 20, 1)]):
        true = extreme(case, d)
        assert true is not None
        reach = float(np.linalg.norm(d)) * case.size
        assert true[0] - 1e-12 * reach <= (found.outer @ d).max() <= true[0] + 1e-9 * reach
        assert (found.inner @ d).max() == pytest.approx(true[0], abs=1e-9 * reach)


@pytest.mark.parametrize("case", PLANAR, ids=named)
def test_ugly_sets_have_exact_outlines(case: Raw) -> None:
    found = outline.outline(case.c, case.G, case.A, case.b)
    assert found.exact
    assert not found.empty
    allowed = 1e-9 * case.size + 1e-15 * np.abs(case.c).sum()
    for d in directions(2, 3):
        true = extreme(case, d)
        if true is not None:
            reach = allowed * np.linalg.norm(d)
            # HiGHS itself is right up to 1e-7 of the rows.
            assert true[0] - 1e-7 * case.size <= (found.outer @ d).max() <= (found.inner @ d).max() + 4 * reach
            assert (found.inner @ d).max() <= true[0] + 1e-7 * case.size * np.linalg.norm(d)
    assert case.constrained().area() >= 0.0


@moderate
@given(st.integers(0, 2**32 - 1))
@pytest.mark.slow
def test_degenerate_sets_have_exact_outlines(seed: int) -> None:
    """Small whole numbers: parallel generators, dependent rows, vertices that many bases share."""
    rng = np.random.default_rng(seed)
    g, rows = int(rng.integers(1, 9)), int(rng.integers(0, 4))
    G, A = rng.integers(-2, 3, (2, g)).astype(float), rng.integers(-2, 3, (rows, g)).astype(float)
    case = Raw("", np.array([1.0, -2.0]), G, A, A @ rng.choice([-1.0, -0.5, 0.0, 0.5, 1.0], g))
    found = outline.outline(case.c, case.G, case.A, case.b)
    assert found.exact
    for d in (*directions(2, 2), *rng.integers(-2, 3, (4, 2)).astype(float)):
        true = extreme(case, d)
        assert true is not None
        assert true[0] - 1e-12 * (case.size + 1) <= (found.outer @ d).max() <= true[0] + 1e-8 * (case.size + 1)
    keeps = found.outer @ found.normals.T - found.heights
    assert (keeps.max(axis=0) <= 1e-9 * (case.size + 1)).all()


def test_batches_pad_and_empty_sets_have_no_outline() -> None:
    rng = np.random.default_rng(0)
    c = ConstrainedZonotope(np.zeros((3, 2)), rng.normal(size=(3, 2, 9)), np.zeros((0, 9)), np.zeros(0))
    c = c.intersect_halfspace(np.array([1.0, 0.0]), np.array([0.1, -1e3, np.inf]))
    vertices = c.polygon()
    np.testing.assert_array_equal(np.isnan(vertices).all(axis=(1, 2)), [False, True, False])
    np.testing.assert_array_equal(c.area() > 0, [True, False, True])
    assert c.area()[2] == pytest.approx(Zonotope(c.center, c.generators).area()[2], rel=1e-9)
    assert np.isnan(c.polygon(8)[1]).all()
    assert np.isfinite(c.polygon(8)[::2]).all()
    none = outline.outline(*(np.zeros((0, *shape)) for shape in ((2,), (2, 4), (1, 4), (1,))))
    assert none.outer.shape[0] == 0


@pytest.mark.parametrize("count", [3, 4, 7, 32])
@pytest.mark.parametrize("case", PLANAR[::9], ids=named)
def test_polygons_of_a_fixed_size_are_outer(case: Raw, count: int) -> None:
    vertices = case.constrained().polygon(count)
    assert vertices.shape == (count, 2)
    inner = outline.outline(case.c, case.G, case.A, case.b).inner
    for d in planar.directions(count):
        assert (vertices @ d).max() >= (inner @ d).max() - 1e-15 * (case.size + np.abs(case.c).sum())
        assert (vertices @ d).max() <= (inner @ d).max() + 1e-9 * case.size + 1e-14 * np.abs(case.c).sum()


def test_an_outline_that_fails_its_check_is_replaced_by_certified_directions(monkeypatch: pytest.MonkeyPatch) -> None:
    c, true = cut_zonotope(np.random.default_rng(3))
    monkeypatch.setattr(outline, "EXACT", -1.0)
    found = outline.outline(c.center, c.generators, c.constraint_matrix, c.constraint_offset)
    assert not found.exact
    assert found.outer.shape == (outline.FALLBACK, 2)
    size = float(np.sqrt(true.area))
    assert MultiPoint(found.outer).convex_hull.buffer(1e-12 * size).covers(true)
    assert true.buffer(1e-9 * size).covers(MultiPoint(found.inner).convex_hull)
    assert MultiPoint(found.outer).convex_hull.area < 1.1 * true.area


@pytest.mark.slow
def test_room_for_vertices_grows_as_needed() -> None:
    rng = np.random.default_rng(1)
    G, A = rng.normal(size=(1, 2, 20)), rng.normal(size=(1, 2, 20))
    zero = np.zeros((1, 2))
    *_, numbers, _ = outline.trace(zero, G, A, zero, 1, 6, 1000)
    assert numbers[0] == -2
    assert outline.outline(zero, G, A, zero).exact.all()


def test_outlines_need_a_plane_and_three_directions() -> None:
    with pytest.raises(SetError, match="planar"):
        ConstrainedZonotope.box(np.zeros(3), np.ones(3)).polygon()
    with pytest.raises(SetError, match="count is 2"):
        ConstrainedZonotope.box(np.zeros(2), np.ones(2)).polygon(2)


def test_every_empty_ugly_set_is_found_empty() -> None:
    for case in CONSTRAINED:
        if case.n == 2:
            assert bool(outline.outline(case.c, case.G, case.A, case.b).empty) is not case.inhabited, case.name


def test_an_outline_goes_round_once() -> None:
    """A chord of 1.5 mm along an edge of 1.8 m: rounding of its normal raises the far end of the edge above it."""
    first, second = 0.9001085711446106, 0.9001183151545563
    generators = np.array([[first, 0, 0.9, 0, 0], [0, second, 0.9, 0, 0]])
    matrix = np.array([[first, 0, 0.9, -1.7175000000000002, 0], [0, second, 0.9, 0, -1.702495836480543]])
    offset = np.array([-0.08106117779440042, -0.09762247867401341])
    center = np.array([0.3615611777944005, 1.6631266421934703])
    found = outline.outline(center, generators, matrix, offset)
    x, y = found.outer.T
    # Shapely's clipping of the zonotope by both strips; twice that where the outline goes round twice.
    assert float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2) == pytest.approx(9.0722206680, rel=1e-9)
    assert bool(found.exact)


def test_planar_cuts_never_enlarge_a_set() -> None:
    rng = np.random.default_rng(1)
    count = 4000
    sides = np.concatenate([np.broadcast_to(np.diag([0.9, 0.9]), (count, 2, 2)), np.full((count, 2, 1), 0.9)], axis=2)
    sets = Zonotope(rng.uniform(-1, 1, (count, 2)), sides * rng.uniform(0.9, 1.1, (count, 1, 1)))
    strips = (([1.0, 0.0], 0.2805, 1.7175), ([0.0, 1.0], 0.839, 2.429))
    cut, enclosing = ConstrainedZonotope.from_zonotope(sets), sets
    for strip in strips:
        cut, enclosing = cut.intersect_strip(*strip), enclosing.intersect_strip(*strip)
    assert (cut.area() <= enclosing.area() * (1 + 1e-9)).all()


@pytest.mark.parametrize("seed", range(5))
def test_strips_that_nearly_touch_corners_leave_one_turn_around_the_set(seed: int) -> None:
    """Edges of 1e-14 to 1e-1: the normal of a short chord is mostly rounding, and the walk must not go on by it."""
    rng, count = np.random.default_rng(seed), 1000
    generators = np.zeros((count, 2, 3))
    generators[:, 0, 0], generators[:, 1, 1] = 0.9 + 1e-4 * rng.uniform(0, 2, (2, count))
    generators[:, :, 2] = 0.9
    center, reach = rng.normal(size=(count, 2)), np.abs(generators).sum(axis=-1)
    cut = ConstrainedZonotope.from_zonotope(Zonotope(center, generators))
    bounds = []
    for axis in (0, 1):
        near = rng.choice([-1.8, -1e-4, 0.0, 1e-4, -0.9, 0.9], count)
        near += rng.choice([-1, 1], count) * 10 ** rng.uniform(-14, -0.5, count)
        low = np.clip(near, -reach[:, axis], reach[:, axis] - 0.2)
        high = reach[:, axis] + np.where(rng.random(count) < 0.5, 1, -1) * 10 ** rng.uniform(-12, -1, count)
        bounds += [low, high]
        middle, radius = center[:, axis] + (low + high) / 2, (high - low) / 2
        cut = cut.intersect_strip(np.tile(np.eye(2)[axis], (count, 1)), middle, radius)
    found = outline.outline(cut.center, cut.generators, cut.constraint_matrix, cut.constraint_offset)
    assert found.exact.all()
    # No more room than 8 generators and 2 rows take: refinement ends.
    assert found.outer.shape[1] < 40
    corners = np.array([[1, 1, 1], [-1, 1, 1], [-1, 1, -1], [-1, -1, -1], [1, -1, -1], [1, -1, 1]])
    areas = cut.area()
    for k in range(0, count, 10):
        whole = Polygon(corners @ generators[k].T)
        true = whole.intersection(Polygon([(bounds[0][k], bounds[2][k]), (bounds[1][k], bounds[2][k]),
                                           (bounds[1][k], bounds[3][k]), (bounds[0][k], bounds[3][k])]))  # fmt: skip
        assert areas[k] == pytest.approx(true.area, rel=1e-8)
    assert (areas <= Zonotope(center, generators).area() * (1 + 1e-9)).all()
