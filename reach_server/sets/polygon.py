"""Areas and outlines in the plane."""

import math
from collections.abc import Iterable, Iterator
from itertools import combinations, islice

import numpy as np

from reach_server.numeric.jit import ONE, ZERO, kernel, reduction_kernel, stacked
from reach_server.numeric.types import FloatArray
from reach_server.sets.kernels.planar import clip_one, pair_area, polygon_of

#: Determinants that are computed at once.
CHUNK = 50_000


def zonotope_area(generators: FloatArray) -> FloatArray:
    """Exact area (...) of planar zonotopes with generators (..., 2, g): ``4 Σ_{i<j} |det(g_i, g_j)|``."""
    batch = generators.shape[:-2]
    return _area_rows(_flat(generators)).reshape(batch)


@reduction_kernel
def _area_rows(generators: FloatArray) -> FloatArray:
    area = np.zeros(len(generators))
    for p in range(len(generators)):
        area[p] = pair_area(generators[p], ZERO, ONE, generators.shape[2])
    return area


def zonotope_polygon(center: FloatArray, generators: FloatArray) -> FloatArray:
    """Exact vertices (..., 2 g, 2) of planar zonotopes, counter-clockwise; parallel generators repeat none of them
    but leave vertices in the middle of an edge, zero ones repeat one."""
    around = _polygon_rows(_flat(generators))
    return center[..., None, :] + around.reshape(*generators.shape[:-2], *around.shape[1:])


@reduction_kernel
def _polygon_rows(generators: FloatArray) -> FloatArray:
    count, _, g = generators.shape
    vertices, edges = np.zeros((count, max(2 * g, 1), 2)), np.zeros((3, g))
    for p in range(count):
        polygon_of(generators[p], ZERO, ONE, g, vertices[p], edges)
    return vertices


def _flat(array: FloatArray) -> FloatArray:
    """Matrices (..., a, b) in one batch axis, contiguous and read-only."""
    return stacked(array, 2, array.shape[:-2], math.prod(array.shape[:-2]))


def directions(count: int) -> FloatArray:
    """Unit vectors (count, 2) at equal angles, the first along the first axis."""
    angle = 2 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def outer_polygon(heights: FloatArray) -> FloatArray:
    """Vertices (..., K, 2), counter-clockwise, of the polygon ``{x : d_k·x <= heights_k}`` for ``directions(K)``.

    Needs ``heights`` (..., K >= 3) that bound a nonempty set from outside; a bound that its neighbours make
    superfluous is first lowered to what they imply, so that the vertices come in order. An outer bound.
    """
    count = heights.shape[-1]
    flat = np.ascontiguousarray(heights).reshape(-1, count)
    return _outer_vertices(flat, directions(count)).reshape(*heights.shape, 2)


@kernel
def _outer_vertices(heights: FloatArray, unit: FloatArray) -> FloatArray:
    """Vertices (R, K, 2) of polygons of heights (R, K) over the directions ``unit`` (K, 2)."""
    rows, count = heights.shape
    turn = 2 * np.pi / count
    sine = np.sin(turn * np.arange(count))
    cosine = np.cos(turn)
    vertices, lowered = np.empty((rows, count, 2)), np.empty(count)
    for row in range(rows):
        proper = True
        for k in range(count):
            lowered[k] = heights[row, k]
            # Every edge has a length if no bound is superfluous beside its neighbours.
            proper = proper and heights[row, k - 1] + heights[row, (k + 1) % count] >= 2 * cosine * lowered[k]
        for k in range(0 if proper else count):
            # Between two directions less than half a turn apart, their bounds imply one; in the plane two are enough.
            for after in range(2, (count + 1) // 2):
                for left in range(1, after):
                    right = after - left
                    before, behind = heights[row, (k - left) % count], heights[row, (k + right) % count]
                    implied = (before * sine[right] + behind * sine[left]) / sine[after]
                    lowered[k] = min(lowered[k], implied)
        for k in range(count):
            # On the edge of direction k the next edge is met at this signed distance from its foot point.
            along = (lowered[(k + 1) % count] - lowered[k] * cosine) / np.sin(turn)
            vertices[row, k, 0] = lowered[k] * unit[k, 0] - along * unit[k, 1]
            vertices[row, k, 1] = lowered[k] * unit[k, 1] + along * unit[k, 0]
    return vertices


def clip(vertices: FloatArray, normal: FloatArray, bound: FloatArray) -> FloatArray:
    """Vertices (..., V + 1, 2) of convex polygons (..., V, 2) cut to ``normal·x <= bound``: exact up to rounding.

    Counter-clockwise order stays; points repeat instead of the number of vertices varying. ``normal`` is (2,) and
    ``bound`` (...). A polygon without a vertex inside comes back whole.
    """
    batch = np.broadcast_shapes(vertices.shape[:-2], bound.shape)
    size = math.prod(batch)
    clipped = _clipped_rows(
        stacked(vertices, 2, batch, size), float(normal[0]), float(normal[1]), stacked(bound, 0, batch, size), size
    )
    return clipped.reshape(*batch, *clipped.shape[1:])


@reduction_kernel
def _clipped_rows(vertices: FloatArray, x: float, y: float, bounds: FloatArray, count: int) -> FloatArray:
    most = vertices.shape[1] + 1
    clipped = np.zeros((count, most, 2))
    for p in range(count):
        found = clip_one(vertices[p % len(vertices)], most - 1, x, y, bounds[p % len(bounds)], clipped[p])
        for i in range(found, most):
            clipped[p, i, 0], clipped[p, i, 1] = clipped[p, found - 1, 0], clipped[p, found - 1, 1]
    return clipped


def polygon_area(vertices: FloatArray) -> FloatArray:
    """Area (...) of polygons with vertices (..., K, 2) in counter-clockwise order."""
    # Far from the origin the products would round away the area.
    vertices = vertices - vertices[..., :1, :]
    following = np.roll(vertices, -1, axis=-2)
    cross = vertices[..., 0] * following[..., 1] - vertices[..., 1] * following[..., 0]
    return np.asarray(0.5 * cross.sum(axis=-1))


def zonotope_volume(generators: FloatArray) -> FloatArray:
    """Exact volume (...) in any dimension, ``2ⁿ Σ |det|`` over all choices of n generators (..., n, g) [GK10]."""
    n, g = generators.shape[-2:]
    total = np.zeros(generators.shape[:-2])
    at_once = max(1, CHUNK // max(1, total.size))
    for some in _groups(combinations(range(g), n), at_once):
        chosen = np.moveaxis(generators[..., np.array(some, dtype=np.intp)], -3, -2)
        total = total + np.abs(np.linalg.det(chosen)).sum(axis=-1)
    return np.asarray(2.0**n * total)


def _groups(items: Iterable[tuple[int, ...]], size: int) -> Iterator[list[tuple[int, ...]]]:
    items = iter(items)
    while group := list(islice(items, size)):
        yield group
