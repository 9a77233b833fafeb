"""The functions that a formula may call, each with all that is said about it: the one table that parser, exact
arithmetic, pictures and the server's enclosures read.

A function that is made of operations of CasADi is known everywhere once it stands here.
"""

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from typing import Any, Final, Literal

import numpy as np

#: What an operand must be for its operation to be defined.
Demand = Literal["nonzero", "nonnegative", "positive"]
#: Numbers to a number; raises ``NoNumberError`` where there is none.
Exact = Callable[[Sequence[Fraction]], Fraction]

# A power of a power of a power would fill the memory with digits.
MAX_BITS: Final = 4_000


class NoNumberError(ValueError):
    """A function has no value at the numbers given, or none that can be written down; the text says why."""


@dataclass(frozen=True, slots=True)
class Function:
    """A function of the scenario language.

    Attributes:
        exact: its value at rational numbers, exact where it is rational, else of double precision or better.
        array: its value at arrays of doubles, elementwise.
        graph: its value as a graph, from the module ``casadi`` and the graphs of its arguments. Handed in, so that
            whoever only reads scenarios need not load CasADi.
        least: the least number of arguments.
        most: the largest number of arguments, None for any.
        needs: what it demands, and of which graph, made as ``graph`` is; None where it is defined everywhere.
        smooth: twice continuously differentiable, or else enclosed as it is. One that is not is replaced by its
            branches, case by case: inequality.py has to know them.
        periodic: has the period of a whole turn, so that its argument may be an angle.
    """

    exact: Exact
    array: Callable[..., Any]
    graph: Callable[..., Any]
    least: int = 1
    most: int | None = 1
    needs: tuple[Demand, Callable[..., Any]] | None = None
    smooth: bool = True
    periodic: bool = False


def root(value: Fraction) -> Fraction:
    """Square root: exact if it is rational, else to more digits than a double has."""
    p, q = value.numerator, value.denominator
    shift = 0
    if math.isqrt(p) ** 2 != p or math.isqrt(q) ** 2 != q:
        # sqrt(p / q) = sqrt(p q 4^s) / (q 2^s), s large enough for more digits than a double has
        shift = max(0, 64 - (p * q).bit_length() // 2)
        p, q = p * q << 2 * shift, q * q << 2 * shift
    return Fraction(math.isqrt(p), math.isqrt(q))


def bits(value: Fraction) -> int:
    """How many bits numerator and denominator have at most."""
    return max(value.numerator.bit_length(), value.denominator.bit_length())


def nearest_double(value: Fraction) -> float:
    """Nearest double; raise ``NoNumberError`` if that is infinite, or zero where ``value`` is not."""
    try:
        double = float(value)
    except OverflowError:
        double = math.inf
    if math.isinf(double) or (value and not double):
        raise NoNumberError("a number leaves the range of double precision")
    return double


def of_doubles(function: Callable[..., float]) -> Exact:
    """The function of the nearest doubles, to the last bits."""

    def exact(values: Sequence[Fraction]) -> Fraction:
        doubles = [nearest_double(value) for value in values]
        try:
            return Fraction(float(function(*doubles)))
        except (OverflowError, ValueError):
            raise NoNumberError("a number leaves the range of double precision") from None

    return exact


def _defined(name: str, holds: Callable[[Fraction], bool], inner: Exact) -> Exact:
    """``inner`` where its first argument is one that it has a value at."""

    def exact(values: Sequence[Fraction]) -> Fraction:
        if not holds(values[0]):
            raise NoNumberError(f"{name} of {nearest_double(values[0]):g} is no number")
        return inner(values)

    return exact


def _sum_of_squares(name: str, then: Callable[[Fraction], Fraction]) -> Exact:
    def exact(values: Sequence[Fraction]) -> Fraction:
        if max(map(bits, values)) > MAX_BITS:
            raise NoNumberError(f"the argument of {name} has too many digits")
        return then(sum((value * value for value in values), Fraction(0)))

    return exact


def _squares(*parts: Any) -> Any:
    """Sum of the squares, in the order given."""
    return reduce(operator.add, (part * part for part in parts))


def _norm(name: str) -> Function:
    return Function(
        _sum_of_squares(name, root),
        lambda *parts: np.sqrt(_squares(*parts)),
        lambda casadi, *parts: casadi.sqrt(_squares(*parts)),
        most=None,
    )


FUNCTIONS: Final[Mapping[str, Function]] = {
    "abs": Function(lambda v: abs(v[0]), np.abs, lambda c, x: c.fabs(x), smooth=False),
    "sqrt": Function(
        _defined("sqrt", lambda x: x >= 0, lambda v: root(v[0])), np.sqrt, lambda c, x: c.sqrt(x),
        needs=("nonnegative", lambda _, x: x),
    ),
    "exp": Function(of_doubles(math.exp), np.exp, lambda c, x: c.exp(x)),
    "log": Function(
        _defined("log", lambda x: x > 0, of_doubles(math.log)), np.log, lambda c, x: c.log(x),
        needs=("positive", lambda _, x: x),
    ),
    "sin": Function(of_doubles(math.sin), np.sin, lambda c, x: c.sin(x), periodic=True),
    "cos": Function(of_doubles(math.cos), np.cos, lambda c, x: c.cos(x), periodic=True),
    "tan": Function(
        of_doubles(math.tan), np.tan, lambda c, x: c.tan(x), needs=("nonzero", lambda c, x: c.cos(x)), periodic=True
    ),
    "atan2": Function(of_doubles(math.atan2), np.arctan2, lambda c, y, x: c.atan2(y, x), least=2, most=2),
    "hypot": _norm("hypot"),
    "norm": _norm("norm"),
    "sumsqr": Function(_sum_of_squares("sumsqr", lambda v: v), _squares, lambda _, *parts: _squares(*parts), most=None),
    "min": Function(
        min, lambda *parts: reduce(np.minimum, parts), lambda c, *parts: reduce(c.fmin, parts), most=None, smooth=False
    ),
    "max": Function(
        max, lambda *parts: reduce(np.maximum, parts), lambda c, *parts: reduce(c.fmax, parts), most=None, smooth=False
    ),
}  # fmt: skip
