"""Constrained zonotopes with fewer constraints: one row and one factor at a time are eliminated, outer ([SDB+16])."""

from typing import NamedTuple

import numpy as np

from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.sets import polygon as planar
from reach_server.sets import redundancy, support
from reach_server.sets.factor_bounds import rescale
from reach_server.sets.parts import Indices, Parts, common_batch

#: How many times over a factor may leave its bounds when they are given up.
FAR = 1e3
#: Columns whose greatest entry is below this, of rows of size 1, are not eliminated by.
PIVOT = 1e-6
#: What rounding may take from a row or a coordinate, relative to its size. A hundredth of what emptiness is proved by.
RELIABLE = 1e-11
#: Ulps of its terms that an entry loses in one elimination.
ROUNDED = 4
#: Directions in which the areas of candidates are compared.
COMPARED = 16


class State(NamedTuple):
    """Parts of sets, and what rounding may have taken from their rows (..., c) and coordinates (..., n)."""

    center: FloatArray
    generators: FloatArray
    matrix: FloatArray
    offset: FloatArray
    row_lost: FloatArray
    lost: FloatArray


def reduce_constraints(parts: Parts, count: int, candidates: int = 2) -> Parts:
    """Parts of an enclosing set with at most ``count`` rows: outer ([SDB+16], section 4.2, after rescaling).

    One row goes at a time, together with one factor j: the row is solved for it, and its bounds are given up. How far
    it then leaves them, and the Hausdorff distance that the paper estimates from that, rank the factors; the ranking by
    the least bounds (linear programs) and that by interval propagation each propose their first ``candidates``, and the
    smallest result is taken: by its area, bounded in 16 directions, in the plane, else by the widths of its hull.

    What rounding takes from each row and coordinate is bounded on the way. A row that it has taken 1e-11 of is dropped,
    and no factor is solved for whose row would take as much from the set: such a row is dropped instead.
    """
    parts = common_batch(parts)
    if count >= parts[2].shape[-2]:
        return parts
    return _compact(_eliminated(parts, count, candidates)[0], count)


def eliminate_all(parts: Parts) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Center, generators and what rounding may have taken from each coordinate (..., n) of a zonotope around a set with
    all batch axes: the constraints eliminated one by one, outer."""
    (center, generators, _, _), lost = _eliminated(parts, 0, 1)
    return center, redundancy.drop_zero(generators), lost


def _eliminated(parts: Parts, count: int, candidates: int) -> tuple[Parts, FloatArray]:
    """The parts after elimination, with more than ``count`` rows where too few factors could be solved for, and what
    the coordinates may have lost (..., n)."""
    rows = parts[2].shape[-2]
    parts = rescale(parts)
    state = State(*parts, 4 * EPS * row_sizes(parts[2], parts[3]), 4 * EPS * row_sizes(parts[1], parts[0]))
    for _ in range(rows - count if parts[2].shape[-1] else 0):
        state = _without_one(state, count, candidates)
    return state[:4], state.lost


def row_sizes(matrix: FloatArray, offset: FloatArray) -> FloatArray:
    """``Σ|A_ij| + |b_i|`` (..., c): what the rounding of a row is relative to."""
    return np.asarray(np.abs(matrix).sum(axis=-1) + np.abs(offset))


def _without_one(state: State, count: int, candidates: int) -> State:
    _, generators, matrix, offset, row_lost, _ = state
    matrix, offset = support.unit_rows(matrix, offset)
    filled = matrix.any(axis=-1) | (offset != 0)
    usable = (np.abs(matrix).max(axis=-2) > PIVOT) & (filled.sum(axis=-1) > count)[..., None]
    usable &= _harmless(state)
    stiffness = _stiffness(generators, matrix)
    proposed = []
    for reach in (_least_excess(matrix, offset), _propagated_excess(matrix, offset)):
        distance = np.where(usable, np.minimum(reach, FAR) ** 2 / stiffness, np.inf)
        proposed.append(np.argsort(distance, axis=-1, kind="stable")[..., :candidates])
    j = np.concatenate(proposed, axis=-1)
    allowed = np.take_along_axis(usable, j, axis=-1)
    center, generators, matrix, offset, row_lost, lost = state
    choices = _eliminate(
        State(
            center[..., None, :], generators[..., None, :, :], matrix[..., None, :, :], offset[..., None, :],
            row_lost[..., None, :], lost[..., None, :],
        ), j,
    )  # fmt: skip
    size = np.where(allowed, _size(choices[:4]), np.inf)
    best = size.argmin(axis=-1)
    acts = np.take_along_axis(allowed, best[..., None], axis=-1)[..., 0]
    chosen = []
    for old, new in zip(state, choices, strict=True):
        own = old.ndim - acts.ndim
        index = best.reshape(*best.shape, *(1,) * (own + 1))
        picked = np.take_along_axis(new, index, axis=acts.ndim)
        picked = picked.reshape(old.shape)
        chosen.append(np.where(acts.reshape(*acts.shape, *(1,) * own), picked, old))
    return State(*chosen)


def _pivot_rows(matrix: FloatArray, offset: FloatArray) -> Indices:
    """For each column (..., g) the row in which it is largest, rows of size 1."""
    return np.asarray(np.abs(support.unit_rows(matrix, offset)[0]).argmax(axis=-2), dtype=np.intp)


def _harmless(state: State) -> BoolArray:
    """True (..., g) where solving for the factor takes no more than ``RELIABLE`` from any coordinate by rounding."""
    center, generators, matrix, offset, row_lost, lost = state
    i = _pivot_rows(matrix, offset)
    pivot = np.abs(np.take_along_axis(matrix, i[..., None, :], axis=-2)[..., 0, :])
    taken = row_lost + ROUNDED * EPS * row_sizes(matrix, offset)
    share = np.take_along_axis(taken, i, axis=-1) / np.where(pivot > 0, pivot, 1.0)
    allowed = RELIABLE * row_sizes(generators, center)
    return np.asarray((np.abs(generators) * share[..., None, :] + lost[..., None] <= allowed[..., None]).all(axis=-2))


def _eliminate(state: State, j: Indices) -> State:
    """Row i, where column j (..., K) is largest, solved for factor j and put into the rest; row and column are then
    0."""
    center, generators, matrix, offset, row_lost, lost = state
    batch = j.shape
    column = _columns(matrix, j)
    i = np.take_along_axis(np.broadcast_to(_pivot_rows(matrix, offset), (*batch, matrix.shape[-1])), j[..., None], -1)
    pivot = np.take_along_axis(column, i, axis=-1)
    safe = np.where(pivot == 0, 1.0, pivot)
    wide_matrix = np.broadcast_to(matrix, batch + matrix.shape[-2:])
    wide_offset = np.broadcast_to(offset, batch + offset.shape[-1:])
    row = np.take_along_axis(wide_matrix, i[..., None], axis=-2) / safe[..., None]
    right = np.take_along_axis(wide_offset, i, axis=-1) / safe
    generator = _columns(generators, j)
    size = row_sizes(row[..., 0, :], right[..., 0])[..., None]
    taken = np.take_along_axis(np.broadcast_to(row_lost, wide_offset.shape), i, axis=-1) / np.abs(safe)
    taken = taken + ROUNDED * EPS * size
    lost = lost + np.abs(generator) * taken + ROUNDED * EPS * row_sizes(generators, center)
    row_lost = row_lost + np.abs(column) * taken + ROUNDED * EPS * row_sizes(matrix, offset)
    center = center + generator * right
    generators = generators - generator[..., None] * row
    columns, rows = np.arange(matrix.shape[-1]) == j[..., None], np.arange(matrix.shape[-2]) == i
    new_matrix = np.where(columns[..., None, :], 0.0, matrix - column[..., None] * row)
    new_offset = offset - column * right
    # A row that says what row i said: it goes, too, before rounding speaks for it.
    rows = rows | (row_lost > RELIABLE * row_sizes(new_matrix, new_offset))
    return State(
        center,
        np.where(columns[..., None, :], 0.0, generators),
        np.where(rows[..., None], 0.0, new_matrix),
        np.where(rows, 0.0, new_offset),
        np.where(rows, 0.0, row_lost),
        lost,
    )


def _columns(matrix: FloatArray, j: Indices) -> FloatArray:
    """Column j (..., K) of the matrix (..., 1, r, g): (..., K, r)."""
    wide = np.broadcast_to(matrix, j.shape + matrix.shape[-2:])
    return np.asarray(np.take_along_axis(wide, j[..., None, None], axis=-1)[..., 0])


def _least_excess(matrix: FloatArray, offset: FloatArray) -> FloatArray:
    """How far (..., g) beyond [-1, 1] each factor can go if its own bounds alone are given up, at most ``FAR``."""
    g = matrix.shape[-1]
    unit = np.eye(g)
    wide = matrix[..., None, :, :] * (1.0 + (FAR - 1.0) * unit)[:, None, :]
    found = support.solve(np.zeros(1), unit[:, None, :], wide, offset[..., None, :], np.array([[1.0], [-1.0]]))
    return np.asarray(np.maximum(FAR * found.bound.max(axis=-1) - 1.0, 0.0))


def _propagated_excess(matrix: FloatArray, offset: FloatArray) -> FloatArray:
    """The same by interval propagation through the rows, twice ([SDB+16], algorithm 1): larger, infinite at most."""
    rows, g = matrix.shape[-2:]
    shape = (*np.broadcast_shapes(matrix.shape[:-2], offset.shape[:-1]), g)
    low, high = np.full(shape, -1.0), np.full(shape, 1.0)
    reach_low, reach_high = np.full(shape, -np.inf), np.full(shape, np.inf)
    for i in (*range(rows), *range(rows)):
        row, right = matrix[..., i, :], offset[..., i, None]
        ends = np.minimum(row * low, row * high), np.maximum(row * low, row * high)
        least = right - (ends[1].sum(axis=-1, keepdims=True) - ends[1])
        most = right - (ends[0].sum(axis=-1, keepdims=True) - ends[0])
        divisor = np.where(row == 0, 1.0, row)
        bounds = least / divisor, most / divisor
        reach_low = np.where(row == 0, reach_low, np.maximum(reach_low, np.minimum(*bounds)))
        reach_high = np.where(row == 0, reach_high, np.minimum(reach_high, np.maximum(*bounds)))
        low, high = np.maximum(low, reach_low), np.minimum(high, reach_high)
        # Where the set is empty they cross.
        low, high = np.minimum(low, high), np.maximum(low, high)
    return np.asarray(np.maximum(np.maximum(-reach_low, reach_high) - 1.0, 0.0))


def _stiffness(generators: FloatArray, matrix: FloatArray) -> FloatArray:
    """Per factor (..., g): the least ``|WGd|² + |d|²`` with ``Ad = 0``, ``d_j = 1``, inverted ([SDB+16], section 4.2).

    The paper has W = 1. Here W takes each coordinate in thousandths of its width: what happens in space counts, and the
    factors' own share only decides between those that do nothing there.
    """
    g = matrix.shape[-1]
    widths = np.abs(generators).sum(axis=-1, keepdims=True)
    scaled = 1e3 * generators / np.where(widths > 0, widths, 1.0)
    inverse = np.linalg.inv(np.swapaxes(scaled, -1, -2) @ scaled + np.eye(g))
    span = matrix @ inverse
    middle = np.linalg.pinv(span @ np.swapaxes(matrix, -1, -2), hermitian=True)
    projected = inverse - np.swapaxes(span, -1, -2) @ middle @ span
    return np.asarray(np.maximum(np.diagonal(projected, axis1=-2, axis2=-1), 1e-12))


def _size(parts: Parts) -> FloatArray:
    """What candidates (..., K) are compared by: area in the plane, else the product of the widths (logarithms)."""
    _, generators, matrix, offset = parts
    n = generators.shape[-2]
    tiny = np.finfo(np.float64).tiny
    unit = np.eye(n)
    scale = np.abs(generators).sum(axis=(-1, -3), keepdims=True)
    scale = np.where(scale > 0, scale, 1.0)
    directions = planar.directions(COMPARED) if n == 2 else np.concatenate([unit, -unit])
    heights = support.constrained_support(np.zeros(n), generators / scale, matrix, offset, directions)
    if n == 2:
        return np.asarray(np.maximum(planar.polygon_area(planar.outer_polygon(heights)), 0.0))
    return np.asarray(np.log(np.maximum(heights[..., :n] + heights[..., n:], tiny)).sum(axis=-1))


def _compact(parts: Parts, count: int) -> Parts:
    """At most ``count`` rows, zero ones first to go, and no column that is zero throughout."""
    center, generators, matrix, offset = parts
    filled = matrix.any(axis=-1) | (offset != 0)
    order = np.argsort(~filled, axis=-1, kind="stable")[..., :count]
    matrix, offset = np.take_along_axis(matrix, order[..., None], axis=-2), np.take_along_axis(offset, order, axis=-1)
    generators, matrix = redundancy.without_zero_columns(generators, matrix)
    return center, generators, matrix, offset
