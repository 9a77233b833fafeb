"""Linear programs over a box by the dual simplex method: ``max c·β`` with ``Aβ = b``, ``|β| <= 1``.

With every variable boxed, each basis is dual feasible: a variable outside the basis goes to the bound that the sign of
its reduced cost asks for. So there is no first phase, every iteration ends with multipliers y, and each y is a
certificate: ``c·β <= b·y + |c - Aᵀy|₁`` for all ``|β| <= 1`` with ``Aβ = b``. One iteration minimises that bound along
an edge, over all its kinks at once (the bound flipping ratio test, [Mar03]); where it falls without end
the edge is a Farkas certificate of emptiness.

What the iterations do is not trusted: bounds and certificates are evaluated anew from A and b, with what their sums may
lose by rounding, and the bound is compared with the value that the point β attains. Where the two differ the basis is
factorised again, then the costs are perturbed (which breaks cycles).

The basis and its factors are in ``tableau``, what its ends prove in ``certificates``.
"""

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.jit import NO, YES, kernel
from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import FloatArray, IntArray
from reach_server.sets.kernels.certificates import attained, bound_of, dependent_rows_fail, farkas, multipliers
from reach_server.sets.kernels.tableau import factorise, load, pivot

OPTIMAL, EMPTY, UNFINISHED = 0, 1, 2
#: Variables may lie this far outside their bounds; the bound stays a bound, it is then not quite the least.
FEASIBLE = 1e-12
#: Entries of the tableau below this are not divided by.
PIVOT = 1e-9
#: The bound and the attained value must agree to this, relative to |c|₁, or the basis is factorised again.
AGREEMENT = 1e-11


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
            rank = factorise(rows, tableau, basis, basic, YES)
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
        rank = factorise(rows, tableau, basis, basic, NO)
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
                rank = factorise(rows, tableau, basis, basic, YES)
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
