"""Members of constrained zonotopes, drawn by linear programs and, in the plane, from their outlines."""

import numpy as np

from reach_server.numeric.types import FloatArray
from reach_server.sets import support
from reach_server.sets.constraint_reduction import Indices, Parts
from reach_server.sets.kernels import simplex

#: Vertices of the factors' polytope that mixtures are made of.
VERTICES = 12


def factor_vertices(matrix: FloatArray, offset: FloatArray, rng: np.random.Generator, count: int) -> FloatArray:
    """Vertices (P, count, g) of ``{Aβ = b, |β| <= 1}`` in random directions; NaN where that is certainly empty."""
    problems, _, g = matrix.shape
    costs = rng.normal(size=(problems, count, g))
    found = support.solve(np.zeros(g), np.eye(g), matrix, offset, costs)
    return np.where(found.empty[..., None], np.nan, found.factors)


def mixtures(matrix: FloatArray, offset: FloatArray, rng: np.random.Generator, count: int) -> FloatArray:
    """Factors (P, count, g): every third one a vertex of their polytope, the others mixtures of vertices."""
    vertices = factor_vertices(matrix, offset, rng, VERTICES)
    weights = rng.dirichlet(np.full(VERTICES, 0.5), size=(len(matrix), count))
    pure = np.eye(VERTICES)[rng.integers(VERTICES, size=(len(matrix), count))]
    weights = np.where((np.arange(count) % 3 == 0)[:, None], pure, weights)
    return np.asarray(weights @ vertices)


def shots(parts: Parts, rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray]:
    """An inner point's factors (P, 1, g), and those of the boundary points (P, count, g) in random directions from it.

    The directions lie in the flat that the set spans.
    """
    _, generators, matrix, offset = parts
    problems, n, g = generators.shape
    rows = matrix.shape[1]
    vertices = factor_vertices(matrix, offset, rng, VERTICES)
    middle = vertices.mean(axis=1, keepdims=True)
    # Deviations of vertices, in units of the set's widths in space: a random mixture of them points anywhere.
    moves = rng.normal(size=(problems, count, VERTICES)) @ (vertices - middle)
    ways = moves @ np.swapaxes(generators, -1, -2)
    widths = np.abs(generators).sum(axis=-1)
    size = np.abs(ways / np.where(widths > 0, widths, 1.0)[:, None]).max(axis=-1, keepdims=True)
    ways = ways * np.where(size > 1e-12, 2.0 / np.where(size > 0, size, 1.0), 0.0)
    known = np.isfinite(middle).all(axis=(1, 2))
    ways, start = np.where(known[:, None, None], ways, 0.0), np.where(known[:, None, None], middle, 0.0)
    system = np.zeros((problems, count, n + rows, g + 1))
    system[..., :n, :g], system[..., n:, :g] = generators[:, None], matrix[:, None]
    system[..., :n, g] = -ways
    right = np.zeros((problems, count, n + rows))
    right[..., :n] = start @ np.swapaxes(generators, -1, -2)
    right[..., n:] = offset[:, None]
    farthest = np.append(np.zeros(g), 1.0)[None]
    found = support.solve(np.zeros(1), farthest, system, right, np.ones((1, 1)))
    hit = found.factors[..., 0, :g]
    missed = (found.status[..., 0] != simplex.OPTIMAL)[..., None]
    return middle, np.where(known[:, None, None], np.where(missed, start, hit), np.nan)


def from_outline(vertices: FloatArray, rng: np.random.Generator, count: int, *, boundary: bool) -> FloatArray:
    """Points (P, count, 2) of convex polygons (P, V, 2), uniform by area, or by length along the boundary.

    Flat polygons are drawn from by length, points come back as they are.
    """
    following = np.roll(vertices, -1, axis=1)
    lengths = np.linalg.norm(following - vertices, axis=-1)
    total = lengths.sum(axis=1)
    lengths = np.where((total > 0)[:, None], lengths, 1.0)
    edge, share = _choose(lengths, rng, count), rng.random((len(vertices), count, 1))
    around = _at(vertices, edge) * (1 - share) + _at(following, edge) * share
    if boundary:
        return np.asarray(around)
    first = vertices[:, :1]
    spans, following_spans = vertices - first, following - first
    areas = np.abs(spans[..., 0] * following_spans[..., 1] - spans[..., 1] * following_spans[..., 0])
    flat = areas.sum(axis=1) <= 1e-12 * total**2
    triangle = _choose(np.where(flat[:, None], 1.0, areas), rng, count)
    root = np.sqrt(rng.random((len(vertices), count, 1)))
    edge_point = _at(spans, triangle) * (1 - share) + _at(following_spans, triangle) * share
    return np.where(flat[:, None, None], around, first + root * edge_point)


def _choose(weights: FloatArray, rng: np.random.Generator, count: int) -> Indices:
    """Indices (P, count) drawn by weights (P, V)."""
    steps = np.cumsum(weights, axis=1)
    drawn = rng.random((len(weights), count)) * steps[:, -1:]
    return np.asarray((drawn[..., None] >= steps[:, None]).sum(axis=-1).clip(max=weights.shape[1] - 1))


def _at(vertices: FloatArray, index: Indices) -> FloatArray:
    return np.take_along_axis(vertices, index[..., None], axis=1)
