"""Is a point in the set? Cheap answers for a whole batch first, linear programs for what is left."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from reach_server.sets.arrays import Array

#: Relative accuracy of the cheap answers (the linear programs have 1e-7).
SLACK = 1e-9
#: Rounding errors that a point and the set may have come with, relative to their distance from the origin.
ULPS = 8 * np.finfo(np.float64).eps


def contains(center: Array, generators: Array, matrix: Array, offset: Array, point: Array) -> NDArray[np.bool_]:
    """True (...) where ``point`` (..., n) is ``c + Gβ`` with ``Aβ = b`` and ``|β| <= 1``, up to 1e-7.

    A least-norm β settles most inner points, the interval hull most outer ones; the rest are linear programs.
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
        # Rows are scaled to size 1 so that the accuracy of the pseudoinverse is that of the set.
        scale = np.where(size[todo] > 0, size[todo], 1.0)
        scaled = stacked[todo] / scale[..., None]
        wanted = np.where(size[todo] > 0, target[todo] / scale, 0.0)
        factors = (np.linalg.pinv(scaled) @ wanted[..., None])[..., 0]
        reached = np.abs((scaled @ factors[..., None])[..., 0] - wanted).max(axis=-1) <= SLACK
        inside[todo] = reached & (np.abs(factors).max(axis=-1) <= 1 + SLACK)
        for index, equations, right in zip(todo, scaled, wanted, strict=True):
            if not inside[index]:
                inside[index] = _solvable(equations, right)
    elif len(todo):
        inside[todo] = True
    return inside.reshape(batch)


def _solvable(equations: Array, right: Array) -> bool:
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
    return bool(result.status == 0 and result.fun is not None and result.fun <= 1 + 1e-7)
