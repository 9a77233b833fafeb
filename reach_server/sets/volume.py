"""Volumes between two bounds: of zonotopes however many generators there are, and of constrained zonotopes."""

from math import comb

import numpy as np
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import FloatArray
from reach_server.sets import outline, support
from reach_server.sets.order_reduction import girard, pca
from reach_server.sets.parts import Parts, at, batch_of, common_batch
from reach_server.sets.polygon import zonotope_area, zonotope_volume

#: Determinants per set up to which the volume is computed exactly.
EXACT = 2_000
#: The bracket of a constrained volume is refined until it is this narrow, or after this many rounds.
NARROW, ROUNDS = 1e-3, 4
#: Dimensions up to which hulls of points are computed; beyond, the bracket is (0, volume of the interval hull).
HULLS = 5


def zonotope_volume_bracket(generators: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(inner, outer) bounds (...) of the volume of zonotopes with generators (..., n, g).

    In the plane, and up to 2000 determinants, both are the exact volume, apart by 64 n² ulps of the interval hull's
    volume for rounding. Beyond: ``Σ det² = det(GGᵀ)`` over the choices of n generators (Cauchy, Binet), so
    ``2ⁿ sqrt(det GGᵀ) <= V <= 2ⁿ sqrt(C(g, n) det GGᵀ)``; the inner bound is at least the volume of the longest
    generators alone, the outer one at most that of a reduced set and of the interval hull.
    """
    n, g = generators.shape[-2:]
    widths = np.abs(generators).sum(axis=-1)
    # One size for every coordinate: the determinants neither overflow nor underflow.
    scaled = generators / np.where(widths > 0, widths, 1.0)[..., None]
    hull = 2.0**n * np.where((widths > 0).all(axis=-1), 1.0, 0.0)
    margin = (64 * n**2 + 8 * g) * EPS * hull
    if n == 2 or comb(g, n) <= EXACT:
        exact = zonotope_area(scaled) if n == 2 else zonotope_volume(scaled)
        inner = outer = exact
    else:
        gram = np.maximum(np.linalg.det(scaled @ np.swapaxes(scaled, -1, -2)), 0.0)
        few = max(k for k in range(n, g) if comb(k, n) <= EXACT)
        longest = np.argsort(-(scaled**2).sum(axis=-2), axis=-1, kind="stable")[..., None, :few]
        part = zonotope_volume(np.take_along_axis(scaled, longest, axis=-1))
        inner = np.maximum(2.0**n * np.sqrt(gram) * (1 - n * EPS), part)
        outer = 2.0**n * np.sqrt(comb(g, n) * (gram + margin))
        for reduced in (girard(scaled, few), pca(scaled, few)):
            outer = np.minimum(outer, zonotope_volume(reduced))
    inner, outer = np.maximum(inner - margin, 0.0), np.minimum(outer + margin, hull * (1 + g * n * EPS))
    unit = widths.prod(axis=-1)
    return np.asarray(inner * unit * (1 - 2 * n * EPS)), np.asarray(outer * unit * (1 + 2 * n * EPS))


def constrained_volume_bracket(parts: Parts) -> tuple[FloatArray, FloatArray]:
    """(inner, outer) bounds (...) of the volume of constrained zonotopes: from attained points and from certified
    directions; in three dimensions and more set by set."""
    _, generators, matrix, offset = parts
    n, batch = generators.shape[-2], batch_of(parts)
    if n == 2:
        return outline.area_bracket(parts)
    if n == 1:
        # About the origin: far from it, rounding of the ends would show.
        ends = support.parts_support((np.zeros(1), generators, matrix, offset), np.array([[1.0], [-1.0]]))
        width = np.broadcast_to(np.maximum(ends.sum(axis=-1) * (1 + EPS), 0.0), batch)
        return np.maximum(width - 1e-9 * np.abs(generators).sum(axis=(-2, -1)), 0.0), width
    parts = common_batch(parts)
    found = np.zeros((*batch, 2))
    for index in np.ndindex(*batch):
        found[index] = _refined_bracket(at(parts, index))
    return found[..., 0], found[..., 1]


def _refined_bracket(parts: Parts) -> tuple[float, float]:
    """(inner, outer) bounds of the volume of one set in three or more dimensions.

    Inner: the hull of attained points; outer: the polytope of certified directions. Both start from the axes and random
    directions and are refined by the normals of the inner hull's facets.
    """
    _, generators, matrix, offset = parts
    n = generators.shape[0]
    widths = np.abs(generators).sum(axis=1)
    unit = float(widths.prod())
    if unit == 0.0:
        return 0.0, 0.0
    scaled = generators / widths[:, None]
    axes = np.concatenate([np.eye(n), -np.eye(n)])
    directions = np.concatenate([axes, np.random.default_rng(n).normal(size=(12 * n, n))])
    if n > HULLS:
        directions = axes
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found = support.solve(np.zeros(n), scaled, matrix, offset, directions)
    if found.empty.any():
        return 0.0, 0.0
    points, heights = found.factors @ scaled.T, found.bound
    outer = float(np.maximum(heights[:n] + heights[n : 2 * n], 0.0).prod())
    inner = 0.0
    for _ in range(ROUNDS if n <= HULLS else 0):
        try:
            hull = ConvexHull(points)
            cells = np.column_stack([directions, -heights])
            corners = HalfspaceIntersection(cells, points.mean(axis=0)).intersections
            outer = min(outer, float(ConvexHull(corners).volume) * (1 + 1e-9))
        except QhullError:
            break
        inner = max(inner, float(hull.volume) * (1 - 1e-9))
        if outer - inner <= NARROW * outer:
            break
        normals = np.unique(np.round(hull.equations[:, :n], 12), axis=0)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        more = support.solve(np.zeros(n), scaled, matrix, offset, normals)
        directions, heights = np.concatenate([directions, normals]), np.concatenate([heights, more.bound])
        points = np.unique(np.concatenate([points, more.factors @ scaled.T]), axis=0)
    return min(inner, outer) * unit, outer * unit
