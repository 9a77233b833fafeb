"""Parts of the range of a linear form over a zonotope, rounded outwards; exact where floating-point arithmetic is."""

import numpy as np

from reach_server.numeric.rounding import add_down, add_up, sum_up
from reach_server.numeric.types import FloatArray


def spread(low: FloatArray, high: FloatArray, by: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``[low - by, high + by]``, rounded outwards."""
    return add_down(low, -by), add_up(high, by)


def reach(normal: FloatArray, generators: FloatArray) -> FloatArray:
    """``|normal·G|₁`` (...) for normal (..., n) and G (..., n, g), rounded up."""
    low, high = dot(normal[..., None, :], np.swapaxes(generators, -1, -2))
    return sum_up(np.maximum(-low, high))


def dot(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bounds of ``a·b`` over the last axis, which is looped over: it is short."""
    low = high = np.zeros(np.broadcast_shapes(a.shape[:-1], b.shape[:-1]))
    for i in range(a.shape[-1]):
        less, more = product(a[..., i], b[..., i])
        low, high = add_down(low, less), add_up(high, more)
    return low, high


def product(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``ab`` rounded down and up; exact for factors 0 and ±1."""
    with np.errstate(all="ignore"):
        exact = (a == 0) | (b == 0) | (np.abs(a) == 1) | (np.abs(b) == 1)
        value = np.where((a == 0) | (b == 0), 0.0, a * b)
        return (
            np.where(exact, value, np.nextafter(value, -np.inf)),
            np.where(exact, value, np.nextafter(value, np.inf)),
        )
