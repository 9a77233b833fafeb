"""Cuts of one zonotope, compiled: what all batches and recursions over single sets call.

A set is ``center`` (z,) and ``generators`` (z, G), of which the first ``used`` columns count; the room beyond takes the
columns that cuts add. Its first n coordinates are those that strips speak about, so that states and what is lifted
beside them (lagged inputs) are cut together. Nothing here allocates: ``work`` (``WORK``, at least max(z, G)) holds what
is needed on the way. Every kernel treats one set alone, so that equal sets have equal results whatever is beside them.

Cuts. For every λ the zonotope ``<c + λ(q - Hc), [(I - λH)G, λr]>`` contains the intersection with ``|Hx - q| <= r``
[ABC05]. For ``λ = g_j / (H g_j)`` [ABC06] column j becomes zero, and the new one takes its place. With
``d_i = det(g_i, λ)`` in the plane, and H zero outside of it, the area after the cut is

    |1 - Hλ| A + 4 r Σ|d_i| ,       A = 4 Σ_{i<j} |det(g_i, g_j)| before it,

as ``det((I - λH) g_i, (I - λH) g_j) = det(I - λH) det(g_i, g_j)`` and ``det(g_i - λ H g_i, λ) = d_i``; so that a
candidate costs one pass over the columns.
"""

from typing import cast

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.jit import inline, inline_reduction, leaf_reduction_kernel
from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.sets.kernels.planar import pair_area, row_reach, row_shear

Flags = NDArray[np.uint8]

#: What a strip did: it cut the set, or it certainly has no point in common with it.
ACTED, MISSED = 1, 2
#: A strip is taken to miss the set only if it does so by more than this, relative to the numbers compared.
EMPTY_MARGIN = 1e-9
#: Columns, those that matter most to H, whose λ are tried.
CANDIDATES = 4
#: In a second pass a strip cuts only where it takes away more than this part of the width of the set.
WORTH = 1e-3
#: A column whose height is less than this part of all heights is not divided by.
LEAST_HEIGHT = 1e-12
#: Nor one whose height is below this, where quotients overflow or lose digits.
LEAST_DIVISOR = 1e-290
#: What is smaller by no more than this is not: rounding.
GAIN = 1e-12
#: A set whose area is less than this part of its box's has none but by rounding.
FLAT = 1e-12
TINY = float(np.finfo(np.float64).tiny)
#: Rows of ``work``: heights, marks, λ tried and taken, a moved plane.
WORK = 6
_HEIGHTS, _MARKS, _TRIED, _TAKEN, _FIRST, _SECOND = (cast(int, row) for row in np.arange(WORK))


@inline_reduction
def _moved_reach(rows: FloatArray, row: int, used: int, heights: FloatArray, factor: float) -> float:
    """``Σ_i |rows[row, i] - factor heights[_HEIGHTS, i]|``."""
    total = 0.0
    for i in range(used):
        total += abs(rows[row, i] - factor * heights[_HEIGHTS, i])
    return total


@inline_reduction
def _dot(rows: FloatArray, row: int, used: int, heights: FloatArray) -> float:
    total = 0.0
    for i in range(used):
        total += rows[row, i] * heights[_HEIGHTS, i]
    return total


@inline_reduction
def _squares(rows: FloatArray, row: int, used: int) -> float:
    total = 0.0
    for i in range(used):
        total += rows[row, i] * rows[row, i]
    return total


@inline
def tightened(
    center: FloatArray,
    generators: FloatArray,
    used: int,
    normals: FloatArray,
    c: int,
    lower: float,
    upper: float,
    work: FloatArray,
) -> tuple[float, float, float, bool, bool]:
    """The strip ``lower <= normals[c]·x <= upper`` tightened to the set: (middle, radius, reach, cuts, empty).

    ``reach`` is ``|normal·G|₁``, the radius of a strip around the set. ``cuts`` is False where the strip holds on the
    whole set; ``empty`` is certain: the two are disjoint by more than the rounding of the comparison. Normals speak
    about the first coordinates. The heights ``normal·G`` stay in ``work``. The radius includes what all sums over the
    set, here and of whoever cuts with it, may lose by rounding: a set of one point keeps it.
    """
    for i in range(used):
        work[_HEIGHTS, i] = 0.0
    middle, size = 0.0, 0.0
    for k in range(normals.shape[1]):
        weight = normals[c, k]
        if weight != 0.0:
            middle += weight * center[k]
            for i in range(used):
                work[_HEIGHTS, i] += weight * generators[k, i]
            size += abs(weight) * (abs(center[k]) + row_reach(generators, k, used))
    reach = row_reach(work, _HEIGHTS, used)
    low, high = middle - reach, middle + reach
    # Comparisons with NaN are false: of a set that is not finite nothing is certain.
    from_below, from_above = lower > low, upper < high
    if from_below:
        low = lower
    if from_above:
        high = upper
    # What the sums may have lost does not shrink with them: of 1e12 - 1e12 nothing is left but the rounding.
    margin = EMPTY_MARGIN * (abs(middle) + reach + (abs(low) if abs(low) < np.inf else 0.0))
    lost = (2 * len(center) + used + 8) * EPS * size
    margin += lost
    empty = low > high + margin
    if low > high:
        # Within the margin the two may cross by rounding: the hull of both only enlarges.
        low, high = high, low
    return (low + high) / 2, (high - low) / 2 + lost, reach, (from_below or from_above) and not empty, empty


@inline
def _ratio(
    generators: FloatArray,
    used: int,
    work: FloatArray,
    radius: float,
    plane0: int,
    plane1: int,
    area: float,
    inline: bool,
    slope: float,
    best: float,
) -> tuple[float, float]:
    """Size of the set cut with the λ that is tried, relative to its size before, and its area in the plane; less than
    these where they are not below ``best`` anyway.

    ``inner``: H is zero outside of the plane; ``slope`` is Hλ. Where plane0 < 0 sizes are products of widths.
    """
    ratio, after = 1.0, area
    for k in range(len(generators)):
        factor = work[_TRIED, k]
        if factor != 0.0 and k not in (plane0, plane1):
            width = _moved_reach(generators, k, used, work, factor) + abs(factor) * radius
            ratio *= max(width, TINY) / max(row_reach(generators, k, used), TINY)
    if plane0 >= 0:
        x, y = work[_TRIED, plane0], work[_TRIED, plane1]
        after = 4.0 * radius * row_shear(generators, plane0, plane1, used, x, y)
        if inline:
            after += abs(1.0 - slope) * area
        elif ratio * max(after, TINY) < best * max(area, TINY):
            # What is known so far does not decide yet.
            for i in range(used):
                work[_FIRST, i] = generators[plane0, i] - x * work[_HEIGHTS, i]
                work[_SECOND, i] = generators[plane1, i] - y * work[_HEIGHTS, i]
            after += pair_area(work, _FIRST, _SECOND, used)
        ratio *= max(after, TINY) / max(area, TINY)
    return ratio, after


@inline
def _try_frobenius(generators: FloatArray, used: int, work: FloatArray, radius: float) -> None:
    """λ of least Frobenius norm, ``GGᵀHᵀ / (HGGᵀHᵀ + r²)``; 0 in a coordinate where that is no number."""
    denominator = _squares(work, _HEIGHTS, used) + radius * radius
    for k in range(len(generators)):
        value = _dot(generators, k, used, work) / denominator
        work[_TRIED, k] = value if abs(value) < np.inf else 0.0


@inline
def _best(
    generators: FloatArray, used: int, normals: FloatArray, c: int, work: FloatArray, radius: float, reach: float,
    plane0: int, plane1: int, area: float,
) -> tuple[int, float]:  # fmt: skip
    """The best λ goes to ``work``: the column it belongs to (-1: none, Frobenius; -2: leave the set as it is) and the
    area after the cut."""
    dimension = len(generators)
    inline = plane0 >= 0
    for k in range(normals.shape[1]):
        inline = inline and (normals[c, k] == 0.0 or k in (plane0, plane1))
    if not area > 0.0:
        plane0, plane1 = -1, -1
    tried = 0
    for i in range(used):
        work[_MARKS, i] = abs(work[_HEIGHTS, i])
    least = max(LEAST_HEIGHT * reach, LEAST_DIVISOR)
    chosen, best, area_after = -2, 1.0 - GAIN, area
    # Those that make a column zero come first: they need no column more, and no room for one.
    searching = True
    while searching:
        column, height = -1, least
        for i in range(used):
            if work[_MARKS, i] > height:
                column, height = i, work[_MARKS, i]
        if column >= 0 and tried < CANDIDATES:
            work[_MARKS, column] = -1.0
            tried += 1
            share = 1.0 / work[_HEIGHTS, column]
            for k in range(dimension):
                work[_TRIED, k] = generators[k, column] * share
        else:
            searching, column = False, -1
            if used == generators.shape[1]:
                break
            _try_frobenius(generators, used, work, radius)
        slope = 0.0
        for k in range(normals.shape[1]):
            slope += normals[c, k] * work[_TRIED, k]
        ratio, after = _ratio(generators, used, work, radius, plane0, plane1, area, inline, slope, best)
        if ratio < best:
            chosen, best, area_after = column, ratio * (1.0 - GAIN), after
            for k in range(dimension):
                work[_TAKEN, k] = work[_TRIED, k]
    return chosen, area_after


@inline
def _apply(
    center: FloatArray, generators: FloatArray, used: int, work: FloatArray, shift: float, radius: float, column: int
) -> int:
    """The cut with the λ taken; columns used after it. ``column``: the one that it makes zero, -1 where none."""
    place = column if column >= 0 else used
    for k in range(len(generators)):
        factor = work[_TAKEN, k]
        if factor != 0.0:
            center[k] += factor * shift
            for i in range(used):
                generators[k, i] -= factor * work[_HEIGHTS, i]
        generators[k, place] = factor * radius
    return max(used, place + 1)


@inline
def cut_one(
    center: FloatArray, generators: FloatArray, used: int, normals: FloatArray, c: int, lower: float, upper: float,
    plane0: int, plane1: int, frobenius: bool, least: float, area: float, work: FloatArray,
) -> tuple[int, int, float]:  # fmt: skip
    """One strip: (columns used after it, flags, area in the plane after it); an outer bound, see ``narrow_one``.

    It does not act where it takes no more than the part ``least`` of the width away. ``area``: that of the set in the
    plane, 0 where that is flat, negative where it is not known yet.
    """
    middle, radius, reach, cuts, empty = tightened(center, generators, used, normals, c, lower, upper, work)
    if empty:
        return used, MISSED, area
    cuts = cuts and not radius >= (1.0 - least) * reach
    given = frobenius and abs(lower) < np.inf and abs(upper) < np.inf
    if not cuts and not given:
        return used, 0, area
    if frobenius and used == generators.shape[1]:
        return used, 0, area
    shift = 0.0
    for k in range(normals.shape[1]):
        if normals[c, k] != 0.0:
            shift -= normals[c, k] * center[k]
    if frobenius:
        if given:
            middle, radius = (lower + upper) / 2, (upper - lower) / 2
        _try_frobenius(generators, used, work, radius)
        for k in range(len(generators)):
            work[_TAKEN, k] = work[_TRIED, k]
        column = -1
    else:
        if area < 0.0 and plane0 >= 0:
            area = pair_area(generators, plane0, plane1, used)
            box = row_reach(generators, plane0, used) * row_reach(generators, plane1, used)
            area = area if area > FLAT * box else 0.0
        column, after = _best(generators, used, normals, c, work, radius, reach, plane0, plane1, area)
        if column == -2:
            return used, ACTED if cuts else 0, area
        area = after
    used = _apply(center, generators, used, work, middle + shift, radius, column)
    return used, ACTED if cuts else 0, area


@leaf_reduction_kernel
def narrow_one(
    center: FloatArray,
    generators: FloatArray,
    used: int,
    normals: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    active: BoolArray,
    plane0: int,
    plane1: int,
    frobenius: bool,
    acted: Flags,
    work: FloatArray,
) -> tuple[int, bool]:
    """A zonotope around the set cut by its ``active`` strips ``lower <= normals x <= upper``: (columns used, empty).

    In place, an outer bound. normals (C, n) with n <= z, lower and upper (C,), infinite where a side does not bind.
    ``acted`` (C,) gets the flags ``ACTED`` and ``MISSED``; ``empty`` where a strip is certainly disjoint from what the
    others left. A strip that misses the set leaves it as it is. Generators need room for 2 C columns more; where there
    is none a cut that needs it is left out.

    Otherwise the paper's Algorithm 2 (``frobenius``; once, strips as given, the result may be larger), or tightened
    strips with the best of the λ of least Frobenius norm, those of the strongest columns, and none: never larger than
    the set, measured by the area in the plane times the widths of the other coordinates (plane0 = -1, or a set that is
    flat in the plane: by all widths). Cuts do not commute: where several act there is a second pass, in which the first
    ones profit from the later ones.
    """
    several, area = 0, -1.0
    empty = False
    for c in range(len(acted)):
        acted[c] = 0
    for repeated in range(1 if frobenius else 2):
        if repeated == 1 and several < 2:
            break
        for c in range(len(active)):
            if active[c] and acted[c] & MISSED == 0:
                used, flags, area = cut_one(
                    center, generators, used, normals, c, lower[c], upper[c], plane0, plane1, frobenius,
                    WORTH if repeated else 0.0, area, work,
                )  # fmt: skip
                if repeated == 0 and flags & ACTED != 0:
                    several += 1
                acted[c] |= flags
                empty = empty or flags & MISSED != 0
    return used, empty
