"""Elementary functions of decimal numbers, right to some seventy digits: an oracle that shares nothing with libraries.

Exponential, logarithm and square root are Python's own decimal ones, which are correctly rounded; the rest is made of
them and of Taylor series, summed with more digits than are asked for.
"""

from collections.abc import Callable
from decimal import ROUND_FLOOR, Context, Decimal, getcontext, setcontext
from functools import cache, wraps

#: Digits that an answer has, and those that are computed with.
DIGITS, WORKING = 70, 160

_context = Context(prec=WORKING, Emax=10**7, Emin=-(10**7))
ONE, LARGE = Decimal(1), Decimal(10**5)


def _precise(function: Callable[..., Decimal]) -> Callable[..., Decimal]:
    @wraps(function)
    def precisely(*arguments: Decimal) -> Decimal:
        before = getcontext()
        setcontext(_context)
        try:
            return function(*arguments)
        finally:
            setcontext(before)

    return precisely


def _series(first: Decimal, ratio: Callable[[int], Decimal]) -> Decimal:
    """``first`` and the terms that follow, each the one before times ``ratio(k)``, until they no longer matter."""
    total = term = first
    k = 0
    while term and abs(term) > abs(total).scaleb(-WORKING):
        k += 1
        term *= ratio(k)
        total += term
    return total


@cache
def pi() -> Decimal:
    """π by Machin's formula."""
    before = getcontext()
    setcontext(_context)
    try:
        return 16 * _small_atan(ONE / 5) - 4 * _small_atan(ONE / 239)
    finally:
        setcontext(before)


def _small_atan(x: Decimal) -> Decimal:
    square = -x * x
    return _series(x, lambda k: square * (2 * k - 1) / (2 * k + 1))


def quadrant(x: Decimal) -> tuple[int, Decimal]:
    """Whole multiples of π/2 in x, rounded to the nearest, and what is left."""
    half = pi() / 2
    turns = int((x / half + ONE / 2).to_integral_value(ROUND_FLOOR))
    return turns, x - turns * half


@_precise
def sin(x: Decimal) -> Decimal:
    turns, rest = quadrant(x)
    return _turned(turns, rest)


@_precise
def cos(x: Decimal) -> Decimal:
    turns, rest = quadrant(x)
    return _turned(turns + 1, rest)


def _turned(turns: int, rest: Decimal) -> Decimal:
    square = -rest * rest
    if turns % 2:
        value = _series(ONE, lambda k: square / (2 * k * (2 * k - 1)))
    else:
        value = _series(rest, lambda k: square / (2 * k * (2 * k + 1)))
    return -value if turns % 4 >= 2 else value


@_precise
def tan(x: Decimal) -> Decimal:
    turns, rest = quadrant(x)
    return _turned(turns, rest) / _turned(turns + 1, rest)


@_precise
def atan(x: Decimal) -> Decimal:
    if abs(x) > 1:
        return (pi() / 2).copy_sign(x) - atan(1 / x)
    doubled = 1
    while abs(x) > Decimal("0.05"):
        x /= 1 + (1 + x * x).sqrt()
        doubled *= 2
    return doubled * _small_atan(x)


@_precise
def asin(x: Decimal) -> Decimal:
    if abs(x) == 1:
        return (pi() / 2).copy_sign(x)
    return atan(x / ((1 - x) * (1 + x)).sqrt())


@_precise
def acos(x: Decimal) -> Decimal:
    if x == -1:
        return pi()
    return 2 * atan(((1 - x) / (1 + x)).sqrt())


def _exp(x: Decimal) -> Decimal:
    """Of an exponent so large that no floating-point number is near, that of a smaller one."""
    return max(min(x, LARGE), -LARGE).exp()


@_precise
def exp(x: Decimal) -> Decimal:
    return _exp(x)


@_precise
def expm1(x: Decimal) -> Decimal:
    if abs(x) > 1:
        return _exp(x) - 1
    return _series(x, lambda k: x / (k + 1))


@_precise
def log(x: Decimal) -> Decimal:
    return log1p(x - 1) if abs(x - 1) < Decimal("0.1") else x.ln()


@_precise
def log1p(x: Decimal) -> Decimal:
    if abs(x) > Decimal("0.1"):
        return (1 + x).ln()
    y = x / (2 + x)
    return 2 * _series(y, lambda k: y * y * (2 * k - 1) / (2 * k + 1))


@_precise
def sinh(x: Decimal) -> Decimal:
    if abs(x) > 1:
        return (_exp(x) - _exp(-x)) / 2
    return _series(x, lambda k: x * x / (2 * k * (2 * k + 1)))


@_precise
def cosh(x: Decimal) -> Decimal:
    return (_exp(x) + _exp(-x)) / 2


@_precise
def tanh(x: Decimal) -> Decimal:
    if abs(x) > 1:
        small = (-2 * abs(x)).exp()
        return ((1 - small) / (1 + small)).copy_sign(x)
    return sinh(x) / cosh(x)


@_precise
def asinh(x: Decimal) -> Decimal:
    size = abs(x)
    return log1p(size + size * size / (1 + (1 + size * size).sqrt())).copy_sign(x)


@_precise
def acosh(x: Decimal) -> Decimal:
    return log1p((x - 1) + ((x - 1) * (x + 1)).sqrt())


@_precise
def atanh(x: Decimal) -> Decimal:
    return log1p(2 * x / (1 - x)) / 2


@_precise
def erf(x: Decimal) -> Decimal:
    if abs(x) > 8:
        # Less than 10⁻²⁹ from it.
        return ONE.copy_sign(x) * (1 - Decimal("1e-30"))
    square = -x * x
    return 2 / pi().sqrt() * _series(x, lambda k: square * (2 * k - 1) / (k * (2 * k + 1)))


@_precise
def power(x: Decimal, y: Decimal) -> Decimal:
    if not x:
        return ONE if not y else Decimal(0)
    value = (y * abs(x).ln()).exp()
    return -value if x < 0 and int(y) % 2 else value


@_precise
def hypot(x: Decimal, y: Decimal) -> Decimal:
    return (x * x + y * y).sqrt()


@_precise
def atan2(y: Decimal, x: Decimal) -> Decimal:
    """In (-π, π]; 0 at the origin."""
    if not x:
        return (pi() / 2).copy_sign(y) if y else Decimal(0)
    if x > 0:
        return atan(y / x)
    return atan(y / x) + (pi() if y >= 0 else -pi())
