"""Interval rules of arithmetic, comparisons and roots: operations that floating point rounds correctly.

A rule maps bounds ``(lower, upper)`` of reals to bounds of all results, rounded outwards by at most 1 ulp. A lower
bound is never +inf and an upper one never -inf. What a rule gives outside of the operation's domain has no meaning.
"""

from collections.abc import Callable

import numpy as np

from reach_server.numeric.types import BoolArray, FloatArray

#: Lower and upper bounds of the same shape.
Bounds = tuple[FloatArray, FloatArray]


def add(a: Bounds, b: Bounds) -> Bounds:
    """``a + b``; a sum of numbers of one sign has it, so that 0 stays 0."""
    low, high = _down(a[0] + b[0]), _up(a[1] + b[1])
    low = np.where((a[0] >= 0) & (b[0] >= 0), np.maximum(low, 0.0), low)
    return low, np.where((a[1] <= 0) & (b[1] <= 0), np.minimum(high, 0.0), high)


def subtract(a: Bounds, b: Bounds) -> Bounds:
    """``a - b``."""
    return add(a, negate(b))


def negate(a: Bounds) -> Bounds:
    """``-a``, exact."""
    return -a[1], -a[0]


def twice(a: Bounds) -> Bounds:
    """``2a``, exact but for overflow."""
    return _not_above(2 * a[0]), _not_below(2 * a[1])


def multiply(a: Bounds, b: Bounds) -> Bounds:
    """``ab``; 0 times an infinite bound is 0, since the factors themselves are finite."""
    corners = [x * y for x in a for y in b]
    low, high = _hull([np.where(np.isnan(corner), 0.0, corner) for corner in corners])
    return signed(_down(low), _up(high), _signs(a, b))


def divide(a: Bounds, b: Bounds) -> Bounds:
    """``a / b`` where b does not hold 0. Infinity by infinity is between what the other corners give."""
    corners = [x / y for x in a for y in b]
    low, high = np.fmin.reduce(corners), np.fmax.reduce(corners)
    return signed(_down(low), _up(high), _signs(a, b))


def invert(a: Bounds) -> Bounds:
    """``1 / a`` where a does not hold 0."""
    return signed(_down(1 / a[1]), _up(1 / a[0]), _sign(a))


def square(a: Bounds) -> Bounds:
    """``a²``, never negative."""
    least, most = magnitude(a)
    return np.maximum(_down(least * least), 0.0), np.where(most == 0, 0.0, _up(most * most))


def root(a: Bounds) -> Bounds:
    """The square root where a is not negative."""
    low, high = np.sqrt(np.maximum(a[0], 0.0)), np.sqrt(np.maximum(a[1], 0.0))
    return np.maximum(_down(low), 0.0), np.where(high == 0, 0.0, _up(high))


def absolute(a: Bounds) -> Bounds:
    """``|a|``, exact."""
    return magnitude(a)


def minimum(a: Bounds, b: Bounds) -> Bounds:
    """The lesser of two, exact."""
    return np.minimum(a[0], b[0]), np.minimum(a[1], b[1])


def maximum(a: Bounds, b: Bounds) -> Bounds:
    """The greater of two, exact."""
    return np.maximum(a[0], b[0]), np.maximum(a[1], b[1])


def floor(a: Bounds) -> Bounds:
    """The greatest whole number that is no greater, exact."""
    return np.floor(a[0]), np.floor(a[1])


def ceil(a: Bounds) -> Bounds:
    """The least whole number that is no less, exact."""
    return np.ceil(a[0]), np.ceil(a[1])


def sign(a: Bounds) -> Bounds:
    """-1, 0 or 1, exact."""
    return np.sign(a[0]), np.sign(a[1])


def same(a: Bounds) -> Bounds:
    """The operand."""
    return a


def less(a: Bounds, b: Bounds) -> Bounds:
    """1 where ``a < b``, 0 where not, both where it is not certain."""
    return _truth(a[1] < b[0], a[0] < b[1])


def less_equal(a: Bounds, b: Bounds) -> Bounds:
    """Truth of ``a <= b``."""
    return _truth(a[1] <= b[0], a[0] <= b[1])


def equal(a: Bounds, b: Bounds) -> Bounds:
    """Truth of ``a == b``."""
    return _truth((a[0] == a[1]) & (b[0] == b[1]) & (a[0] == b[0]), (a[0] <= b[1]) & (b[0] <= a[1]))


def not_equal(a: Bounds, b: Bounds) -> Bounds:
    """Truth of ``a != b``."""
    return negated(equal(a, b))


def negated(a: Bounds) -> Bounds:
    """Truth of ``a == 0``."""
    return _truth((a[0] == 0) & (a[1] == 0), holds_zero(a))


def both(a: Bounds, b: Bounds) -> Bounds:
    """Truth of ``a != 0 and b != 0``."""
    return minimum(_nonzero(a), _nonzero(b))


def either(a: Bounds, b: Bounds) -> Bounds:
    """Truth of ``a != 0 or b != 0``."""
    return maximum(_nonzero(a), _nonzero(b))


def chosen(condition: Bounds, a: Bounds) -> Bounds:
    """``a`` where the condition is not 0, else 0."""
    never, always = (condition[0] == 0) & (condition[1] == 0), ~holds_zero(condition)
    low = np.where(always, a[0], np.minimum(a[0], 0.0))
    high = np.where(always, a[1], np.maximum(a[1], 0.0))
    return np.where(never, 0.0, low), np.where(never, 0.0, high)


def magnitude(a: Bounds) -> Bounds:
    """Least and greatest absolute value."""
    return np.maximum(np.maximum(a[0], -a[1]), 0.0), np.maximum(-a[0], a[1])


def holds_zero(a: Bounds) -> BoolArray:
    """True where 0 lies between the bounds."""
    return np.asarray((a[0] <= 0) & (a[1] >= 0))


def hull_of(corners: Callable[[FloatArray, FloatArray], FloatArray], a: Bounds, b: Bounds) -> Bounds:
    """Least and greatest value of a function at the corners of two intervals, as computed."""
    return _hull([corners(x, y) for x in a for y in b])


def _hull(corners: list[FloatArray]) -> Bounds:
    return np.minimum.reduce(corners), np.maximum.reduce(corners)


def _sign(a: Bounds) -> FloatArray:
    """1 where a is not negative, -1 where it is not positive, NaN where it may be either; 0 where it is 0."""
    one_sided = np.where(a[0] >= 0, np.where(a[1] == 0, 0.0, 1.0), -1.0)
    return np.where((a[0] < 0) & (a[1] > 0), np.nan, one_sided)


def _signs(a: Bounds, b: Bounds) -> FloatArray:
    """The sign of a product or quotient."""
    first, second = _sign(a), _sign(b)
    return np.where((first == 0) | (second == 0), 0.0, first * second)


def signed(low: FloatArray, high: FloatArray, sign: FloatArray) -> Bounds:
    """Bounds of a result whose sign is known, NaN where it is not: rounding must not make it straddle 0."""
    return np.where(sign >= 0, np.maximum(low, 0.0), low), np.where(sign <= 0, np.minimum(high, 0.0), high)


def _truth(certain: BoolArray, possible: BoolArray) -> Bounds:
    return certain.astype(np.float64), possible.astype(np.float64)


def _nonzero(a: Bounds) -> Bounds:
    return negated(negated(a))


def _down(value: FloatArray) -> FloatArray:
    return np.nextafter(value, -np.inf)


def _up(value: FloatArray) -> FloatArray:
    return np.nextafter(value, np.inf)


def _not_above(value: FloatArray) -> FloatArray:
    """A lower bound that has overflown, back among the numbers."""
    return np.minimum(value, np.finfo(np.float64).max)


def _not_below(value: FloatArray) -> FloatArray:
    return np.maximum(value, -np.finfo(np.float64).max)
