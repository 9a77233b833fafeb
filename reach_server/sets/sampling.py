"""Members of sets: of zonotopes by tilings, of constrained ones by linear programs and, in the plane, by outlines."""

import math
from typing import Literal, get_args

import numpy as np

from reach_server.numeric.checks import SetError, checked_count
from reach_server.numeric.types import FloatArray
from reach_server.sets import outline, support, tiling
from reach_server.sets.kernels import simplex
from reach_server.sets.parts import Indices, Parts, batch_of, common_batch

SampleMethod = Literal["inside", "boundary", "factors"]

#: Vertices of the factors' polytope that mixtures are made of.
VERTICES = 12


def asked(count: int, how: SampleMethod) -> tuple[int, SampleMethod]:
    """The number of samples and the way to draw them; ``SetError`` where there is no such number or way."""
    if how not in get_args(SampleMethod):
        raise SetError(f"how is {how!r}, expected one of {', '.join(get_args(SampleMethod))}")
    return checked_count(count, "count"), how


def sample_zonotopes(
    center: FloatArray, generators: FloatArray, rng: np.random.Generator, count: int, how: SampleMethod
) -> FloatArray:
    """Members (..., count, n) of zonotopes, exact up to rounding; see ``tiling``."""
    draws = {"inside": tiling.inner_factors, "boundary": tiling.boundary_factors, "factors": tiling.any_factors}
    n, g = generators.shape[-2:]
    batch = np.broadcast_shapes(center.shape[:-1], generators.shape[:-2])
    sets = math.prod(batch)
    flat = np.broadcast_to(generators, (*batch, n, g)).reshape(sets, n, g)
    factors = draws[how](flat, rng, count).reshape(*batch, count, g)
    return np.asarray(center[..., None, :] + factors @ np.swapaxes(generators, -1, -2))


def sample_constrained(parts: Parts, rng: np.random.Generator, count: int, how: SampleMethod) -> FloatArray:
    """Members (..., count, n) of constrained zonotopes, exact up to 1e-9 of the set's size; NaN where it is certainly
    empty."""
    batch = batch_of(parts)
    size, n = math.prod(batch), parts[1].shape[-2]
    if how != "factors" and n == 2:
        vertices = outline.outline(*parts).inner
        vertices = vertices.reshape(size, *vertices.shape[-2:])
        return from_outline(vertices, rng, count, boundary=how == "boundary").reshape(*batch, count, 2)
    center, generators, matrix, offset = (a.reshape(size, *a.shape[len(batch) :]) for a in common_batch(parts))
    if how == "factors":
        factors = mixtures(matrix, offset, rng, count)
    else:
        middle, factors = shots((center, generators, matrix, offset), rng, count)
        if how == "inside":
            part = rng.random((size, count, 1)) ** (1 / n)
            factors = middle + part * (factors - middle)
    points = center[:, None] + factors @ np.swapaxes(generators, -1, -2)
    points = np.where(support.certainly_empty(parts).reshape(size, 1, 1), np.nan, points)
    return np.asarray(points.reshape(*batch, count, n))


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
