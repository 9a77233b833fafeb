"""Interval rules of the elementary functions, which floating point does not round correctly.

The vector kernels that NumPy may use instead of the C library are meant to be off by no more than 4 ulps, and no error
of the GNU library of 3 ulps or more is known [GIM+24], which is what a search found and no bound. Every value is
widened by 8 ulps, twice the greater of the two. Where an argument was reduced by a multiple of π/2, the reduction may
leave an absolute error of its own, so that a sine or cosine is widened by ``8 * 2^-52`` altogether.
A rule needs no more than this and the function being monotone between known places; see ``rules`` for the conventions.
"""

from collections.abc import Callable

import numpy as np
from scipy.special import erf as error_function

from reach_server.predicates.rules import Bounds, absolute, hull_of, magnitude
from reach_server.sets.arrays import Array, Mask
from reach_server.sets.intervals import EPS

#: Units in the last place by which a computed value is widened.
ULPS = 8
#: Beyond this a sine, cosine or tangent is not looked at.
FARTHEST = 1e8
#: Below this an argument of a sine or cosine is not reduced.
_UNREDUCED = 0.75
#: Exponents that are surely whole numbers with a parity.
_WHOLE = 2.0**53


def rising(
    function: Callable[[Array], Array], least: float = -np.inf, most: float = np.inf
) -> Callable[[Bounds], Bounds]:
    """The rule of a function that rises, with values from ``least`` to ``most``."""

    def rule(a: Bounds) -> Bounds:
        return _within(lowered(function(a[0])), raised(function(a[1])), least, most)

    return rule


def arccosine(a: Bounds) -> Bounds:
    """The arc cosine on [-1, 1]."""
    return _within(lowered(np.arccos(a[1])), raised(np.arccos(a[0])), 0.0, np.inf)


def hyperbolic_cosine(a: Bounds) -> Bounds:
    """The hyperbolic cosine."""
    least, most = magnitude(a)
    return _within(lowered(np.cosh(least)), raised(np.cosh(most)), 1.0, np.inf)


def hypotenuse(a: Bounds, b: Bounds) -> Bounds:
    """``sqrt(a² + b²)``."""
    (low, high), (less, more) = absolute(a), absolute(b)
    return _within(lowered(np.hypot(low, less)), raised(np.hypot(high, more)), 0.0, np.inf)


def cosine(a: Bounds) -> Bounds:
    """The cosine; [-1, 1] beyond ``FARTHEST``."""
    return _wave(np.cos, a, 0.0)


def sine(a: Bounds) -> Bounds:
    """The sine; [-1, 1] beyond ``FARTHEST``."""
    return _wave(np.sin, a, np.pi / 2)


def _wave(function: Callable[[Array], Array], a: Bounds, crest: float) -> Bounds:
    """A function of period 2π with values in [-1, 1], its greatest at ``crest`` and its least half a period on."""
    far = ~(_size(a) <= FARTHEST)
    near = np.where(far, 0.0, a[0]), np.where(far, 0.0, a[1])
    low, high = (function(x) for x in near)
    error = ULPS * EPS * np.where(_size(near) > _UNREDUCED, 1.0, np.maximum(np.abs(low), np.abs(high)))
    top = _passes(near, crest, 2 * np.pi) | far
    bottom = _passes(near, crest + np.pi, 2 * np.pi) | far
    lower = np.where(bottom, -1.0, np.minimum(low, high) - error - _TINY)
    upper = np.where(top, 1.0, np.maximum(low, high) + error + _TINY)
    return _within(lower, upper, -1.0, 1.0)


def tangent(a: Bounds) -> Bounds:
    """The tangent between two poles. An error δ of the reduction moves the value by ``δ(1 + tan²)``."""
    low, high = np.tan(a[0]), np.tan(a[1])

    def error(argument: Array, value: Array) -> Array:
        reduced = np.abs(argument) > _UNREDUCED
        return np.asarray(ULPS * EPS * np.where(reduced, 1 + value**2, np.abs(value)) + _TINY)

    return low - error(a[0], low), high + error(a[1], high)


def holds_pole(a: Bounds) -> Mask:
    """True where a tangent may have a pole, or is too far out to say."""
    far = ~(_size(a) <= FARTHEST)
    near = np.where(far, 0.0, a[0]), np.where(far, 0.0, a[1])
    return _passes(near, np.pi / 2, np.pi) | far


def angle(y: Bounds, x: Bounds) -> Bounds:
    """``atan2(y, x)``: a box without the origin and off the branch cut has its extreme angles at corners."""
    low, high = hull_of(np.arctan2, y, x)
    cut = crosses_branch(y, x)
    turn = raised(np.asarray(np.pi))
    return _within(np.where(cut, -turn, lowered(low)), np.where(cut, turn, raised(high)), -turn, turn)


def crosses_branch(y: Bounds, x: Bounds) -> Mask:
    """True where a box meets the half-line on which ``atan2`` jumps by a turn."""
    return np.asarray((y[0] <= 0) & (y[1] >= 0) & (x[0] <= 0))


def power(base: Bounds, exponent: Bounds) -> Bounds:
    """``base ^ exponent``: of any base where the exponent is one whole number, else of one that is not negative.

    On positive bases it is monotone in each argument, so that corners are extreme.
    """
    positive = np.maximum(base[0], 0.0), np.maximum(base[1], 0.0)
    low, high = hull_of(np.power, positive, exponent)
    low, high = np.maximum(lowered(low), 0.0), raised(high)
    whole = _is_whole(exponent)
    if not whole.any():
        return low, high
    n = np.where(whole, exponent[0], 1.0)
    least, most = magnitude(base)
    small, large = hull_of(np.power, (least, most), (n, n))
    small, large = np.maximum(lowered(small), 0.0), raised(large)
    first, last = (np.sign(x) * np.power(np.abs(x), n) for x in base)
    # Odd powers rise; odd negative ones fall on each side of the pole.
    rises = n > 0
    odd = lowered(np.where(rises, first, last)), raised(np.where(rises, last, first))
    even = n % 2 == 0
    whole_low = np.where(n == 0, 1.0, np.where(even, small, odd[0]))
    whole_high = np.where(n == 0, 1.0, np.where(even, large, odd[1]))
    return np.where(whole, whole_low, low), np.where(whole, whole_high, high)


def power_undefined(base: Bounds, exponent: Bounds) -> Mask:
    """True where ``power`` is not defined on all of a box."""
    whole = _is_whole(exponent)
    pole = (exponent[0] < 0) & (base[0] <= 0) & (base[1] >= 0)
    defined = (base[0] > 0) | ((base[0] >= 0) & (exponent[0] > 0))
    return np.where(whole, pole, ~defined)


def _is_whole(exponent: Bounds) -> Mask:
    n = exponent[0]
    return np.asarray((n == exponent[1]) & (np.abs(n) < _WHOLE) & (np.floor(n) == n))


erf = rising(error_function, -1.0, 1.0)

#: The smallest results are rounded on a grid of their own.
_TINY = 2 * ULPS * float(np.finfo(np.float64).smallest_subnormal)


def lowered(value: Array) -> Array:
    """A number below what a computed value stands for."""
    wide = np.abs(value) * (ULPS * EPS) + _TINY
    return np.where(np.isinf(value), np.nextafter(value, -np.inf), value - wide)


def raised(value: Array) -> Array:
    """A number above what a computed value stands for."""
    return -lowered(-value)


def _within(low: Array, high: Array, least: float | Array, most: float | Array) -> Bounds:
    """Bounds cut to the range of the function."""
    return np.maximum(low, least), np.minimum(high, most)


def _size(a: Bounds) -> Array:
    return np.maximum(np.abs(a[0]), np.abs(a[1]))


def _passes(a: Bounds, place: float, period: float) -> Mask:
    """Whether ``place`` plus some number of periods may lie between the bounds, by more than the rounding of both."""
    slack = ULPS * EPS * (4.0 + _size(a))
    return np.asarray(np.floor((a[1] - place + slack) / period) >= np.ceil((a[0] - place - slack) / period))
