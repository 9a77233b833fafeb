"""Planar outlines of constrained zonotopes, exact up to 1e-9 of their size and certified edge by edge.

The outline is refined from four directions: between two neighbouring vertices the linear program in the direction
normal to their chord either proves the chord to be an edge or finds a vertex beyond it (the outer-inner approximation
of [Kam92], carried on to its end). Each program starts from the basis of the last, which is optimal nearby, so it takes
a few iterations; unlike the walk of the shadow-vertex method ([Bor87], the same vertices in the same order) no step
depends on the one before being right, and degenerate vertices cost nothing.

Each edge ends with a dual certificate ``n·x <= h`` and two attained points. The polygon published has these edges moved
outwards by the largest difference between ``h`` and the attained value, found afterwards.
"""

import math
from dataclasses import dataclass

import numpy as np

from reach_server.numeric.jit import NO, YES, kernel, stacked
from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import BoolArray, FloatArray, IntArray
from reach_server.sets import polygon as planar
from reach_server.sets import support
from reach_server.sets.kernels.certificates import dependent_rows_fail
from reach_server.sets.kernels.simplex import EMPTY, maximise
from reach_server.sets.kernels.tableau import factorise, load
from reach_server.sets.parts import Parts, batch_of

#: An outline is exact if no edge lies farther out than this, relative to the greatest extent of the set.
EXACT = 1e-9
#: What is allowed beside, relative to the numbers that the set is made of: what the linear programs are accurate to.
ROUNDING = 1e-12
#: A vertex must lie this far beyond a chord to count, relative to the same.
BEYOND = 1e-13
#: The edges of an outline turn by 2π in all, up to this.
ONCE = 1e-3
#: Certified directions of the polygon published where an outline fails.
FALLBACK = 64
MOST_VERTICES = 1 << 14


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """``outer`` (..., V, 2) vertices of a polygon around each set, ``inner`` (..., V, 2) points of the set at its
    corners, both counter-clockwise, the last one repeated where a set has fewer than V; NaN where it is ``empty``
    (...).

    ``normals`` (..., V, 2) and ``heights`` (..., V): the certified half-planes ``n·x <= h`` of the edges.
    ``exact`` (...): outer and inner edges are at most 1e-9 of the set's extent apart (and 1e-12 of the zonotope's).
    """

    outer: FloatArray
    inner: FloatArray
    normals: FloatArray
    heights: FloatArray
    exact: BoolArray
    empty: BoolArray


@kernel
def trace(
    center: FloatArray,
    generators: FloatArray,
    matrix: FloatArray,
    offset: FloatArray,
    count: int,
    room: int,
    limit: int,
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, FloatArray]:
    """Outer and inner vertices (P, room, 2), half-planes (P, room, 3), their number (P) (-1: empty, -2: no room) and
    (P, 3): how far the edges were moved, the extent of the set and that of the zonotope. Batches as in
    ``simplex.supports``."""
    m, g = matrix.shape[1:]
    outer, inner, planes = np.zeros((count, room, 2)), np.zeros((count, room, 2)), np.zeros((count, room, 3))
    numbers, sizes = np.zeros(count, dtype=np.int64), np.zeros((count, 3))
    rows, scale, tableau = np.zeros((m, g + 1)), np.ones(m), np.zeros((m, g + m + 1))
    basis, basic, queue = np.zeros(m, dtype=np.int64), np.zeros(g, dtype=np.int64), np.zeros(g, dtype=np.int64)
    x, d, kinks, point, cost, trial = np.ones(g), np.zeros(g), np.zeros(g), np.zeros(g), np.zeros(g), np.zeros(g)
    values, y, best, ray = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m)
    # Per half-plane: normal, height, end points of the edge, and whether it is one of the first four directions.
    normals, heights = np.zeros((room, 2)), np.zeros(room)
    left, right, first = np.zeros((room, 2)), np.zeros((room, 2)), np.zeros(room, dtype=np.int64)
    pending, kept = np.zeros((room, 2)), np.zeros(room, dtype=np.int64)
    corner, top = np.zeros((5, 2)), np.zeros(5)
    for p in range(count):
        G = generators[p if generators.shape[0] > 1 else 0]
        load(
            matrix[p if matrix.shape[0] > 1 else 0], offset[p if offset.shape[0] > 1 else 0], rows, scale, tableau
        )  # fmt: skip
        rank = factorise(rows, tableau, basis, basic, NO)
        if dependent_rows_fail(rows, tableau, rank, ray):
            numbers[p] = -1
            continue
        c = center[p if center.shape[0] > 1 else 0]
        reach = 0.0
        for j in range(g):
            reach += abs(G[0, j]) + abs(G[1, j])
        found, programs, state = 0, 0, 0
        # Targets: the four axis directions, then chords until none is pending.
        quadrant, waiting = 0, 0
        extent, threshold = 0.0, 0.0
        here_x, here_y = 0.0, 0.0
        ex, ey, stretched = 0.0, 0.0, False
        while True:
            if quadrant < 4:
                nx, ny = (1.0, 0.0, -1.0, 0.0)[quadrant], (0.0, 1.0, 0.0, -1.0)[quadrant]
            else:
                if waiting == 0:
                    quadrant += 1
                    if quadrant > 8:
                        break
                    # Start of the quadrant between two of the first vertices.
                    k = quadrant - 5
                    here_x, here_y = corner[k, 0], corner[k, 1]
                    if found >= room:
                        state = -2
                        break
                    normals[found, 0], normals[found, 1] = (1.0, 0.0, -1.0, 0.0)[k], (0.0, 1.0, 0.0, -1.0)[k]
                    heights[found], first[found] = top[k], 1
                    left[found] = corner[k]
                    right[found] = corner[k]
                    found += 1
                    pending[0] = corner[k + 1]
                    waiting = 1
                if not stretched:
                    ex, ey = pending[waiting - 1, 0] - here_x, pending[waiting - 1, 1] - here_y
                length = math.sqrt(ex * ex + ey * ey)
                if length <= threshold:
                    here_x, here_y = pending[waiting - 1, 0], pending[waiting - 1, 1]
                    waiting -= 1
                    continue
                nx, ny = ey / length, -ex / length
            for j in range(g):
                cost[j] = nx * G[0, j] + ny * G[1, j]
            programs += 1
            if programs % 32 == 0:
                rank = factorise(rows, tableau, basis, basic, YES)
            status, height, rank = maximise(
                rows, tableau, rank, basis, basic, cost, limit,
                x, d, values, y, best, ray, point, kinks, queue, trial,
            )  # fmt: skip
            if status == EMPTY:
                state = -1
                break
            height += 6.0 * EPS * reach
            vx, vy = 0.0, 0.0
            for j in range(g):
                vx += G[0, j] * point[j]
                vy += G[1, j] * point[j]
            if quadrant < 4:
                corner[quadrant, 0], corner[quadrant, 1], top[quadrant] = vx, vy, height
                quadrant += 1
                if quadrant == 4:
                    corner[4] = corner[0]
                    extent = max(top[0] + top[2], top[1] + top[3])
                    threshold = BEYOND * extent + 8.0 * EPS * reach
                continue
            if found >= room or waiting >= room:
                state = -2
                break
            if nx * (vx - here_x) + ny * (vy - here_y) > threshold and not stretched:
                # A vertex beyond a chord is between its ends, as a quadrant turns by a right angle in all.
                # Where it is not, the chord is so short that its normal is mostly rounding, and its edge goes on to
                # that vertex: going there, the outline would come back by another turn around the set. The edge takes
                # the normal of the longer chord instead.
                along = ny * (here_x - vx) + nx * (vy - here_y)
                stretched = along < -threshold or along > length + threshold
                if along > length + threshold:
                    ex, ey = vx - here_x, vy - here_y
                elif stretched:
                    ex, ey = pending[waiting - 1, 0] - vx, pending[waiting - 1, 1] - vy
                else:
                    pending[waiting, 0], pending[waiting, 1] = vx, vy
                    waiting += 1
                continue
            stretched = False
            normals[found, 0], normals[found, 1] = nx, ny
            heights[found], first[found] = height, 0
            left[found, 0], left[found, 1] = here_x, here_y
            right[found] = pending[waiting - 1]
            here_x, here_y = right[found, 0], right[found, 1]
            found += 1
            waiting -= 1
        if state < 0:
            numbers[p] = state
            continue
        # A first direction stays where its neighbours turn so far that their corner would stick out.
        number = 0
        for k in range(found):
            before = kept[number - 1] if number > 0 else found - 1
            after = (k + 1) % found
            turn = normals[before, 0] * normals[after, 0] + normals[before, 1] * normals[after, 1]
            if first[k] == 0 or turn < 0.2:
                kept[number] = k
                number += 1
        moved = 0.0
        for k in range(number):
            i, after = kept[k], kept[(k + 1) % number]
            moved = max(moved, heights[i] - normals[i, 0] * left[i, 0] - normals[i, 1] * left[i, 1])
            moved = max(moved, heights[i] - normals[i, 0] * right[i, 0] - normals[i, 1] * right[i, 1])
            moved = max(moved, heights[after] - normals[after, 0] * right[i, 0] - normals[after, 1] * right[i, 1])
        moved += 4.0 * EPS * (reach + abs(c[0]) + abs(c[1]))
        around = 0.0
        for k in range(number):
            i, after = kept[k], kept[(k + 1) % number]
            turn = normals[i, 0] * normals[after, 0] + normals[i, 1] * normals[after, 1]
            angle = math.atan2(normals[i, 0] * normals[after, 1] - normals[i, 1] * normals[after, 0], turn)
            # Half a turn, at the end of a segment, has either sign.
            around += angle + 2.0 * math.pi if angle < -3.0 else angle
            # Less than half a turn between neighbours; were it more, the corner would be far out, and not exact.
            share = moved / max(1.0 + turn, 1e-6)
            planes[p, k, 2] = heights[i] + 4.0 * EPS * (reach + abs(c[0]) + abs(c[1]))
            for axis in range(2):
                planes[p, k, axis] = normals[i, axis]
                planes[p, k, 2] += normals[i, axis] * c[axis]
                inner[p, k, axis] = c[axis] + right[i, axis]
                outer[p, k, axis] = c[axis] + right[i, axis] + share * (normals[i, axis] + normals[after, axis])
        for k in range(number, room):
            inner[p, k] = inner[p, number - 1]
            outer[p, k] = outer[p, number - 1]
            planes[p, k] = planes[p, number - 1]
        # What does not go round the set just once is no outline of it.
        if extent > threshold and abs(around - 2.0 * math.pi) > ONCE:
            moved = np.inf
        numbers[p] = number
        sizes[p, 0], sizes[p, 1], sizes[p, 2] = moved, extent, reach
    return outer, inner, planes, numbers, sizes


def outline(center: FloatArray, generators: FloatArray, matrix: FloatArray, offset: FloatArray) -> Outline:
    """Outlines of planar constrained zonotopes; where one is not found exactly, ``outer`` is the polygon of
    ``FALLBACK`` certified directions (still an outer bound, tagged by ``exact``)."""
    batch = np.broadcast_shapes(center.shape[:-1], generators.shape[:-2], matrix.shape[:-2], offset.shape[:-1])
    size = math.prod(batch)
    flat = (
        stacked(center, 1, batch, size),
        stacked(generators, 2, batch, size),
        stacked(matrix, 2, batch, size),
        stacked(offset, 1, batch, size),
    )
    room = 4 * sum(matrix.shape[-2:]) + 32
    outer, inner, planes, numbers, sizes = trace(*flat, size, room, support.ITERATIONS)
    while (numbers == -2).any() and room < MOST_VERTICES:
        room *= 4
        outer, inner, planes, numbers, sizes = trace(*flat, size, room, support.ITERATIONS)
    empty = numbers == -1
    allowed = EXACT * sizes[:, 1] + ROUNDING * (sizes[:, 2] + np.abs(flat[0]).sum(axis=-1))
    exact = empty | ((numbers > 0) & (sizes[:, 0] <= allowed))
    width = max(int(numbers.max(initial=1)), 1)
    if not exact.all():
        width = max(width, FALLBACK)
        rows = np.flatnonzero(~exact)
        c, G, A, b = (a if len(a) < size else a[rows] for a in flat)
        found = support.solve(c, G, A, b, planar.directions(FALLBACK))
        outer, inner, planes = (_widened(a, width) for a in (outer, inner, planes))
        outer[rows] = _widened(planar.outer_polygon(found.bound), outer.shape[1])
        attained = c[:, None] + found.factors @ np.swapaxes(G, -1, -2)
        inner[rows] = _widened(attained, inner.shape[1])
        around = np.broadcast_to(planar.directions(FALLBACK), (len(rows), FALLBACK, 2))
        planes[rows] = _widened(np.concatenate([around, found.bound[..., None]], axis=-1), planes.shape[1])
        empty = empty.copy()
        empty[rows] = found.empty[:, 0]
    outer, inner, planes = outer[:, :width], inner[:, :width], planes[:, :width]
    outer[empty], inner[empty], planes[empty] = np.nan, np.nan, np.nan
    return Outline(
        outer.reshape(*batch, width, 2),
        inner.reshape(*batch, width, 2),
        planes[..., :2].reshape(*batch, width, 2),
        planes[..., 2].reshape(*batch, width),
        exact.reshape(batch),
        empty.reshape(batch),
    )


def _widened(vertices: FloatArray, width: int) -> FloatArray:
    missing = max(width - vertices.shape[1], 0)
    return np.concatenate([vertices, np.repeat(vertices[:, -1:], missing, axis=1)], axis=1)


def polygon_around(parts: Parts, count: int) -> FloatArray:
    """``count`` vertices (..., count, 2) of polygons around planar sets, certified in as many directions: outer; NaN
    where a set is certainly empty."""
    center, generators, matrix, offset = parts
    # About the center: far from the origin, products with the directions would round away the shape.
    found = support.solve(np.zeros(2), generators, matrix, offset, planar.directions(count))
    heights = found.bound + 4 * EPS * np.abs(center).sum(axis=-1)[..., None]
    vertices = center[..., None, :] + planar.outer_polygon(heights)
    return np.where(found.empty[..., None], np.nan, vertices)


def area_bracket(parts: Parts) -> tuple[FloatArray, FloatArray]:
    """(inner, outer) bounds (...) of the area of planar sets: of the hull of attained points, less what these may lie
    outside, and of the outer polygon."""
    _, generators, matrix, offset = parts
    # About the origin: far from it, rounding of the vertices would show.
    found = outline(np.zeros(2), generators, matrix, offset)
    inner, outer = (planar.polygon_area(np.nan_to_num(v)) for v in (found.inner, found.outer))
    # Attained points are members up to what the linear programs are accurate to: a strip along the outline.
    lost = ROUNDING * np.abs(generators).sum(axis=(-2, -1))
    edges = np.nan_to_num(np.roll(found.inner, -1, axis=-2) - found.inner)
    inner = inner * (1 - 1e-12) - lost * (np.sqrt((edges**2).sum(axis=-1)).sum(axis=-1) + 4 * lost)
    inner, outer = np.maximum(np.minimum(inner, outer), 0.0), np.maximum(outer, 0.0)
    batch = batch_of(parts)
    return np.broadcast_to(inner, batch), np.broadcast_to(outer * (1 + 4 * EPS), batch)
