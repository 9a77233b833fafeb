"""Sums in twice the precision, for what is small beside its terms."""

import numpy as np

from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import FloatArray

#: Splits a number into two halves of 26 digits, whose products are exact.
SPLITTER = 2.0**27 + 1.0


def two_sum(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The rounded sum and what it lost."""
    total = a + b
    back = total - a
    return total, (a - (total - back)) + (b - back)


def two_product(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The rounded product and what it lost; the numbers far from overflow."""
    product = a * b
    a_high, b_high = SPLITTER * a, SPLITTER * b
    a_high, b_high = a_high - (a_high - a), b_high - (b_high - b)
    a_low, b_low = a - a_high, b - b_high
    return product, a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low)


def remainder(offset: FloatArray, matrix: FloatArray, factors: FloatArray) -> FloatArray:
    """``b - Aβ`` (..., c), summed in twice the precision: off by one ulp of itself [Hig02]; what lies below
    the rounding of that, 1e-29 of the terms, is zero."""
    g = matrix.shape[-1]
    _, exponent = np.frexp(np.maximum(np.abs(matrix).max(axis=-1, initial=0.0), np.abs(offset)))
    # Powers of two: neither products of huge rows nor the errors of tiny ones leave the range.
    scaled = np.ldexp(matrix, -exponent[..., None])
    high = np.ldexp(offset, -exponent) + np.zeros(np.broadcast_shapes(matrix.shape[:-1], (*factors.shape[:-1], 1)))
    low, size = np.zeros(high.shape), np.abs(high)
    for j in range(g):
        term, lost = two_product(scaled[..., j], -factors[..., j, None])
        high, left = two_sum(high, term)
        low = low + (left + lost)
        size = size + np.abs(term)
    result = high + low
    return np.asarray(np.ldexp(np.where(np.abs(result) <= (g + 1) * EPS**2 * size, 0.0, result), exponent))


def product(matrix: FloatArray, columns: FloatArray) -> FloatArray:
    """``matrix @ columns`` (..., k, g) for (..., k, n) and (..., n, g), as ``remainder``: off by one ulp of each entry,
    zero where it cancels out."""
    entries = remainder(np.zeros(matrix.shape[-2]), -matrix[..., None, :, :], np.swapaxes(columns, -1, -2))
    return np.swapaxes(entries, -1, -2)
