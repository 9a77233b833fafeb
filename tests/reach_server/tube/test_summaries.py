"""What is published about a set holds the set: area, outline, box and enclosing zonotope, cut or not."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely import MultiPoint, Polygon, box

from reach_server.numeric.types import FloatArray
from reach_server.predicates import Literals
from reach_server.sets.raw import RawSets
from reach_server.tube.summaries import (
    EXTRA_GENERATORS,
    OUTLINE,
    PlaneStrips,
    SetSummary,
    enclosing,
    summarize,
    union_summary,
)
from side_info import LinearPredicate
from tests.reach_server.ugly import (
    INHABITED,
    ROUNDING,
    ZONOTOPES,
    Raw,
    assert_outlines,
    corners,
    directions,
    members,
    moderate,
    named,
)

PLANE = (0, 1)


def strips(*cuts: tuple[list[float], float, float]) -> PlaneStrips:
    """One literal for each strip: (normal over the states, lower, upper)."""
    n = len(cuts[0][0]) if cuts else 2
    literals = Literals(n, PLANE, np.zeros((n, 0)))
    index = {f"s{i}": i for i in range(n)}
    for number, (normal, lower, upper) in enumerate(cuts):
        coefficients = {f"s{i}": c for i, c in enumerate(normal) if c}
        predicate = LinearPredicate(f"p{number}", coefficients, lower, upper)
        literals.add(predicate, index, scenario="s", name=predicate.name)
    return PlaneStrips.of(literals, range(literals.count), n, PLANE)


def factor_set(case: Raw) -> RawSets:
    return RawSets(case.c[None], case.G[None], case.A[None], case.b[None])


def none_act(count: int = 0) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    return np.zeros((1, count), dtype=bool)


@pytest.mark.parametrize("case", [c for c in INHABITED if c.n == 2][::2], ids=named)
def test_figures_hold_the_set(case: Raw) -> None:
    found = summarize(factor_set(case), none_act(), strips(), PLANE)
    assert found.outline().shape == (1, OUTLINE, 2)
    points = corners(case) if not len(case.A) else members(case, 3)
    relative = points - case.c
    assert_outlines(found.outline()[0], relative, case.size)
    assert (found.hull[0, 0] <= relative.min(axis=0) + ROUNDING * case.size).all()
    assert (found.hull[0, 1] >= relative.max(axis=0) - ROUNDING * case.size).all()
    # As sent, in float32.
    assert_outlines(found.outline()[0].astype(np.float32).astype(np.float64), relative, case.size)
    hull = MultiPoint(relative).convex_hull
    if not len(case.A):
        assert found.area[0] == pytest.approx(hull.area, rel=1e-6, abs=1e-12 * case.size**2)
    else:
        assert found.area[0] >= hull.area * (1 - 1e-9) - 1e-9 * case.size**2


@moderate
@given(st.integers(0, 2**32 - 1), st.integers(1, 3))
@pytest.mark.slow
def test_figures_of_cut_zonotopes_hold_what_obeys_the_cuts(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    center, generators = rng.normal(size=(1, 3)), rng.normal(size=(1, 3, 5))
    points = center + np.sign(rng.uniform(-1, 1, (4000, 5))) * rng.uniform(0.2, 1, (4000, 5)) @ generators[0].T
    cuts: list[tuple[list[float], float, float]] = []
    retained = np.ones(len(points), dtype=bool)
    for number in range(count):
        # The last one speaks about a state that is no position and must not clip the outline.
        normal = rng.normal(size=3) * [1.0, 1.0, float(number == 2)]
        heights = points @ normal
        low, high = np.quantile(heights, 0.2), np.quantile(heights, 0.9)
        low, high = (float(low), float(high)) if rng.random() < 0.6 else (-np.inf, float(high))
        cuts.append((normal.tolist(), low, high))
        retained &= (low <= heights) & (heights <= high)
    sets = RawSets.zonotope(center, generators)
    acting = np.ones((1, count), dtype=bool)
    found = summarize(sets, acting, strips(*cuts), PLANE)
    free = summarize(sets, ~acting, strips(*cuts), PLANE)
    assert found.area[0] <= free.area[0] * (1 + 1e-9)
    if retained.any():
        relative = (points - center)[retained]
        assert_outlines(found.outline()[0], relative[:, :2], 1.0)
        assert (found.hull[0, 0] <= relative.min(axis=0)).all()
        assert (found.hull[0, 1] >= relative.max(axis=0)).all()
        assert found.area[0] >= MultiPoint(relative[:, :2]).convex_hull.area * (1 - 1e-9)


def test_the_area_of_a_cut_zonotope_is_that_of_the_intersection() -> None:
    generators = np.array([[[1.0, 0.0, 0.5], [0.0, 1.0, 0.5]]])
    sets = RawSets.zonotope(np.array([[2.0, 3.0]]), generators)
    cuts = strips(([1.0, 0.0], 1.5, 2.2), ([0.0, 1.0], -np.inf, 3.4))
    found = summarize(sets, np.ones((1, 2), dtype=bool), cuts, PLANE)
    case = Raw("", sets.center[0], generators[0], np.zeros((0, 3)), np.zeros(0))
    exact = Polygon(MultiPoint(corners(case)).convex_hull.exterior).intersection(box(1.5, -10, 2.2, 3.4))
    assert found.area[0] == pytest.approx(exact.area)


def test_each_vehicle_is_clipped_by_its_own_cuts() -> None:
    sets = RawSets.zonotope(np.zeros((3, 2)), np.broadcast_to(np.eye(2), (3, 2, 2)))
    cuts = strips(([1.0, 0.0], -0.5, 0.5), ([0.0, 1.0], -np.inf, 0.0))
    acting = np.array([[False, False], [True, False], [True, True]])
    found = summarize(sets, acting, cuts, PLANE)
    np.testing.assert_allclose(found.area, [4.0, 2.0, 1.0])
    np.testing.assert_allclose(found.hull[:, 1], np.array([[1.0, 1.0], [0.5, 1.0], [0.5, 0.0]]), atol=1e-5)


def reach(generators: FloatArray, d: FloatArray) -> FloatArray:
    return np.asarray(np.abs(d @ generators).sum(axis=-1))


@pytest.mark.parametrize("case", ZONOTOPES, ids=named)
def test_enclosing_zonotopes_enclose_with_a_diagonal_end(case: Raw) -> None:
    found = enclosing(replace(factor_set(case)))[0]
    assert found.shape == (case.n, case.n + EXTRA_GENERATORS)
    d = directions(case.n, 30)
    assert (reach(found, d) >= reach(case.G, d) * (1 - 1e-12)).all()
    last = found[:, -case.n :]
    np.testing.assert_array_equal(last, np.diag(np.diag(last)))


@moderate
@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_figures_of_unions_hold_every_set(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    owner = np.sort(np.concatenate([np.arange(2), rng.integers(0, 2, count)]))
    sets = RawSets.zonotope(rng.normal(size=(len(owner), 3)), rng.normal(size=(len(owner), 3, 4)))
    each = summarize(sets, np.zeros((len(owner), 0), dtype=bool), strips(), PLANE)
    around = rng.normal(size=(2, 3))
    found = union_summary(each, owner, sets.center, around, PLANE)
    factors = np.sign(rng.uniform(-1, 1, (200, 4)))
    for union in range(2):
        points = np.concatenate(
            [sets.center[i] + factors @ sets.generators[i].T for i in np.flatnonzero(owner == union)]
        )
        relative = points - around[union]
        assert_outlines(found.outline()[union], relative[:, :2], 1.0)
        assert (found.hull[union, 0] <= relative.min(axis=0)).all()
        assert (found.hull[union, 1] >= relative.max(axis=0)).all()
        assert found.area[union] <= each.area[owner == union].sum() * (1 + 1e-12)
    assert isinstance(found, SetSummary)
