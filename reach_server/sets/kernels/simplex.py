"""Linear programs over a box by the dual simplex method: ``max c·β`` with ``Aβ = b``, ``|β| <= 1``.

With every variable boxed, each basis is dual feasible: a variable outside the basis goes to the bound that the sign of
its reduced cost asks for. So there is no first phase, every iteration ends with multipliers y, and each y is a
certificate: ``c·β <= b·y + |c - Aᵀy|₁`` for all ``|β| <= 1`` with ``Aβ = b``. One iteration minimises that bound along
an edge, over all its kinks at once (the bound flipping ratio test, [Mar03]); where it falls without end
the edge is a Farkas certificate of emptiness.

What the iterations do is not trusted: bounds and certificates are evaluated anew from A and b, with what their sums may
lose by rounding, and the bound is compared with the value that the point β attains. Where the two differ the basis is
factorised again, then the costs are perturbed (which breaks cycles).

Numbers: rows are divided by a power of two near their greatest entry; the tableau holds ``B⁻¹ [A | I | b]``.
"""

import math

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.jit import kernel
from reach_server.numeric.types import FloatArray, IntArray

OPTIMAL, EMPTY, UNFINISHED = 0, 1, 2
#: A row is taken to depend on the others where elimination leaves no entry above this (rows have size 1).
DEPENDENT = 1e-10
#: Variables may lie this far outside their bounds; the bound stays a bound, it is then not quite the least.
FEASIBLE = 1e-12
#: Entries of the tableau below this are not divided by.
PIVOT = 1e-9
#: Farkas certificates must exceed rounding by this much, relative to their terms: A and b may come from sums.
FARKAS = 1e-9
#: The bound and the attained value must agree to this, relative to |c|₁, or the basis is factorised again.
AGREEMENT = 1e-11
EPS = float(np.finfo(np.float64).eps)


@kernel
def load(matrix: FloatArray, offset: FloatArray, rows: FloatArray, scale: FloatArray, tableau: FloatArray) -> None:
    """Fill ``rows`` (m, g + 1) with the scaled ``[A | b]`` and the tableau (m, g + m + 1) with ``[A | I | b]``."""
    m, g = matrix.shape
    for i in range(m):
        largest = 0.0
        for j in range(g):
            largest = max(largest, abs(matrix[i, j]))
        if largest == 0.0:
            largest = abs(offset[i])
        exponent = math.frexp(largest)[1] if largest > 0.0 else 0
        scale[i] = math.ldexp(1.0, -exponent)
        for j in range(g):
            rows[i, j] = matrix[i, j] * scale[i]
        rows[i, g] = offset[i] * scale[i]
    refill(rows, tableau)


@kernel
def refill(rows: FloatArray, tableau: FloatArray) -> None:
    """The tableau of the empty basis."""
    m, g = rows.shape[0], rows.shape[1] - 1
    for i in range(m):
        for j in range(g):
            tableau[i, j] = rows[i, j]
        for j in range(m):
            tableau[i, g + j] = 0.0
        tableau[i, g + i] = 1.0
        tableau[i, g + m] = rows[i, g]


@kernel
def pivot(tableau: FloatArray, count: int, r: int, j: int) -> None:
    """Make column j a unit column with its 1 in row r, in the first ``count`` rows."""
    width = tableau.shape[1]
    factor = 1.0 / tableau[r, j]
    for k in range(width):
        tableau[r, k] *= factor
    tableau[r, j] = 1.0
    for i in range(count):
        if i != r:
            factor = tableau[i, j]
            if factor != 0.0:
                for k in range(width):
                    tableau[i, k] -= factor * tableau[r, k]
                tableau[i, j] = 0.0


@kernel
def factorise(rows: FloatArray, tableau: FloatArray, basis: IntArray, basic: IntArray, keep: bool) -> int:
    """Rank of the rows; ``basis`` gets one column for each independent row, which come first in the tableau.

    Elimination with complete pivoting; with ``keep`` only over the columns that ``basic`` names, as far as they go.
    """
    m, g = rows.shape[0], rows.shape[1] - 1
    width = tableau.shape[1]
    refill(rows, tableau)
    rank = 0
    while rank < m:
        best, row, column = 0.0, -1, -1
        for i in range(rank, m):
            for j in range(g):
                if abs(tableau[i, j]) > best and (not keep or basic[j] == 1):
                    best, row, column = abs(tableau[i, j]), i, j
        if best < DEPENDENT:
            if not keep:
                break
            keep = False
            for j in range(g):
                basic[j] = 0
            for i in range(rank):
                basic[basis[i]] = 1
            continue
        if row != rank:
            for k in range(width):
                tableau[row, k], tableau[rank, k] = tableau[rank, k], tableau[row, k]
        pivot(tableau, m, rank, column)
        basis[rank] = column
        rank += 1
    for j in range(g):
        basic[j] = 0
    for i in range(rank):
        basic[basis[i]] = 1
    return rank


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
def place(
    tableau: FloatArray,
    rank: int,
    cost: FloatArray,
    basis: IntArray,
    basic: IntArray,
    x: FloatArray,
    d: FloatArray,
    values: FloatArray,
) -> None:
    """Reduced costs ``d``, variables ``x`` outside the basis at their bounds, and the ``values`` of the basic ones."""
    g = len(cost)
    last = tableau.shape[1] - 1
    for j in range(g):
        d[j] = cost[j]
    for i in range(rank):
        weight = cost[basis[i]]
        if weight != 0.0:
            for j in range(g):
                d[j] -= weight * tableau[i, j]
    for j in range(g):
        if basic[j] == 1:
            x[j] = 0.0
            d[j] = 0.0
        elif d[j] > 0.0:
            x[j] = 1.0
        elif d[j] < 0.0:
            x[j] = -1.0
        elif abs(x[j]) != 1.0:
            x[j] = 1.0
    for i in range(rank):
        total = tableau[i, last]
        for j in range(g):
            total -= tableau[i, j] * x[j]
        values[i] = total


@kernel
def descend(
    rows: FloatArray, tableau: FloatArray, rank: int, basis: IntArray, basic: IntArray,
    x: FloatArray, d: FloatArray, values: FloatArray, limit: int, ray: FloatArray, kinks: FloatArray, queue: IntArray,
) -> tuple[int, int]:  # fmt: skip
    """Dual simplex iterations from a placed basis: (status, how many). With ``EMPTY``, ``ray`` holds the weights."""
    g, m = rows.shape[1] - 1, rows.shape[0]
    for iteration in range(limit):
        r, best = -1, 0.0
        for i in range(rank):
            excess = abs(values[i]) - 1.0
            if excess > FEASIBLE:
                norm = 0.0
                for k in range(g, g + m):
                    norm += tableau[i, k] * tableau[i, k]
                if excess * excess > best * norm:
                    best, r = excess * excess / norm, i
        if r < 0:
            return OPTIMAL, iteration
        side = 1.0 if values[r] > 0.0 else -1.0
        slope = abs(values[r]) - 1.0
        count = 0
        for j in range(g):
            if x[j] * side * tableau[r, j] < -PIVOT:
                queue[count] = j
                kinks[count] = max(x[j] * d[j], 0.0) / abs(tableau[r, j])
                count += 1
        if count == 0 and slope <= 1e3 * FEASIBLE:
            return UNFINISHED, iteration
        entering, flipped = -1, 0
        # Selection from the front: the kinks passed lie before `flipped`, in order.
        while flipped < count:
            nearest = flipped
            for k in range(flipped + 1, count):
                if kinks[k] < kinks[nearest] or (
                    kinks[k] == kinks[nearest] and abs(tableau[r, queue[k]]) > abs(tableau[r, queue[nearest]])
                ):
                    nearest = k
            queue[flipped], queue[nearest] = queue[nearest], queue[flipped]
            kinks[flipped], kinks[nearest] = kinks[nearest], kinks[flipped]
            entering = queue[flipped]
            slope -= 2.0 * abs(tableau[r, entering])
            if slope <= 0.0:
                break
            flipped += 1
        if flipped == count:
            for k in range(m):
                ray[k] = -side * tableau[r, g + k]
            if farkas(rows, ray) < 0.0:
                return EMPTY, iteration
            if entering < 0:
                return UNFINISHED, iteration
            # All but no descent is left beyond the last kink: stop there.
            flipped -= 1
        step = side * kinks[flipped]
        for k in range(flipped):
            j = queue[k]
            for i in range(rank):
                values[i] += 2.0 * x[j] * tableau[i, j]
            x[j] = -x[j]
        for j in range(g):
            d[j] += step * tableau[r, j]
        d[entering] = 0.0
        leaving = basis[r]
        x[leaving] = side
        basic[leaving] = 0
        move = (values[r] - side) / tableau[r, entering]
        for i in range(rank):
            values[i] -= tableau[i, entering] * move
        values[r] = x[entering] + move
        x[entering] = 0.0
        basic[entering] = 1
        basis[r] = entering
        pivot(tableau, rank, r, entering)
    return UNFINISHED, limit


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


@kernel
def maximise(
    rows: FloatArray,
    tableau: FloatArray,
    rank: int,
    basis: IntArray,
    basic: IntArray,
    cost: FloatArray,
    limit: int,
    x: FloatArray,
    d: FloatArray,
    values: FloatArray,
    y: FloatArray,
    best: FloatArray,
    ray: FloatArray,
    point: FloatArray,
    kinks: FloatArray,
    queue: IntArray,
    trial: FloatArray,
) -> tuple[int, float, int]:
    """(status, least bound of ``c·β`` found, new rank); ``best`` holds its multipliers, ``point`` the β reached.

    Starts from the basis in the tableau, whichever problem over the same rows it comes from.
    """
    m, g = rows.shape[0], rows.shape[1] - 1
    size = 0.0
    for j in range(g):
        size += abs(cost[j])
    for k in range(m):
        best[k] = 0.0
    bound = size * (1.0 + EPS * (g + 4))
    status = UNFINISHED
    for attempt in range(4):
        if attempt > 0:
            rank = factorise(rows, tableau, basis, basic, True)
        if attempt == 2:
            # Costs that no two columns share: ties, and with them cycles, vanish.
            shake = 0.5
            for j in range(g):
                shake = (shake * 997.0 + 0.317) % 1.0
                trial[j] = cost[j] + (shake - 0.5) * 1e-7 * (size / g + abs(cost[j]))
        else:
            for j in range(g):
                trial[j] = cost[j]
        place(tableau, rank, trial, basis, basic, x, d, values)
        status, _ = descend(rows, tableau, rank, basis, basic, x, d, values, limit, ray, kinks, queue)
        multipliers(rows, tableau, rank, basis, cost, y)
        value = bound_of(rows, y, cost)
        if value < bound:
            bound = value
            for k in range(m):
                best[k] = y[k]
        if status == EMPTY:
            break
        reached = attained(rows, tableau, rank, basis, cost, x, values, point)
        if status == OPTIMAL and bound - reached <= AGREEMENT * size:
            break
        if status == OPTIMAL and attempt != 2:
            status = UNFINISHED
        if limit == 0:
            break
    return status, bound, rank


@kernel
def supports(
    center: FloatArray,
    generators: FloatArray,
    matrix: FloatArray,
    offset: FloatArray,
    directions: FloatArray,
    count: int,
    limit: int,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, NDArray[np.int64]]:
    """Bounds (P, K), weights (P, K, m), factors (P, K, g), rays (P, m) and status (P, K) for P = ``count`` problems.

    Arrays have P or 1 along their first axis: center (n), generators (n, g), matrix (m, g), offset (m), directions
    (K, n). Bounds include the rounding of all sums, that of ``Gᵀd`` too. With ``EMPTY`` the ray certifies it.
    """
    m, g = matrix.shape[1:]
    n = center.shape[1]
    ways = directions.shape[1]
    bounds = np.zeros((count, ways))
    weights = np.zeros((count, ways, m))
    factors = np.zeros((count, ways, g))
    rays = np.zeros((count, m))
    status = np.zeros((count, ways), dtype=np.int64)
    rows, scale, tableau = np.zeros((m, g + 1)), np.ones(m), np.zeros((m, g + m + 1))
    basis, basic, queue = np.zeros(m, dtype=np.int64), np.zeros(g, dtype=np.int64), np.zeros(g, dtype=np.int64)
    x, d, kinks, point, cost, trial = np.ones(g), np.zeros(g), np.zeros(g), np.zeros(g), np.zeros(g), np.zeros(g)
    values, y, best, ray = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m)
    for p in range(count):
        c = center[p if center.shape[0] > 1 else 0]
        G = generators[p if generators.shape[0] > 1 else 0]
        D = directions[p if directions.shape[0] > 1 else 0]
        load(
            matrix[p if matrix.shape[0] > 1 else 0], offset[p if offset.shape[0] > 1 else 0], rows, scale, tableau
        )  # fmt: skip
        rank = factorise(rows, tableau, basis, basic, False)
        empty = dependent_rows_fail(rows, tableau, rank, ray)
        for k in range(ways):
            linear, lost = 0.0, 0.0
            for i in range(n):
                linear += D[k, i] * c[i]
                lost += abs(D[k, i] * c[i])
            for j in range(g):
                total = 0.0
                for i in range(n):
                    total += D[k, i] * G[i, j]
                    lost += abs(D[k, i] * G[i, j])
                cost[j] = total
            if k % 64 == 63:
                rank = factorise(rows, tableau, basis, basic, True)
            if empty:
                for j in range(g):
                    bounds[p, k] += abs(cost[j])
                status[p, k] = EMPTY
            else:
                status[p, k], bounds[p, k], rank = maximise(
                    rows, tableau, rank, basis, basic, cost, limit,
                    x, d, values, y, best, ray, point, kinks, queue, trial,
                )  # fmt: skip
                empty = status[p, k] == EMPTY
                for i in range(m):
                    weights[p, k, i] = best[i] * scale[i]
                for j in range(g):
                    factors[p, k, j] = point[j]
            bounds[p, k] += linear
            bounds[p, k] += EPS * (n + 4) * lost + EPS * abs(bounds[p, k])
        if empty:
            for i in range(m):
                rays[p, i] = ray[i] * scale[i]
            for k in range(ways):
                status[p, k] = EMPTY
    return bounds, weights, factors, rays, status
