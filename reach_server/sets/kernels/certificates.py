"""What a basis proves of ``Aβ = b``, ``|β| <= 1``: bounds of ``c·β``, emptiness, and the value that a point attains.

Each is evaluated anew from A and b, with what its sums may lose by rounding, so that it holds whatever the iterations
did. ``rows`` (m, g + 1) hold the scaled ``[A | b]``, y (m,) multipliers of these.
"""

from reach_server.numeric.jit import kernel
from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import FloatArray, IntArray

#: Farkas certificates must exceed rounding by this much, relative to their terms: A and b may come from sums.
FARKAS = 1e-9


@kernel
def farkas(rows: FloatArray, y: FloatArray) -> float:
    """``b·y + |Aᵀy|₁`` plus what rounding may hide; below zero the set is empty."""
    m, g = rows.shape[0], rows.shape[1] - 1
    value, terms = 0.0, 0.0
    for i in range(m):
        value += rows[i, g] * y[i]
        terms += abs(rows[i, g] * y[i])
    for j in range(g):
        total = 0.0
        for i in range(m):
            total += rows[i, j] * y[i]
            terms += abs(rows[i, j] * y[i])
        value += abs(total)
    return value + FARKAS * terms


@kernel
def dependent_rows_fail(rows: FloatArray, tableau: FloatArray, rank: int, y: FloatArray) -> bool:
    """True where a row that depends on others contradicts them; y gets the Farkas weights."""
    m, g = rows.shape[0], rows.shape[1] - 1
    for i in range(rank, m):
        sign = -1.0 if tableau[i, g + m] > 0 else 1.0
        for k in range(m):
            y[k] = sign * tableau[i, g + k]
        if farkas(rows, y) < 0.0:
            return True
    return False


@kernel
def multipliers(
    rows: FloatArray, tableau: FloatArray, rank: int, basis: IntArray, cost: FloatArray, y: FloatArray
) -> None:
    """The y (of scaled rows) at which the basic reduced costs vanish, refined once."""
    m, g = rows.shape[0], rows.shape[1] - 1
    for k in range(m):
        y[k] = 0.0
        for i in range(rank):
            y[k] += cost[basis[i]] * tableau[i, g + k]
    for i in range(rank):
        left = cost[basis[i]]
        for k in range(m):
            left -= rows[k, basis[i]] * y[k]
        if left != 0.0:
            for k in range(m):
                y[k] += left * tableau[i, g + k]


@kernel
def bound_of(rows: FloatArray, y: FloatArray, cost: FloatArray) -> float:
    """``b·y + |c - Aᵀy|₁`` plus the most that its sums may have lost by rounding."""
    m, g = rows.shape[0], rows.shape[1] - 1
    value, terms = 0.0, 0.0
    for i in range(m):
        value += rows[i, g] * y[i]
        terms += abs(rows[i, g] * y[i])
    for j in range(g):
        rest = cost[j]
        terms += abs(rest)
        for i in range(m):
            product = rows[i, j] * y[i]
            rest -= product
            terms += abs(product)
        value += abs(rest)
    return float(value + EPS * (m + g + 4) * terms)


@kernel
def attained(
    rows: FloatArray,
    tableau: FloatArray,
    rank: int,
    basis: IntArray,
    cost: FloatArray,
    x: FloatArray,
    values: FloatArray,
    point: FloatArray,
) -> float:
    """``c·β`` at the point of the basis, which is refined once and clipped to the box."""
    g, m = rows.shape[1] - 1, rows.shape[0]
    for j in range(g):
        point[j] = x[j]
    for i in range(rank):
        point[basis[i]] = values[i]
    for k in range(m):
        left = rows[k, g]
        for j in range(g):
            left -= rows[k, j] * point[j]
        if left != 0.0:
            for i in range(rank):
                point[basis[i]] += tableau[i, g + k] * left
    total = 0.0
    for j in range(g):
        point[j] = min(max(point[j], -1.0), 1.0)
        total += cost[j] * point[j]
    return total
