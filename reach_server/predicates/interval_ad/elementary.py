"""Interval rules of the elementary functions, which floating point does not round correctly.

The vector kernels that NumPy may use instead of the C library are meant to be off by no more than 4 ulps, and no error
of the GNU library of 3 ulps or more is known [GIM+24], which is what a search found and no bound. Every value is
widened by 8 ulps of its own, twice the greater of the two; half an ulp of that is for the reduction of the argument of
a sine, cosine or tangent (``quadrants``). Where a function is exact, as the sine is at 0, so are its bounds, and they
never cross that place. A rule needs no more than this and the function being monotone between known places; see
``rules`` for the conventions.
"""

from collections.abc import Callable

import numpy as np
from scipy.special import erf as error_function

from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.predicates.interval_ad.arithmetic import Bounds, absolute, hull_of, magnitude, signed
from reach_server.predicates.interval_ad.quadrants import FARTHEST, Reduced, passes, reduced

#: Units in the last place by which a computed value is widened.
ULPS = 8
#: Exponents that are surely whole numbers with a parity.
_WHOLE = 2.0**53
#: π is below this.
_TURN = float(np.nextafter(np.pi, np.inf))


def rising(
    function: Callable[[FloatArray], FloatArray],
    least: float = -np.inf,
    most: float = np.inf,
    through: tuple[float, float] | None = None,
) -> Callable[[Bounds], Bounds]:
    """The rule of a function that rises, with values from ``least`` to ``most``, and exact at one place: ``through`` is
    (place, value)."""

    def rule(a: Bounds) -> Bounds:
        low, high = lowered(function(a[0])), raised(function(a[1]))
        if through is not None:
            place, value = through
            low = np.where(a[0] >= place, np.maximum(low, value), low)
            high = np.where(a[1] <= place, np.minimum(high, value), high)
        return _within(low, high, least, most)

    return rule


def arccosine(a: Bounds) -> Bounds:
    """The arc cosine on [-1, 1]."""
    return _within(lowered(np.arccos(a[1])), np.where(a[0] == 1, 0.0, raised(np.arccos(a[0]))), 0.0, _TURN)


def hyperbolic_cosine(a: Bounds) -> Bounds:
    """The hyperbolic cosine."""
    least, most = magnitude(a)
    return _within(lowered(np.cosh(least)), np.where(most == 0, 1.0, raised(np.cosh(most))), 1.0, np.inf)


def hypotenuse(a: Bounds, b: Bounds) -> Bounds:
    """``sqrt(a² + b²)``."""
    (low, high), (less, more) = absolute(a), absolute(b)
    least = np.maximum(lowered(np.hypot(low, less)), np.maximum(low, less))
    return least, np.where((high == 0) & (more == 0), 0.0, raised(np.hypot(high, more)))


def cosine(a: Bounds) -> Bounds:
    """The cosine; [-1, 1] beyond ``FARTHEST``."""
    return _wave(a, 1)


def sine(a: Bounds) -> Bounds:
    """The sine; [-1, 1] beyond ``FARTHEST``."""
    return _wave(a, 0)


def _wave(a: Bounds, ahead: int) -> Bounds:
    """The sine of an argument that is ``ahead`` quarters of a turn further on: greatest one quarter past 0."""
    near, far = _near(a)
    low, high = (reduced(x) for x in near)
    values = [_sine_of(one.turns + ahead, one.rest) for one in (low, high)]
    top = passes(low, high, 1 - ahead, 4) | far
    bottom = passes(low, high, 3 - ahead, 4) | far
    lower = np.where(bottom, -1.0, np.minimum(values[0][0], values[1][0]))
    upper = np.where(top, 1.0, np.maximum(values[0][1], values[1][1]))
    return _within(lower, upper, -1.0, 1.0)


def _sine_of(turns: FloatArray, rest: FloatArray) -> Bounds:
    """Bounds of the sine of ``turns · π/2 + rest``."""
    quarter = np.mod(turns, 4)
    odd = np.mod(turns, 2) == 1
    sign = np.where(quarter >= 2, -1.0, 1.0)
    value = sign * np.where(odd, np.cos(rest), np.sin(rest))
    return signed(lowered(value), raised(value), sign * np.where(odd, 1.0, np.sign(rest)))


def tangent(a: Bounds) -> Bounds:
    """The tangent between two poles; nothing is known beyond ``FARTHEST``."""
    near, far = _near(a)
    (low, _), (_, high) = (_tangent_of(reduced(x)) for x in near)
    return np.where(far, -np.inf, low), np.where(far, np.inf, high)


def _tangent_of(a: Reduced) -> Bounds:
    """Bounds of the tangent of a reduced argument; a rest of 0 means the argument 0, so that none is divided by."""
    value, odd = np.tan(a.rest), np.mod(a.turns, 2) == 1
    value = np.where(odd, -1.0 / np.where(odd, value, 1.0), value)
    return signed(lowered(value), raised(value), np.where(odd, -np.sign(a.rest), np.sign(a.rest)))


def holds_pole(a: Bounds) -> BoolArray:
    """True where a tangent has a pole, or is too far out to say."""
    near, far = _near(a)
    low, high = (reduced(x) for x in near)
    return passes(low, high, 1, 2) | far


def _near(a: Bounds) -> tuple[Bounds, BoolArray]:
    """Bounds with 0 in place of those beyond ``FARTHEST``, and where that is."""
    far = ~(np.maximum(np.abs(a[0]), np.abs(a[1])) <= FARTHEST)
    return (np.where(far, 0.0, a[0]), np.where(far, 0.0, a[1])), np.asarray(far)


def angle(y: Bounds, x: Bounds) -> Bounds:
    """``atan2(y, x)``, 0 at the origin: the extreme angles of a box are at corners unless it goes through the cut.

    On the negative half of the x-axis the angle is π, so that a box above it that touches it has no angle beyond, and a
    box below that touches it has them all.
    """
    y, x = (y[0] + 0.0, y[1] + 0.0), (x[0] + 0.0, x[1] + 0.0)
    low, high = hull_of(np.arctan2, y, x)
    cut = (y[0] < 0) & (y[1] >= 0) & (x[0] < 0)
    above, below = y[0] >= 0, (y[1] < 0) | ((y[1] == 0) & (x[0] >= 0))
    low, high = lowered(low), raised(high)
    low = np.where(cut, -_TURN, np.where(above, np.maximum(low, 0.0), low))
    high = np.where(cut, _TURN, np.where(below, np.minimum(high, 0.0), high))
    return _within(low, high, -_TURN, _TURN)


def crosses_branch(y: Bounds, x: Bounds) -> BoolArray:
    """True where a box meets the half-line on which ``atan2`` jumps by a turn, or the origin."""
    return np.asarray((y[0] <= 0) & (y[1] >= 0) & (x[0] <= 0))


def power(base: Bounds, exponent: Bounds) -> Bounds:
    """``base ^ exponent``: of any base where the exponent is one whole number, else of one that is not negative.

    On positive bases it is monotone in each argument, so that corners are extreme.
    """
    positive = np.maximum(base[0], 0.0), np.maximum(base[1], 0.0)
    low, high = hull_of(np.power, positive, exponent)
    low, high = np.maximum(lowered(low), 0.0), np.where((base[1] <= 0) & (exponent[0] > 0), 0.0, raised(high))
    whole = _is_whole(exponent)
    if not whole.any():
        return low, high
    n = np.where(whole, exponent[0], 1.0)
    least, most = magnitude(base)
    small, large = hull_of(np.power, (least, most), (n, n))
    small, large = np.maximum(lowered(small), 0.0), np.where((most == 0) & (n > 0), 0.0, raised(large))
    first, last = (np.sign(x) * np.power(np.abs(x), n) for x in base)
    # Odd powers rise; odd negative ones fall on each side of the pole.
    rises = n > 0
    odd = lowered(np.where(rises, first, last)), raised(np.where(rises, last, first))
    odd = (
        np.where(base[0] >= 0, np.maximum(odd[0], 0.0), odd[0]),
        np.where(base[1] <= 0, np.minimum(odd[1], 0.0), odd[1]),
    )
    even = n % 2 == 0
    whole_low = np.where(n == 0, 1.0, np.where(even, small, odd[0]))
    whole_high = np.where(n == 0, 1.0, np.where(even, large, odd[1]))
    return np.where(whole, whole_low, low), np.where(whole, whole_high, high)


def power_undefined(base: Bounds, exponent: Bounds) -> BoolArray:
    """True where ``power`` is not defined on all of a box."""
    whole = _is_whole(exponent)
    pole = (exponent[0] < 0) & (base[0] <= 0) & (base[1] >= 0)
    defined = (base[0] > 0) | ((base[0] >= 0) & (exponent[0] > 0))
    return np.where(whole, pole, ~defined)


def _is_whole(exponent: Bounds) -> BoolArray:
    n = exponent[0]
    return np.asarray((n == exponent[1]) & (np.abs(n) < _WHOLE) & (np.floor(n) == n))


erf = rising(error_function, -1.0, 1.0, (0.0, 0.0))

#: The smallest results are rounded on a grid of their own.
_TINY = 2 * ULPS * float(np.finfo(np.float64).smallest_subnormal)


def lowered(value: FloatArray) -> FloatArray:
    """A number below what a computed value stands for."""
    wide = np.abs(value) * (ULPS * EPS) + _TINY
    return np.where(np.isinf(value), np.nextafter(value, -np.inf), value - wide)


def raised(value: FloatArray) -> FloatArray:
    """A number above what a computed value stands for."""
    return -lowered(-value)


def _within(low: FloatArray, high: FloatArray, least: float | FloatArray, most: float | FloatArray) -> Bounds:
    """Bounds cut to the range of the function."""
    return np.maximum(low, least), np.minimum(high, most)
