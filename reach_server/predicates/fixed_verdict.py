"""Verdicts of fixed strips on many sets, compiled: the loops behind ``HalfspaceEnclosure.verdict``.

The range of each linear form is an outer bound: sums and products that are no floating-point numbers are rounded
outwards by one unit in the last place.
"""

import numpy as np

from reach_server.numeric.jit import kernel
from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import FloatArray
from reach_server.predicates.interface import HOLDS, MAY_HOLD, NEVER, Verdict
from reach_server.sets.kernels.strip import EMPTY_MARGIN

_HOLDS, _MAY_HOLD, _NEVER = HOLDS, MAY_HOLD, NEVER


@kernel
def fixed_verdict(
    normal: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    moved_lower: FloatArray,
    moved_upper: FloatArray,
    center: FloatArray,
    generators: FloatArray,
) -> Verdict:
    """``HOLDS`` (R,) where all of a zonotope (R, n), (R, n, g) lies in all C strips (C, n), (C,), (C,); ``NEVER`` where
    it misses one of those with the moved bounds (C,), by more than rounding; else ``MAY_HOLD``."""
    rows, n = center.shape
    g = generators.shape[2]
    found = np.zeros(rows, dtype=np.int8)
    for row in range(rows):
        holds, never = True, False
        for c in range(len(lower)):
            low = high = middle = 0.0
            for i in range(n):
                less, more = _product(normal[c, i], center[row, i])
                low, high = _add_down(low, less), _add_up(high, more)
                middle += normal[c, i] * center[row, i]
            reach, terms, plain, size = 0.0, 0, 0.0, 0.0
            for j in range(g):
                less = more = exact = 0.0
                for i in range(n):
                    down, up = _product(normal[c, i], generators[row, i, j])
                    less, more = _add_down(less, down), _add_up(more, up)
                    exact += normal[c, i] * generators[row, i, j]
                widest = max(-less, more)
                reach += widest
                terms += widest != 0.0
                plain += abs(exact)
            for i in range(n):
                spread = 0.0
                for j in range(g):
                    spread += abs(generators[row, i, j])
                size += abs(normal[c, i]) * (abs(center[row, i]) + spread)
            reach *= 1.0 + max(terms - 1, 0) * EPS
            if _add_down(low, -reach) < lower[c] or _add_up(high, reach) > upper[c]:
                holds = False
            least, most = max(moved_lower[c], middle - plain), min(moved_upper[c], middle + plain)
            margin = EMPTY_MARGIN * (abs(middle) + plain + (abs(least) if np.isfinite(least) else 0.0))
            if least > most + margin + (n + g) * EPS * size:
                never = True
        found[row] = _MAY_HOLD if holds == never else (_HOLDS if holds else _NEVER)
    return found


@kernel
def _product(a: float, b: float) -> tuple[float, float]:
    if a == 0.0 or b == 0.0:
        return 0.0, 0.0
    value = a * b
    if abs(a) == 1.0 or abs(b) == 1.0:
        return value, value
    return np.nextafter(value, -np.inf), np.nextafter(value, np.inf)


@kernel
def _lost(a: float, b: float, total: float) -> float:
    back = total - a
    return (a - (total - back)) + (b - back)


@kernel
def _add_up(a: float, b: float) -> float:
    total = a + b
    return total if _lost(a, b, total) <= 0.0 else np.nextafter(total, np.inf)


@kernel
def _add_down(a: float, b: float) -> float:
    total = a + b
    return total if _lost(a, b, total) >= 0.0 else np.nextafter(total, -np.inf)
