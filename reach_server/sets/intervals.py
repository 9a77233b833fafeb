"""Interval arithmetic on arrays, rounded outwards: what is computed holds every value that it must hold."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from reach_server.sets.arrays import Array, Mask, SetError, batch_shape, checked

EPS = float(np.finfo(np.float64).eps)


def add_up(a: ArrayLike, b: ArrayLike) -> Array:
    """``a + b`` rounded towards plus infinity; the sum itself where it is a floating-point number."""
    total, error = _two_sum(a, b)
    with np.errstate(all="ignore"):
        return np.where((error == 0.0) | (error < 0), total, np.nextafter(total, np.inf))


def add_down(a: ArrayLike, b: ArrayLike) -> Array:
    """``a + b`` rounded towards minus infinity; the sum itself where it is a floating-point number."""
    total, error = _two_sum(a, b)
    with np.errstate(all="ignore"):
        return np.where((error == 0.0) | (error > 0), total, np.nextafter(total, -np.inf))


def sum_up(values: Array, axis: int = -1) -> Array:
    """Sum of nonnegative numbers, rounded up by k ulps for k + 1 that are not zero; exact for one."""
    rounded = np.maximum((values != 0).sum(axis=axis) - 1, 0)
    return np.asarray(values.sum(axis=axis) * (1.0 + rounded * EPS))


def _two_sum(a: ArrayLike, b: ArrayLike) -> tuple[Array, Array]:
    """The rounded sum and what it lost (Knuth); NaN as the loss where an infinity takes part."""
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    with np.errstate(all="ignore"):
        total = a + b
        back = total - a
        return np.asarray(total), np.asarray((a - (total - back)) + (b - back))


@dataclass(frozen=True, eq=False)
class Interval:
    """Closed intervals ``[lower, upper]`` of any common shape (...,); bounds may be infinite.

    The empty interval is ``[inf, -inf]``; operations hand it on. Interval arithmetic [Moo66] with ``+ - * / @``, unary
    minus and ``abs``, with numbers, too. Every result is an outer bound: it exceeds the exact one by at most 2 ulps per
    rounding (``sum`` of k terms: ``k`` ulps of the sum of their absolute values). Raises ``SetError`` for NaN, where
    ``lower`` is greater than ``upper``, and where a divisor holds zero.
    """

    lower: Array
    upper: Array

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

    def is_empty(self) -> Mask:
        """True where the interval is empty: exact."""
        return np.asarray(self.lower > self.upper)

    @property
    def midpoint(self) -> Array:
        """A number (...,) near the middle of bounded intervals; ``midpoint`` ± ``radius`` is an outer bound of the
        interval. NaN where empty."""
        with np.errstate(all="ignore"):
            return np.asarray(self.lower / 2 + self.upper / 2)

    @property
    def radius(self) -> Array:
        """How far the bounds are from ``midpoint`` (...,): outer, rounded up; NaN where empty."""
        middle = self.midpoint
        return np.maximum(add_up(self.upper, -middle), add_up(middle, -self.lower))

    @property
    def width(self) -> Array:
        """``upper - lower`` (...,): outer, rounded up; -inf where empty."""
        return add_up(self.upper, -self.lower)

    def __getitem__(self, place: Any) -> "Interval":
        return Interval(self.lower[place], self.upper[place])

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

    def contains(self, other: "Interval | ArrayLike") -> Mask:
        """True where the number or interval lies in this one: exact; every interval holds the empty one."""
        b = Interval.of(other)
        return np.asarray((self.lower <= b.lower) & (b.upper <= self.upper) | b.is_empty())


def _made(lower: Array, upper: Array, *operands: Interval) -> Interval:
    """The interval of these bounds, empty where an operand is."""
    empty = np.zeros((), dtype=bool)
    for operand in operands:
        empty = empty | operand.is_empty()
    return Interval(np.where(empty, np.inf, lower), np.where(empty, -np.inf, upper))


def _product(x: Array, y: Array) -> tuple[Array, Array]:
    """``xy`` rounded down and up; 0 times anything, an infinite bound too, is exactly 0."""
    zero = (x == 0) | (y == 0)
    with np.errstate(all="ignore"):
        product = np.asarray(x * y)
        low, high = np.nextafter(product, -np.inf), np.nextafter(product, np.inf)
    return np.where(zero, 0.0, low), np.where(zero, 0.0, high)


def _quotient(x: Array, y: Array) -> tuple[Array, Array]:
    """``x / y`` rounded down and up; 0 divided by anything is exactly 0, and infinity by infinity may be anything of
    its sign: both are limits that a quotient of finite numbers only comes near."""
    with np.errstate(all="ignore"):
        quotient = np.asarray(x / y)
        unknown = np.isinf(x) & np.isinf(y)
        positive = np.sign(x) == np.sign(y)
        low, high = np.nextafter(quotient, -np.inf), np.nextafter(quotient, np.inf)
    low = np.where(unknown, np.where(positive, 0.0, -np.inf), np.where(x == 0, 0.0, low))
    high = np.where(unknown, np.where(positive, np.inf, 0.0), np.where(x == 0, 0.0, high))
    return low, high
