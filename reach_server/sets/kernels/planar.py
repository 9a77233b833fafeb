"""Area, outline and box of one zonotope, compiled; cut once more by strips of the position, exactly in the plane.

Conventions are those of ``strip``: the first ``used`` columns of ``generators`` (z, G) count, nothing is allocated.
"""

import numpy as np

from reach_server.numeric.jit import inline, inline_reduction, leaf_reduction_kernel
from reach_server.numeric.types import BoolArray, FloatArray

#: Sides of an outline are moved outwards by this part of the size of the set, more than float32 can take back.
OUTWARDS = 1e-6
#: Distances over which Shell's method sorts; insertion alone would be slow for many columns.
GAPS = (701, 301, 132, 57, 23, 10, 4, 1)


@inline_reduction
def row_reach(rows: FloatArray, row: int, used: int) -> float:
    """``Σ_i |rows[row, i]|`` over the first ``used`` columns."""
    total = 0.0
    for i in range(used):
        total += abs(rows[row, i])
    return total


@inline_reduction
def pair_area(rows: FloatArray, first: int, second: int, used: int) -> float:
    """Area of the zonotope of two rows: ``4 Σ_{i<j} |det(g_i, g_j)|``, exact up to rounding."""
    total = 0.0
    i = 0
    # Four columns at a time against those after them: each column is read a quarter as often.
    while i + 4 <= used:
        x0, x1, x2, x3 = rows[first, i], rows[first, i + 1], rows[first, i + 2], rows[first, i + 3]
        y0, y1, y2, y3 = rows[second, i], rows[second, i + 1], rows[second, i + 2], rows[second, i + 3]
        total += abs(x0 * y1 - y0 * x1) + abs(x0 * y2 - y0 * x2) + abs(x0 * y3 - y0 * x3)
        total += abs(x1 * y2 - y1 * x2) + abs(x1 * y3 - y1 * x3) + abs(x2 * y3 - y2 * x3)
        for j in range(i + 4, used):
            x, y = rows[first, j], rows[second, j]
            total += abs(x0 * y - y0 * x) + abs(x1 * y - y1 * x) + abs(x2 * y - y2 * x) + abs(x3 * y - y3 * x)
        i += 4
    while i < used:
        for j in range(i + 1, used):
            total += abs(rows[first, i] * rows[second, j] - rows[second, i] * rows[first, j])
        i += 1
    return 4.0 * total


@inline_reduction
def row_shear(rows: FloatArray, first: int, second: int, used: int, x: float, y: float) -> float:
    """``Σ_i |det(g_i, (x, y))|``."""
    total = 0.0
    for i in range(used):
        total += abs(rows[first, i] * y - rows[second, i] * x)
    return total


@inline
def polygon_of(rows: FloatArray, first: int, second: int, used: int, vertices: FloatArray, edges: FloatArray) -> int:
    """The 2 ``used`` vertices of the planar zonotope of two rows around 0, counter-clockwise, into ``vertices`` (one
    more at least); one vertex where there is no column. Parallel columns leave vertices in the middle of an edge, zero
    ones repeat a vertex. ``edges`` (3, at least used)."""
    start_x, start_y = 0.0, 0.0
    for i in range(used):
        a, b = rows[first, i], rows[second, i]
        if b < 0.0 or (b == 0.0 and a < 0.0):
            a, b = -a, -b
        start_x -= a
        start_y -= b
        edges[0, i], edges[1, i] = a, b
        # Grows with the angle from 0 to half a turn.
        edges[2, i] = -a / (abs(a) + b) if abs(a) + b > 0.0 else 2.0
    for gap in GAPS:
        for i in range(gap, used):
            a, b, angle = edges[0, i], edges[1, i], edges[2, i]
            place = i
            while place >= gap and edges[2, place - gap] > angle:
                for k in range(3):
                    edges[k, place] = edges[k, place - gap]
                place -= gap
            edges[0, place], edges[1, place], edges[2, place] = a, b, angle
    vertices[0, 0], vertices[0, 1] = start_x, start_y
    for i in range(used):
        vertices[i + 1, 0] = vertices[i, 0] + 2.0 * edges[0, i]
        vertices[i + 1, 1] = vertices[i, 1] + 2.0 * edges[1, i]
    # A zonotope is symmetric: the way back is the way there, reversed in sign.
    for i in range(1, used):
        vertices[used + i, 0], vertices[used + i, 1] = -vertices[i, 0], -vertices[i, 1]
    return max(2 * used, 1)


@inline
def clip_one(vertices: FloatArray, count: int, x: float, y: float, bound: float, clipped: FloatArray) -> int:
    """Vertices of the convex polygon cut to ``(x, y)·p <= bound`` into ``clipped`` (at least count + 1), their number:
    exact up to rounding. A polygon without a vertex inside comes back whole."""
    kept = 0
    for i in range(count):
        if x * vertices[i, 0] + y * vertices[i, 1] <= bound:
            kept += 1
    if kept in (0, count):
        for i in range(count):
            clipped[i, 0], clipped[i, 1] = vertices[i, 0], vertices[i, 1]
        return count
    found = 0
    before = x * vertices[count - 1, 0] + y * vertices[count - 1, 1] - bound
    for i in range(count):
        j = i - 1 if i > 0 else count - 1
        height = x * vertices[i, 0] + y * vertices[i, 1] - bound
        if (height <= 0.0) != (before <= 0.0):
            share = height / (height - before)
            clipped[found, 0] = vertices[i, 0] + share * (vertices[j, 0] - vertices[i, 0])
            clipped[found, 1] = vertices[i, 1] + share * (vertices[j, 1] - vertices[i, 1])
            found += 1
        if height <= 0.0:
            clipped[found, 0], clipped[found, 1] = vertices[i, 0], vertices[i, 1]
            found += 1
        before = height
    return found


@inline
def area_within(vertices: FloatArray, count: int) -> float:
    """Area of a polygon in counter-clockwise order."""
    total = 0.0
    # Far from the origin the products would round away the area.
    for i in range(1, count - 1):
        a, b = vertices[i, 0] - vertices[0, 0], vertices[i, 1] - vertices[0, 1]
        c, d = vertices[i + 1, 0] - vertices[0, 0], vertices[i + 1, 1] - vertices[0, 1]
        total += a * d - b * c
    return 0.5 * total


@inline
def _clipped_figures(
    vertices: FloatArray, count: int, plane0: int, plane1: int, ways: FloatArray, heights: FloatArray, hull: FloatArray
) -> None:
    """Heights and box are brought down to those of a polygon that holds the position."""
    for k in range(len(ways)):
        most = -np.inf
        for i in range(count):
            most = max(most, ways[k, 0] * vertices[i, 0] + ways[k, 1] * vertices[i, 1])
        heights[k] = min(heights[k], most)
    for axis in range(2):
        place = plane0 if axis == 0 else plane1
        low, high = np.inf, -np.inf
        for i in range(count):
            low, high = min(low, vertices[i, axis]), max(high, vertices[i, axis])
        hull[0, place], hull[1, place] = max(hull[0, place], low), min(hull[1, place], high)


@leaf_reduction_kernel
def figures_one(
    center: FloatArray, generators: FloatArray, used: int, n: int, plane0: int, plane1: int,
    normals: FloatArray, lower: FloatArray, upper: FloatArray, on: BoolArray,
    ways: FloatArray, heights: FloatArray, hull: FloatArray, vertices: FloatArray, work: FloatArray,
) -> float:  # fmt: skip
    """Area, ``heights`` (K,) over the directions ``ways`` (K, 2) and box ``hull`` (2, n) of a zonotope around its
    center, each cut once more by the strips (C, 2) of the position that are ``on`` (C,).

    The area, which is returned, is exact up to rounding: that of the set, where a strip is on of its intersection with
    it. Heights and box are outer bounds, moved outwards by ``OUTWARDS`` of the size of the set. K is even, the second
    half of the directions opposite to the first. ``vertices`` (2, at least 2 G + 2 C + 1, 2), ``work`` (at least 3,
    max(n, G)).
    """
    area = pair_area(generators, plane0, plane1, used)
    half = len(ways) // 2
    for k in range(half):
        heights[k] = row_shear(generators, plane0, plane1, used, -ways[k, 1], ways[k, 0])
        heights[half + k] = heights[k]
    margin = 0.0
    for i in range(n):
        size = row_reach(generators, i, used)
        hull[0, i], hull[1, i] = -size, size
        if i in (plane0, plane1):
            margin += OUTWARDS * size
    clips = False
    for c in range(len(on)):
        clips = clips or on[c]
    if clips:
        count, side = polygon_of(generators, plane0, plane1, used, vertices[0], work), 0
        for c in range(len(on)):
            if on[c]:
                x, y = normals[c, 0], normals[c, 1]
                offset = x * center[plane0] + y * center[plane1]
                if upper[c] < np.inf:
                    count = clip_one(vertices[side], count, x, y, upper[c] - offset, vertices[1 - side])
                    side = 1 - side
                if lower[c] > -np.inf:
                    count = clip_one(vertices[side], count, -x, -y, offset - lower[c], vertices[1 - side])
                    side = 1 - side
        area = min(max(area_within(vertices[side], count), 0.0), area)
        _clipped_figures(vertices[side], count, plane0, plane1, ways, heights, hull)
    for k in range(len(ways)):
        heights[k] += margin
    for i in range(n):
        size = row_reach(generators, i, used)
        hull[0, i] -= OUTWARDS * size
        hull[1, i] += OUTWARDS * size
    return area
