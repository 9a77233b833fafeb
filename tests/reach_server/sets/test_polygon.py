"""Planar figures against Shapely: outlines are outer, clipping is exact, areas agree."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely import MultiPoint, Polygon, box
from shapely.affinity import rotate

from reach_server.numeric.types import FloatArray
from reach_server.sets import polygon as planar
from tests.reach_server.ugly import assert_outlines, moderate


def points_of(seed: int) -> FloatArray:
    """The corners of a random convex polygon, sometimes flat, a point, or small and far away."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(rng.integers(1, 9), 2)) * [1.0, rng.choice([1.0, 1e-3, 1e-9, 0.0])]
    angle = rng.uniform(0, np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.asarray(points @ turn.T * rng.choice([1.0, 1e-6, 1e6]) + rng.normal(size=2))


@moderate
@given(st.integers(0, 2**32 - 1), st.sampled_from([3, 4, 5, 8, 12, 32]), st.sampled_from([0.0, 1e-7, 1e-3, 1.0]))
def test_a_polygon_of_heights_holds_the_set_and_its_area(seed: int, count: int, excess: float) -> None:
    points = points_of(seed)
    size = float(np.ptp(points, axis=0).max() + 1e-9 * np.abs(points).max())
    true = (points @ planar.directions(count).T).max(axis=0)
    # Bounds that an inexact solver gives: too high by anything, here and there.
    heights = true + excess * size * np.random.default_rng(seed).uniform(0, 1, count)
    vertices = planar.outer_polygon(heights)
    assert_outlines(vertices, points, size)
    hull = MultiPoint(points).convex_hull
    assert planar.polygon_area(vertices) >= hull.area - 1e-9 * size**2


def test_exact_heights_give_the_tangent_polygon() -> None:
    square = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    vertices = planar.outer_polygon((square @ planar.directions(8).T).max(axis=0))
    assert planar.polygon_area(vertices) == pytest.approx(4.0)
    disc = planar.outer_polygon(np.ones(32))
    assert planar.polygon_area(disc) == pytest.approx(32 * np.tan(np.pi / 32))


@moderate
@given(st.integers(0, 2**32 - 1))
def test_clipping_agrees_with_shapely(seed: int) -> None:
    rng = np.random.default_rng(seed)
    generators = rng.normal(size=(2, 4))
    vertices = planar.zonotope_polygon(rng.normal(size=2), generators)
    true = Polygon(vertices)
    for _ in range(3):
        angle = rng.uniform(0, 2 * np.pi)
        normal = np.array([np.cos(angle), np.sin(angle)])
        low, high = (vertices @ normal).min(), (vertices @ normal).max()
        bound = rng.uniform(low + 0.2 * (high - low), high + 0.1)
        plane = rotate(box(bound - 100, -100, bound, 100), np.degrees(angle), origin=(0, 0))
        vertices, true = planar.clip(vertices, normal, np.array(bound)), true.intersection(plane)
        assert planar.polygon_area(vertices) == pytest.approx(true.area, abs=1e-9)
        assert MultiPoint(vertices).convex_hull.area == pytest.approx(true.area, abs=1e-9)


def test_clipping_by_nothing_and_by_everything_leaves_a_batch_whole() -> None:
    square = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    wide = np.broadcast_to(square, (4, 4, 2))
    clipped = planar.clip(wide, np.array([1.0, 0.0]), np.array([np.inf, 2.0, 0.0, -2.0]))
    np.testing.assert_allclose(planar.polygon_area(clipped), [4.0, 4.0, 2.0, 4.0])


def test_areas_of_batches() -> None:
    generators = np.random.default_rng(0).normal(size=(3, 2, 2, 5))
    areas = planar.zonotope_area(generators)
    for place in np.ndindex(3, 2):
        pairs = [
            abs(np.linalg.det(generators[place][:, [i, j]])) for i in range(5) for j in range(i + 1, 5)
        ]  # fmt: skip
        assert areas[place] == pytest.approx(4 * sum(pairs))
        assert planar.zonotope_volume(generators[place]) == pytest.approx(areas[place])
    assert planar.zonotope_area(np.zeros((2, 0))) == 0.0
