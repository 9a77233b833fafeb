"""Volumes of constrained zonotopes between two bounds, and containment of one in another."""

from typing import Any

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import block_array, csr_array, eye_array, kron
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.sets import support
from reach_server.sets.constraint_reduction import Parts
from reach_server.sets.kernels import membership

#: The bracket of a volume is refined until it is this narrow, or after this many rounds.
NARROW, ROUNDS = 1e-3, 4
#: Dimensions up to which hulls of points are computed; beyond, the bracket is (0, volume of the interval hull).
HULLS = 5
#: By how much, relative to its size, a set may stick out of another and still count as contained.
SLACK = 1e-7


def volume_bracket(parts: Parts) -> tuple[float, float]:
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


def polygon_contains(normals: FloatArray, heights: FloatArray, size: FloatArray, vertices: FloatArray) -> BoolArray:
    """True (...) where all ``vertices`` (..., V, 2) keep ``normals`` (..., K, 2) below ``heights`` (..., K), up to 1e-7
    of ``size`` (...)."""
    reach = (vertices @ np.swapaxes(normals, -1, -2)).max(axis=-2)
    return np.asarray((reach <= heights + SLACK * size[..., None]).all(axis=-1))


def contains(outer: Parts, inner: Parts) -> bool:
    """True where the set ``inner`` certainly lies in ``outer``, up to 1e-7 of its size; False: not shown.

    Sufficient: an affine map of the inner set's factors, ``β = γ + Γξ``, that meets ``c + Gβ = c' + G'ξ`` and ``Aβ =
    b`` wherever ``A'ξ = b'`` (so up to multiples of those rows), with ``|γ| + |Γ| 1 <= 1``. For zonotopes this is
    [ST19], theorem 3; one linear program.
    """
    center, generators, matrix, offset = outer
    inner_center, inner_generators, inner_matrix, inner_offset = inner
    if not inner_generators.any():
        # A point, if it is anything.
        return bool(membership.reach(*outer, inner_center)[0])
    size = np.abs(generators).sum(axis=1)
    rounding = 4 * EPS * (np.abs(center) + np.abs(inner_center))
    # Far away, the centers are rounded by more than the solver's accuracy: the set is enlarged by a box of that.
    blur = (np.where(rounding > SLACK * size, rounding, 0.0) * np.eye(len(center)))[:, rounding > SLACK * size]
    generators = np.concatenate([generators, blur], axis=1)
    matrix = np.concatenate([matrix, np.zeros((len(matrix), blur.shape[1]))], axis=1)
    g, k = generators.shape[1], inner_generators.shape[1]
    stacked = np.concatenate([generators, matrix])
    columns = np.concatenate([inner_generators, np.zeros((len(matrix), k))])
    shift = np.concatenate([inner_center - center, offset])
    size = np.abs(stacked).sum(axis=1)
    # Where the outer set has no size, what the other one has there is all that counts.
    size = np.where(size > 0, size, np.abs(columns).sum(axis=1) + np.abs(shift))
    size = np.where(size > 0, size, 1.0)
    stacked, columns, shift = stacked / size[:, None], columns / size[:, None], shift / size
    inner_matrix, inner_offset = support.unit_rows(inner_matrix, inner_offset)
    rows, inner_rows = len(stacked), len(inner_matrix)
    if not g:
        return False
    # Unknowns: Γ and γ as differences of nonnegative ones (column by column), multiples of the inner rows, the row sum.
    table = np.column_stack([inner_matrix, -inner_offset[:, None]])
    maps = kron(csr_array(stacked), eye_array(k + 1))
    equations: list[Any] = [maps, -maps]
    if inner_rows:
        equations.append(-kron(eye_array(rows), csr_array(table.T)))
    sums = kron(eye_array(g), csr_array(np.ones((1, k + 1))))
    inequalities: list[Any] = [sums, sums]
    if inner_rows:
        inequalities.append(csr_array((g, rows * inner_rows)))
    wide = 2 * g * (k + 1)
    upper: Any = block_array([[*inequalities, csr_array(-np.ones((g, 1)))]])
    equal: Any = block_array([[*equations, csr_array((rows * (k + 1), 1))]])
    bounds: list[tuple[float | None, float | None]] = [(0, None)] * wide
    bounds += [*[(None, None)] * (rows * inner_rows), (0, None)]
    solution = linprog(
        np.append(np.zeros(wide + rows * inner_rows), 1.0),
        A_ub=upper,
        b_ub=np.zeros(g),
        A_eq=equal,
        b_eq=np.column_stack([columns, shift]).ravel(),
        bounds=bounds,
        method="highs",
    )
    return bool(solution.status == 0 and solution.fun is not None and solution.fun <= 1 + SLACK)
