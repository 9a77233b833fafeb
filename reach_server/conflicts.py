"""Which predicates contradict each other, or the set that they are asked of."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from reach_server.cuts import Contexts, strips_of
from reach_server.factor_sets import FactorSet
from reach_server.predicates import Literals
from reach_server.sets.arrays import Array

#: Weights below this part of the greatest one are taken for rounding.
_SMALL = 1e-6


def conflicting(
    one: FactorSet, row: int, asked: Sequence[int], literals: Literals, contexts: Contexts, n: int
) -> list[int]:
    """Of the literals asked of one set, row ``row`` of ``contexts``, those that together leave nothing of it; none if
    they do not exclude each other.

    A literal that alone leaves nothing is named alone. Otherwise the strips are put to the factors of the set,
    ``{|β| <= 1 : Aβ = b, lower <= H(c + Gβ) <= upper}``; the least sum of violations is positive where that is empty,
    and the dual weights of its rows (Farkas) say which take part.
    """
    rows: list[Array] = [*one.matrix[0]]
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


def _weights(matrix: Array, lower: Array, upper: Array) -> NDArray[np.float64]:
    """Absolute dual weights (r,) of ``lower <= Aβ <= upper``, ``|β| <= 1``, with the least sum of violations."""
    count, g = matrix.shape
    if not count:
        return np.zeros(0)
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
    if found.status != 0 or found.fun <= _SMALL * np.abs(matrix).max(initial=1e-300):
        return weights
    dual = np.abs(found.ineqlin.marginals)
    high = int(bounded_high.sum())
    weights[bounded_high] += dual[:high]
    weights[bounded_low] += dual[high:]
    return weights
