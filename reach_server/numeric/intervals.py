"""Interval arithmetic on arrays, rounded outwards: what is computed holds every value that it must hold."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from reach_server.numeric.checks import SetError, batch_shape, checked
from reach_server.numeric.rounding import EPS, add_down, add_up
from reach_server.numeric.types import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class Interval:
    """Closed intervals ``[lower, upper]`` of any common shape (...,); bounds may be infinite.

    The empty interval is ``[inf, -inf]``; operations hand it on. Interval arithmetic [Moo66] with ``+ - * / @``, unary
    minus and ``abs``, with numbers, too. Every result is an outer bound: it exceeds the exact one by at most 2 ulps per
    rounding (``sum`` of k terms: ``k`` ulps of the sum of their absolute values). Raises ``SetError`` for NaN, where
    ``lower`` is greater than ``upper``, and where a divisor holds zero.
    """

    lower: FloatArray
    upper: FloatArray

    # NumPy leaves ``array + interval`` to the interval.
    __array_ufunc__ = None

    def __post_init__(self) -> None:
        lower, upper = checked(self.lower, "lower", (), infinite=True), checked(self.upper, "upper", (), infinite=True)
        shape = batch_shape((lower, 0), (upper, 0))
        if ((lower > upper) & ~(np.isposinf(lower) & np.isneginf(upper))).any():
            raise SetError("lower is greater than upper somewhere; the empty interval is [inf, -inf]")
        for name, value in (("lower", lower), ("upper", upper)):
            value = np.broadcast_to(value, shape)
            object.__setattr__(self, name, value)

    @classmethod
    def of(cls, value: "Interval | ArrayLike") -> "Interval":
        """The value (...,) as an interval: exact; numbers become intervals of width 0."""
        if isinstance(value, Interval):
            return value
        number = checked(value, "value", ())
        return cls(number, number)

    @classmethod
    def empty(cls, shape: tuple[int, ...] = ()) -> Self:
        """Empty intervals of that shape: exact."""
        return cls(np.full(shape, np.inf), np.full(shape, -np.inf))

    @property
    def shape(self) -> tuple[int, ...]:
        """The common shape of the bounds."""
        return self.lower.shape

    def is_empty(self) -> BoolArray:
        """True where the interval is empty: exact."""
        return np.asarray(self.lower > self.upper)

    @property
    def midpoint(self) -> FloatArray:
        """A number (...,) near the middle; the bound that is finite where one is not, 0 where neither is. ``midpoint``
        ± ``radius`` is an outer bound of the interval. NaN where empty."""
        with np.errstate(all="ignore"):
            middle = self.lower / 2 + self.upper / 2
            if np.isfinite(middle).all():
                return np.asarray(middle)
            low, high = np.isfinite(self.lower), np.isfinite(self.upper)
            end = np.where(low, self.lower, np.where(high, self.upper, 0.0))
            return np.asarray(np.where(self.is_empty(), np.nan, np.where(low & high, middle, end)))

    @property
    def radius(self) -> FloatArray:
        """How far the bounds are from ``midpoint`` (...,): outer, rounded up; infinite where a bound is, NaN where
        empty."""
        middle = self.midpoint
        return np.maximum(add_up(self.upper, -middle), add_up(middle, -self.lower))

    @property
    def width(self) -> FloatArray:
        """``upper - lower`` (...,): outer, rounded up; -inf where empty."""
        return add_up(self.upper, -self.lower)

    def __getitem__(self, index: Any) -> "Interval":
        return Interval(self.lower[index], self.upper[index])

    def __neg__(self) -> "Interval":
        return Interval(-self.upper, -self.lower)

    def __add__(self, other: "Interval | ArrayLike") -> "Interval":
        b = Interval.of(other)
        return _made(add_down(self.lower, b.lower), add_up(self.upper, b.upper), self, b)

    __radd__ = __add__

    def __sub__(self, other: "Interval | ArrayLike") -> "Interval":
        return self + -Interval.of(other)

    def __rsub__(self, other: "Interval | ArrayLike") -> "Interval":
        return Interval.of(other) + -self

    def __mul__(self, other: "Interval | ArrayLike") -> "Interval":
        b = Interval.of(other)
        corners = [_product(x, y) for x in (self.lower, self.upper) for y in (b.lower, b.upper)]
        lower = np.minimum.reduce([low for low, _ in corners])
        return _made(lower, np.maximum.reduce([high for _, high in corners]), self, b)

    __rmul__ = __mul__

    def __truediv__(self, other: "Interval | ArrayLike") -> "Interval":
        b = Interval.of(other)
        if ((b.lower <= 0) & (b.upper >= 0)).any():
            raise SetError("the divisor holds zero somewhere")
        corners = [_quotient(x, y) for x in (self.lower, self.upper) for y in (b.lower, b.upper)]
        lower = np.minimum.reduce([low for low, _ in corners])
        return _made(lower, np.maximum.reduce([high for _, high in corners]), self, b)

    def __rtruediv__(self, other: "Interval | ArrayLike") -> "Interval":
        return Interval.of(other) / self

    def sqr(self) -> "Interval":
        """``{x² : x in the interval}``: outer, by rounding only; never negative, unlike ``self * self``."""
        size = abs(self)
        return _made(
            np.maximum(_product(size.lower, size.lower)[0], 0.0), _product(size.upper, size.upper)[1], self, self
        )

    def __abs__(self) -> "Interval":
        low = np.maximum(np.maximum(self.lower, -self.upper), 0.0)
        return _made(low, np.maximum(-self.lower, self.upper), self, self)

    def sum(self, axis: int = -1) -> "Interval":
        """Sum over an axis: outer, by rounding only."""
        empty = self.is_empty().any(axis=axis)
        bounds = []
        for value, sign in ((self.lower, -1.0), (self.upper, 1.0)):
            terms = np.maximum((value != 0).sum(axis=axis) - 1, 0)
            with np.errstate(all="ignore"):
                margin = np.where(terms > 0, terms * EPS * np.abs(value).sum(axis=axis), 0.0)
                total = value.sum(axis=axis)
                total = np.where(terms > 0, np.nextafter(total + sign * margin, sign * np.inf), total)
            # Where infinities or an overflow met, nothing is known on this side.
            unknown = np.isnan(total) | (np.isinf(total) & (np.sign(total) != sign))
            bounds.append(np.where(unknown, sign * np.inf, total))
        return Interval(np.where(empty, np.inf, bounds[0]), np.where(empty, -np.inf, bounds[1]))

    def linear_map(self, matrix: "Interval | ArrayLike") -> "Interval":
        """The product of ``matrix`` (..., m, k), of numbers or intervals, and vectors (..., k): outer, shape (..., m).

        The bounds of each component are the least ones but for rounding. Raises ``SetError`` for shapes that have no
        product.
        """
        m = Interval.of(matrix)
        if len(m.shape) < 2 or not self.shape or m.shape[-1] != self.shape[-1]:
            raise SetError(f"matrix has shape {m.shape}, expected (..., m, {(self.shape or ('k',))[-1]})")
        return (m * self[..., None, :]).sum(axis=-1)

    def __matmul__(self, other: "Interval | ArrayLike") -> "Interval":
        """The product of matrices (..., m, k) and (..., k, p), of numbers or intervals: shape (..., m, p)."""
        b = Interval.of(other)
        if len(self.shape) < 2 or len(b.shape) < 2 or self.shape[-1] != b.shape[-2]:
            raise SetError(f"matrices of shapes {self.shape} and {b.shape} have no product")
        return (self[..., :, :, None] * b[..., None, :, :]).sum(axis=-2)

    def __rmatmul__(self, other: ArrayLike) -> "Interval":
        return Interval.of(other) @ self

    def hull(self, other: "Interval | ArrayLike") -> "Interval":
        """The least interval around both: exact."""
        b = Interval.of(other)
        return Interval(np.minimum(self.lower, b.lower), np.maximum(self.upper, b.upper))

    def intersection(self, other: "Interval | ArrayLike") -> "Interval":
        """What both hold: exact; empty where they are disjoint."""
        b = Interval.of(other)
        lower, upper = np.maximum(self.lower, b.lower), np.minimum(self.upper, b.upper)
        return Interval(np.where(lower > upper, np.inf, lower), np.where(lower > upper, -np.inf, upper))

    def contains(self, other: "Interval | ArrayLike") -> BoolArray:
        """True where the number or interval lies in this one: exact; every interval holds the empty one."""
        b = Interval.of(other)
        return np.asarray((self.lower <= b.lower) & (b.upper <= self.upper) | b.is_empty())


def _made(lower: FloatArray, upper: FloatArray, *operands: Interval) -> Interval:
    """The interval of these bounds, empty where an operand is."""
    empty = np.zeros((), dtype=bool)
    for operand in operands:
        empty = empty | operand.is_empty()
    return Interval(np.where(empty, np.inf, lower), np.where(empty, -np.inf, upper))


def _product(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``xy`` rounded down and up, never across 0; 0 times anything, an infinite bound too, is exactly 0."""
    with np.errstate(all="ignore"):
        return _around(np.asarray(x * y), np.sign(x) * np.sign(y))


def _quotient(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``x / y`` rounded down and up, never across 0; 0 divided by anything is exactly 0, and infinity by infinity may
    be anything of its sign: both are limits that a quotient of finite numbers only comes near."""
    with np.errstate(all="ignore"):
        low, high = _around(np.asarray(x / y), np.sign(x) * np.sign(y))
        unknown, positive = np.isinf(x) & np.isinf(y), np.sign(x) == np.sign(y)
    low = np.where(unknown, np.where(positive, 0.0, -np.inf), low)
    return low, np.where(unknown, np.where(positive, np.inf, 0.0), high)


def _around(value: FloatArray, sign: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The numbers below and above one that was rounded, and whose sign is known."""
    low, high = np.nextafter(value, -np.inf), np.nextafter(value, np.inf)
    low = np.where(sign > 0, np.maximum(low, 0.0), np.where(sign == 0, 0.0, low))
    return low, np.where(sign < 0, np.minimum(high, 0.0), np.where(sign == 0, 0.0, high))
