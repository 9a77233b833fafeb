"""Infeasible subsets: predicates that contradict each other or the set that they are asked of."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from reach_server.numeric.types import FloatArray
from reach_server.predicates import Literals
from reach_server.predicates.apply import Contexts, strips_of
from reach_server.sets.raw import RawSets

#: Weights below this part of the greatest one are taken for rounding, and a conflict of less than this part of what a
#: row reaches for none.
_SMALL = 1e-6
#: Scaled rows are whole multiples of this: equal predicates in other units give equal programs, whatever was rounded.
_GRID = 2.0**-40


def conflicting(
    one: RawSets, row: int, asked: Sequence[int], literals: Literals, contexts: Contexts, n: int
) -> list[int]:
    """Of the literals asked of one set, row ``row`` of ``contexts``, those that together leave nothing of it; none if
    they do not exclude each other.

    A literal that alone leaves nothing is named alone. Otherwise the strips are put to the factors of the set,
    ``{|β| <= 1 : Aβ = b, lower <= H(c + Gβ) <= upper}``; the least sum of violations is positive where that is empty,
    and the dual weights of its rows (Farkas) say which take part.
    """
    rows: list[FloatArray] = [*one.matrix[0]]
    lower: list[float] = [*one.offset[0]]
    upper: list[float] = [*one.offset[0]]
    owner = [-1] * len(rows)
    for literal in asked:
        bounds, nothing = strips_of(one, np.array([0]), literal, literals, lambda i, _: contexts(i, np.array([row])), n)
        if nothing.any():
            return [literal]
        for normal, low, high in zip(np.reshape(bounds.normal, (-1, n)), bounds.lower[0], bounds.upper[0], strict=True):
            heights, middle = normal @ one.generators[0, :n], normal @ one.center[0, :n]
            rows.append(heights)
            lower.append(low - middle)
            upper.append(high - middle)
            owner.append(literal)
    weights = _weights(np.array(rows), np.array(lower), np.array(upper))
    taking_part = np.flatnonzero(weights > _SMALL * weights.max(initial=0.0))
    return sorted({owner[r] for r in taking_part.tolist()} - {-1})


def _weights(matrix: FloatArray, lower: FloatArray, upper: FloatArray) -> NDArray[np.float64]:
    """Absolute dual weights (r,) of ``lower <= Aβ <= upper``, ``|β| <= 1``, with the least sum of violations; of rows
    scaled to a reach of 1."""
    count, g = matrix.shape
    if not count:
        return np.zeros(0)
    matrix, lower, upper = _scaled(matrix, lower, upper)
    bounded_low, bounded_high = np.isfinite(lower), np.isfinite(upper)
    over, under = np.eye(count)[bounded_high], np.eye(count)[bounded_low]
    table = np.concatenate(
        [np.concatenate([matrix[bounded_high], -over], axis=1), np.concatenate([-matrix[bounded_low], -under], axis=1)]
    )
    limit = np.concatenate([upper[bounded_high], -lower[bounded_low]])
    cost = np.concatenate([np.zeros(g), np.ones(count)])
    box = [(-1.0, 1.0)] * g + [(0.0, None)] * count
    found = linprog(cost, A_ub=table, b_ub=limit, bounds=box, method="highs")
    weights = np.zeros(count)
    if found.status != 0 or found.fun is None or found.fun <= _SMALL:
        return weights
    dual = np.abs(found.ineqlin.marginals)
    high = int(bounded_high.sum())
    weights[bounded_high] += dual[:high]
    weights[bounded_low] += dual[high:]
    return weights


def _scaled(matrix: FloatArray, lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The same conditions, each row divided by its reach ``Σ|a|`` over the factors; bounds that no factor comes near
    are moved nearer. A row of zeros, which has no reach, keeps the sign of what it asks for only."""
    largest = np.abs(matrix).max(axis=1)
    # Twice, since a sum of very large numbers overflows and a quotient by a very small one.
    first = np.where(largest > 0, largest, 1.0)[:, None]
    unit = matrix / first
    reach = np.where(largest > 0, np.abs(unit).sum(axis=1), 1.0)[:, None]
    with np.errstate(over="ignore"):
        bounds = np.stack([lower, upper], axis=1) / first / reach
    zero = (largest == 0)[:, None]
    bounds = np.where(zero, np.sign(bounds), np.clip(bounds, -2.0, 2.0))
    bounds = np.where(np.isinf(np.stack([lower, upper], axis=1)), np.stack([lower, upper], axis=1), bounds)
    unit, bounds = (np.where(np.isfinite(x), np.rint(x / _GRID) * _GRID, x) for x in (unit / reach, bounds))
    return unit, bounds[:, 0], bounds[:, 1]
