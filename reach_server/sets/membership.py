"""Is a point in the set? Cheap answers for a whole batch first, linear programs for what is left."""

import numpy as np
from scipy.optimize import linprog

from reach_server.sets.arrays import Array, Mask

#: Relative accuracy of the cheap answers (the linear programs have 1e-7).
SLACK = 1e-9
#: Rounding errors that a point and the set may have come with, relative to their distance from the origin.
ULPS = 8 * np.finfo(np.float64).eps


def contains(center: Array, generators: Array, matrix: Array, offset: Array, point: Array) -> Mask:
    """True (...) where ``point`` (..., n) is ``c + Gβ`` with ``Aβ = b`` and ``|β| <= 1``, up to 1e-7."""
    return reach(center, generators, matrix, offset, point)[0]


def reach(center: Array, generators: Array, matrix: Array, offset: Array, point: Array) -> tuple[Mask, Array]:
    """Where (...) ``point`` (..., n) is ``c + Gβ`` with ``Aβ = b`` and ``|β| <= 1``, up to 1e-7, and β (..., g).

    A least-norm β settles most inner points, the interval hull most outer ones; the rest are linear programs. Factors
    are clipped to the box; where the point is not reached they are NaN.
    """
    batch = np.broadcast_shapes(
        center.shape[:-1], generators.shape[:-2], matrix.shape[:-2], offset.shape[:-1], point.shape[:-1]
    )
    n, g = generators.shape[-2:]
    rows = matrix.shape[-2]
    count = int(np.prod(batch))
    stacked = np.concatenate(
        [np.broadcast_to(generators, (*batch, n, g)), np.broadcast_to(matrix, (*batch, rows, g))], axis=-2
    ).reshape(count, n + rows, g)
    target = np.concatenate(
        [np.broadcast_to(point - center, (*batch, n)), np.broadcast_to(offset, (*batch, rows))], axis=-1
    ).reshape(count, n + rows)
    size = np.abs(stacked).sum(axis=-1)
    inside = np.zeros(count, dtype=bool)
    reaching = np.full((count, g), np.nan)
    # A coordinate in which the set is a point is met up to the rounding of the subtraction above.
    rounding = np.concatenate(
        [
            np.broadcast_to(ULPS * (np.abs(point) + np.abs(center)), (*batch, n)),
            np.broadcast_to(ULPS * np.abs(offset), (*batch, rows)),
        ],
        axis=-1,
    ).reshape(count, n + rows)
    possible = (np.abs(target) <= size * (1 + SLACK) + rounding + np.finfo(float).tiny).all(axis=-1)
    todo = np.flatnonzero(possible)
    if len(todo) and g:
        # Rows are scaled to size 1 so that the accuracy of the pseudoinverse is that of the set, or of the rounding.
        scale = np.maximum(size[todo], rounding[todo] / SLACK)
        scale = np.where(scale > 0, scale, 1.0)
        scaled, wanted = stacked[todo] / scale[..., None], target[todo] / scale
        factors = (np.linalg.pinv(scaled) @ wanted[..., None])[..., 0]
        reached = np.abs((scaled @ factors[..., None])[..., 0] - wanted).max(axis=-1) <= SLACK
        inside[todo] = reached & (np.abs(factors).max(axis=-1) <= 1 + SLACK)
        reaching[todo] = np.where(inside[todo, None], factors, np.nan)
        for index, equations, right in zip(todo, scaled, wanted, strict=True):
            if not inside[index]:
                inside[index], reaching[index] = _solve(equations, right)
    elif len(todo):
        inside[todo] = True
    return inside.reshape(batch), np.clip(reaching, -1.0, 1.0).reshape(*batch, g)


def _solve(equations: Array, right: Array) -> tuple[bool, Array]:
    g = equations.shape[1]
    # The least bound t with |β| <= t is asked for: always feasible where the equations are, no tolerance games.
    costs = np.append(np.zeros(g), 1.0)
    bounds = np.concatenate([np.eye(g), -np.eye(g)])
    result = linprog(
        costs,
        A_ub=np.column_stack([bounds, -np.ones(2 * g)]),
        b_ub=np.zeros(2 * g),
        A_eq=np.column_stack([equations, np.zeros(len(equations))]),
        b_eq=right,
        bounds=[(None, None)] * g + [(0, None)],
        method="highs",
    )
    if result.status != 0 or result.x is None or result.x[-1] > 1 + 1e-7:
        return False, np.full(g, np.nan)
    return True, np.asarray(result.x[:g])
