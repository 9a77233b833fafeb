"""Fewer generators of one zonotope, compiled: those that are least like a box are kept, the sum of the others is
enclosed by a box ([Gir05]; ``sets.order_reduction`` for batches of the set classes). Sums are rounded
outwards.
"""

import numpy as np

from reach_server.numeric.jit import leaf_kernel
from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import FloatArray, IntArray


@leaf_kernel
def _least_of(score: FloatArray, count: int, place: int) -> float:
    """The number at ``place`` (from 0) of the ascending order of the first ``count``; reorders them [Hoa61]."""
    low, high = 0, count - 1
    while low < high:
        pivot = score[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while score[i] < pivot:
                i += 1
            while score[j] > pivot:
                j -= 1
            if i <= j:
                score[i], score[j] = score[j], score[i]
                i += 1
                j -= 1
        if place <= j:
            high = j
        elif place >= i:
            low = i
        else:
            break
    return float(score[place])


@leaf_kernel
def reduce_one(
    generators: FloatArray, used: int, rows: int, kept: int, score: FloatArray, width: FloatArray, order: IntArray
) -> int:
    """Enclose a set in place by ``kept`` of its columns and a box of the sum of the others, if it has more columns than
    these and one for each of its ``rows``; the columns then used. Rows beyond are zero. An outer bound; no column for a
    coordinate in which the box has no width. ``score`` (2, G), ``width`` (z,) and ``order`` (G,) are room for it."""
    if used <= kept + rows:
        return used
    for k in range(used):
        score[0, k] = 0.0
        score[1, k] = 0.0
    for row in range(rows):
        k = 0
        while k < used and generators[row, k] == 0.0:
            k += 1
        width[row] = 0.0 if k == used else 1.0
        for k in range(used if width[row] != 0.0 else 0):
            size = abs(generators[row, k])
            score[0, k] += size
            # The processor compares several columns at once; max() minds NaN, one by one.
            score[1, k] = size if size > score[1, k] else score[1, k]
    for k in range(used):
        unlike = score[0, k] - score[1, k]
        # NaN has no place in an order.
        score[0, k] = np.inf if np.isnan(unlike) else unlike
        score[1, k] = score[0, k]
    boxed = used - kept
    limit = _least_of(score[1], used, boxed - 1)
    below = 0
    for k in range(used):
        below += score[0, k] < limit
    # Of those that equal the limit the first ones are boxed, too.
    level = boxed - below
    count, away = 0, 0
    for k in range(used):
        boxes = score[0, k] < limit
        if not boxes and score[0, k] == limit and level > 0:
            boxes, level = True, level - 1
        if boxes:
            order[kept + away] = k
            away += 1
        else:
            order[count] = k
            count += 1
    columns = kept
    for row in range(rows):
        if width[row] == 0.0:
            continue
        total = 0.0
        for k in range(kept, used):
            total += abs(generators[row, order[k]])
        for k in range(kept):
            generators[row, k] = generators[row, order[k]]
        for k in range(kept, used):
            generators[row, k] = 0.0
        width[row] = total * (1.0 + (boxed + 1) * EPS)
        columns += width[row] != 0.0
    count = kept
    for row in range(rows):
        if width[row] != 0.0:
            generators[row, count] = width[row]
            count += 1
    return columns
