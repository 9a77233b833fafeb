"""Is a point in the set? Cheap answers for a whole batch first, linear programs for what is left."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from reach_server.numeric.jit import kernel, stacked
from reach_server.numeric.types import BoolArray, FloatArray

#: Relative accuracy of the cheap answers (the linear programs have 1e-7).
SLACK = 1e-9
#: Rounding errors that a point and the set may have come with, relative to their distance from the origin.
ULPS = 8 * float(np.finfo(np.float64).eps)
#: What separates a point from a set must exceed the height of the set by this share.
CLEAR = 1e-7
#: Weighted least squares tried for a point before a linear program is asked.
ROUNDS = 40
TINY = float(np.finfo(np.float64).tiny)

_OUTSIDE, _INSIDE, _UNDECIDED = 0, 1, 2


def contains(
    center: FloatArray, generators: FloatArray, matrix: FloatArray, offset: FloatArray, point: FloatArray
) -> BoolArray:
    """True (...) where ``point`` (..., n) is ``c + Gβ`` with ``Aβ = b`` and ``|β| <= 1``, up to 1e-7."""
    batch = np.broadcast_shapes(
        center.shape[:-1], generators.shape[:-2], matrix.shape[:-2], offset.shape[:-1], point.shape[:-1]
    )
    count = math.prod(batch)
    found = np.empty(count, dtype=np.int8)
    parts = zip((center, generators, matrix, offset, point), (1, 2, 2, 1, 1), strict=True)
    c, G, A, b, p = (stacked(array, own, batch, count) for array, own in parts)
    _judge(c, G, A, b, p, found)
    for k in np.flatnonzero(found == _UNDECIDED).tolist():
        rows = (array[k if len(array) > 1 else 0] for array in (c, G, A, b, p))
        found[k] = reach(*rows)[0]
    return np.asarray(found.reshape(batch) == _INSIDE)


@kernel
def _judge(
    center: FloatArray,
    generators: FloatArray,
    matrix: FloatArray,
    offset: FloatArray,
    point: FloatArray,
    found: NDArray[np.int8],
) -> None:
    """Judge points one by one; arrays with one row speak about all of them."""
    n, g = generators.shape[1:]
    rows = n + matrix.shape[1]
    equations, target, error = np.empty((rows, g)), np.empty(rows), np.empty(rows)
    for k in range(len(found)):
        c, G = center[k % len(center)], generators[k % len(generators)]
        A, b, p = matrix[k % len(matrix)], offset[k % len(offset)], point[k % len(point)]
        used, outside = 0, False
        for i in range(rows):
            size = 0.0
            for j in range(g):
                entry = G[i, j] if i < n else A[i - n, j]
                equations[used, j] = entry
                size += abs(entry)
            target[used] = p[i] - c[i] if i < n else b[i - n]
            error[used] = ULPS * (abs(p[i]) + abs(c[i]) if i < n else abs(b[i - n]))
            if not abs(target[used]) <= size * (1 + SLACK) + error[used] + TINY:
                outside = True
                break
            # A coordinate in which the set is a point is met up to the rounding of the subtraction above.
            if size > error[used]:
                # Rows of size 1, so that neither units nor widths matter to the factorisation.
                for j in range(g):
                    equations[used, j] /= size
                target[used] /= size
                error[used] /= size
                used += 1
        found[k] = _OUTSIDE if outside else _settle(equations[:used], target[:used], error[:used])


@kernel
def _settle(equations: FloatArray, target: FloatArray, error: FloatArray) -> int:
    """Whether ``Mβ = d`` for some ``|β| <= 1``, by factors that do it or by a direction that excludes it.

    Least squares weighted anew by ``w_j = 1 / |m_j·λ|``, ``λ = (M W Mᵀ)⁻¹ d``, tend to the λ of least ``|Mᵀλ|₁`` for a
    given ``λ·d``: the direction in which d stands out most; ``β = W Mᵀ λ`` tends to the factors of least magnitude. So
    either side ends in a proof, ``λ·d > |Mᵀλ|₁`` or ``|β| <= 1``, unless d is within rounding of the boundary.
    """
    rows, g = equations.shape
    if rows == 0:
        return _INSIDE
    weights, height = np.ones(g), np.empty(g)
    factor, direction = np.empty((rows, rows)), np.empty(rows)
    for _ in range(ROUNDS):
        for i in range(rows):
            for j in range(i + 1):
                total = 0.0
                for k in range(g):
                    total += equations[i, k] * weights[k] * equations[j, k]
                factor[i, j] = total
        if not _solve_cholesky(factor, target, direction):
            return _UNDECIDED
        sum_of_heights, greatest, largest = 0.0, 0.0, 0.0
        for k in range(g):
            total = 0.0
            for i in range(rows):
                total += equations[i, k] * direction[i]
            height[k] = total
            sum_of_heights += abs(total)
            greatest = max(greatest, abs(total))
            largest = max(largest, abs(weights[k] * total))
        ahead, blurred = 0.0, 0.0
        for i in range(rows):
            ahead += direction[i] * target[i]
            blurred += abs(direction[i]) * error[i]
        if ahead > sum_of_heights * (1 + CLEAR) + blurred:
            return _OUTSIDE
        if largest <= 1 + SLACK and _is_met(equations, target, weights, height):
            return _INSIDE
        if greatest <= 0.0:
            return _UNDECIDED
        for k in range(g):
            weights[k] = 1.0 / max(abs(height[k]), 1e-9 * greatest)
    return _UNDECIDED


@kernel
def _solve_cholesky(factor: FloatArray, right: FloatArray, solution: FloatArray) -> bool:
    """Solve ``F x = right``, the lower triangle of F given, which is overwritten; False where F is nearly singular."""
    rows = len(right)
    for j in range(rows):
        pivot = factor[j, j]
        for k in range(j):
            pivot -= factor[j, k] ** 2
        if not pivot > 1e-11 * factor[j, j]:
            return False
        root = math.sqrt(pivot)
        factor[j, j] = root
        for i in range(j + 1, rows):
            for k in range(j):
                factor[i, j] -= factor[i, k] * factor[j, k]
            factor[i, j] /= root
    for i in range(rows):
        total = right[i]
        for k in range(i):
            total -= factor[i, k] * solution[k]
        solution[i] = total / factor[i, i]
    for i in range(rows - 1, -1, -1):
        total = solution[i]
        for k in range(i + 1, rows):
            total -= factor[k, i] * solution[k]
        solution[i] = total / factor[i, i]
    return True


@kernel
def _is_met(equations: FloatArray, target: FloatArray, weights: FloatArray, height: FloatArray) -> bool:
    """Whether the factors ``β_k = w_k height_k`` solve the equations, whose rows have size 1."""
    for i in range(len(target)):
        missing = -target[i]
        for k in range(len(weights)):
            missing += equations[i, k] * weights[k] * height[k]
        if not abs(missing) <= SLACK:
            return False
    return True


def reach(
    center: FloatArray, generators: FloatArray, matrix: FloatArray, offset: FloatArray, point: FloatArray
) -> tuple[BoolArray, FloatArray]:
    """Where (...) ``point`` (..., n) is ``c + Gβ`` with ``Aβ = b`` and ``|β| <= 1``, up to 1e-7, and β (..., g).

    A least-norm β settles most inner points, the interval hull most outer ones; the rest are linear programs. Factors
    are clipped to the box; where the point is not reached they are NaN.
    """
    batch = np.broadcast_shapes(
        center.shape[:-1], generators.shape[:-2], matrix.shape[:-2], offset.shape[:-1], point.shape[:-1]
    )
    n, g = generators.shape[-2:]
    rows = matrix.shape[-2]
    count = math.prod(batch)
    equations = np.concatenate(
        [np.broadcast_to(generators, (*batch, n, g)), np.broadcast_to(matrix, (*batch, rows, g))], axis=-2
    ).reshape(count, n + rows, g)
    target = np.concatenate(
        [np.broadcast_to(point - center, (*batch, n)), np.broadcast_to(offset, (*batch, rows))], axis=-1
    ).reshape(count, n + rows)
    size = np.abs(equations).sum(axis=-1)
    inside = np.zeros(count, dtype=bool)
    reaching = np.full((count, g), np.nan)
    # A coordinate in which the set is a point is met up to the rounding of the subtraction above, or up to underflow.
    rounding = TINY + np.concatenate(
        [
            np.broadcast_to(ULPS * (np.abs(point) + np.abs(center)), (*batch, n)),
            np.broadcast_to(ULPS * np.abs(offset), (*batch, rows)),
        ],
        axis=-1,
    ).reshape(count, n + rows)
    possible = (np.abs(target) <= size * (1 + SLACK) + rounding).all(axis=-1)
    todo = np.flatnonzero(possible)
    if len(todo) and g:
        # Rows are scaled to size 1 so that the accuracy of the pseudoinverse is that of the set, or of the rounding.
        scale = np.maximum(size[todo], rounding[todo] / SLACK)
        scale = np.where(scale > 0, scale, 1.0)
        scaled, wanted = equations[todo] / scale[..., None], target[todo] / scale
        factors = (np.linalg.pinv(scaled) @ wanted[..., None])[..., 0]
        factors = np.clip(factors, -1.0, 1.0)
        inside[todo] = np.abs((scaled @ factors[..., None])[..., 0] - wanted).max(axis=-1) <= SLACK
        reaching[todo] = np.where(inside[todo, None], factors, np.nan)
        for index in todo:
            if not inside[index]:
                inside[index], reaching[index] = _solve(equations[index], target[index], size[index], rounding[index])
    elif len(todo):
        inside[todo] = True
    return inside.reshape(batch), np.clip(reaching, -1.0, 1.0).reshape(*batch, g)


def _solve(equations: FloatArray, right: FloatArray, size: FloatArray, rounding: FloatArray) -> tuple[bool, FloatArray]:
    """Whether some ``|β| <= 1`` solves the equations, of rows of these sizes, up to their rounding, and β."""
    g = equations.shape[1]
    scale = np.maximum(size, rounding)
    scale = np.where(scale > 0, scale, 1.0)
    # What rounding may have done to a row is a variable of its own where the solver would see it.
    blurred = np.flatnonzero(rounding > SLACK * scale)
    blur = np.zeros((len(equations), len(blurred)))
    blur[blurred, np.arange(len(blurred))] = (rounding / scale)[blurred]
    # The least bound t with |β| <= t is asked for: always feasible where the equations are, no tolerance games.
    bounds = np.concatenate([np.eye(g), -np.eye(g)])
    result = linprog(
        np.append(np.zeros(g + len(blurred)), 1.0),
        A_ub=np.column_stack([bounds, np.zeros((2 * g, len(blurred))), -np.ones(2 * g)]),
        b_ub=np.zeros(2 * g),
        A_eq=np.column_stack([equations / scale[:, None], blur, np.zeros(len(equations))]),
        b_eq=right / scale,
        bounds=[(None, None)] * g + [(-1, 1)] * len(blurred) + [(0, None)],
        method="highs",
    )
    if result.status != 0 or result.x is None or result.x[-1] > 1 + 1e-7:
        return False, np.full(g, np.nan)
    return True, np.asarray(result.x[:g])
