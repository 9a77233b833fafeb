"""Areas and outlines in the plane."""

from collections.abc import Iterable, Iterator
from itertools import combinations, islice

import numpy as np

from reach_server.sets.arrays import Array

#: Determinants that are computed at once.
CHUNK = 50_000


def zonotope_area(generators: Array) -> Array:
    """Exact area (...) of planar zonotopes with generators (..., 2, g): ``4 Σ_{i<j} |det(g_i, g_j)|``.

    Sorted by angle, the pairwise determinants of half-plane-normalised generators are nonnegative, so their
    sum needs one cumulative sum instead of all pairs.
    """
    if generators.shape[-1] == 0:
        return np.zeros(generators.shape[:-2])
    ordered = _by_angle(generators)
    before = np.cumsum(ordered, axis=-1) - ordered
    determinants = before[..., 0, :] * ordered[..., 1, :] - before[..., 1, :] * ordered[..., 0, :]
    return np.asarray(4.0 * np.abs(determinants).sum(axis=-1))


def zonotope_polygon(center: Array, generators: Array) -> Array:
    """Exact vertices (..., 2 g, 2) of planar zonotopes, counter-clockwise; parallel generators repeat none of them
    but leave vertices in the middle of an edge."""
    if generators.shape[-1] == 0:
        return center[..., None, :]
    ordered = 2.0 * np.swapaxes(_by_angle(generators), -1, -2)
    start = center[..., None, :] - ordered.sum(axis=-2, keepdims=True) / 2
    # From the lowest vertex the edges follow each other by angle, then again with opposite sign.
    edges = np.concatenate([ordered, -ordered], axis=-2)
    return np.asarray(start + np.cumsum(edges, axis=-2))


def _by_angle(generators: Array) -> Array:
    """Generators turned into the upper half plane (sign does not matter to the set) and sorted by angle."""
    x, y = generators[..., 0, :], generators[..., 1, :]
    sign = np.where((y < 0) | ((y == 0) & (x < 0)), -1.0, 1.0)
    turned = generators * sign[..., None, :]
    order = np.argsort(np.arctan2(turned[..., 1, :], turned[..., 0, :]), axis=-1, kind="stable")
    return np.take_along_axis(turned, order[..., None, :], axis=-1)


def directions(count: int) -> Array:
    """Unit vectors (count, 2) at equal angles, the first along the first axis."""
    angle = 2 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def outer_polygon(heights: Array) -> Array:
    """Vertices (..., K, 2), counter-clockwise, of the polygon ``{x : d_k·x <= heights_k}`` for ``directions(K)``.

    Needs ``heights`` (..., K >= 3) that bound a nonempty set from outside; a bound that its neighbours make
    superfluous is first lowered to what they imply, so that the vertices come in order. An outer bound.
    """
    count = heights.shape[-1]
    turn = 2 * np.pi / count
    lowered = heights
    # Between two directions less than half a turn apart, their bounds imply one; in the plane two are enough.
    for before, after in combinations(range(1, (count + 1) // 2), 2):
        left, right = before, after - before
        implied = np.roll(heights, left, axis=-1) * np.sin(right * turn)
        implied = (implied + np.roll(heights, -right, axis=-1) * np.sin(left * turn)) / np.sin(after * turn)
        lowered = np.minimum(lowered, implied)
    heights = lowered
    following = np.roll(heights, -1, axis=-1)
    unit = directions(count)
    tangent = np.stack([-unit[:, 1], unit[:, 0]], axis=-1)
    # On the edge of direction k the next edge is met at this signed distance from its foot point.
    along = (following - heights * np.cos(turn)) / np.sin(turn)
    return np.asarray(heights[..., None] * unit + along[..., None] * tangent)


def clip(vertices: Array, normal: Array, bound: Array) -> Array:
    """Vertices (..., V + 1, 2) of convex polygons (..., V, 2) cut to ``normal·x <= bound``: exact up to rounding.

    Counter-clockwise order stays; points repeat instead of the number of vertices varying. ``normal`` is (2,) and
    ``bound`` (...). A polygon without a vertex inside comes back whole.
    """
    height = vertices @ normal - bound[..., None]
    inside = np.less_equal(height, 0.0)
    whole = np.asarray(inside.all(axis=-1) | ~inside.any(axis=-1))
    places = []
    for neighbour in (1, -1):
        other, other_height = np.roll(vertices, neighbour, axis=-2), np.roll(height, neighbour, axis=-1)
        crosses = ~inside & (other_height <= 0)
        # Where a bound is infinite the heights are, but nothing crosses there.
        above, below = np.where(crosses, height, 1.0), np.where(crosses, other_height, 0.0)
        share = (above / (above - below))[..., None]
        point = np.where(crosses[..., None], vertices + share * (other - vertices), vertices)
        places.append((point, crosses | (inside | whole[..., None] if neighbour > 0 else False)))
    points = np.stack([places[0][0], places[1][0]], axis=-2).reshape(*vertices.shape[:-2], -1, 2)
    valid = np.stack([places[0][1], places[1][1]], axis=-1).reshape(*vertices.shape[:-2], -1)
    # One half-plane leaves at most one vertex more; the last one is repeated where there are fewer.
    most = vertices.shape[-2] + 1
    order = np.argsort(~valid, axis=-1, kind="stable")[..., :most]
    place = np.minimum(np.arange(most), valid.sum(axis=-1, keepdims=True) - 1)
    return np.take_along_axis(points, np.take_along_axis(order, place, axis=-1)[..., None], axis=-2)


def polygon_area(vertices: Array) -> Array:
    """Area (...) of polygons with vertices (..., K, 2) in counter-clockwise order."""
    # Far from the origin the products would round away the area.
    vertices = vertices - vertices[..., :1, :]
    following = np.roll(vertices, -1, axis=-2)
    cross = vertices[..., 0] * following[..., 1] - vertices[..., 1] * following[..., 0]
    return np.asarray(0.5 * cross.sum(axis=-1))


def zonotope_volume(generators: Array) -> Array:
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
