"""Verbs that zonotopes and constrained zonotopes answer alike: affine images, boxes, membership, planar questions.

Both are affine images ``c + Gβ`` of a set of factors β; what is here acts on c and G, whatever ties the factors down.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from reach_server.numeric.checks import (
    SetError,
    batch_shape,
    checked,
    checked_axes,
    checked_batch,
    checked_bounds,
    checked_count,
    checked_dimension,
)
from reach_server.numeric.intervals import Interval
from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.sets.kernels import membership
from reach_server.sets.parts import Parts


class SharedVerbs(ABC):
    """The set ``{c + Gβ}`` of ``center`` c (..., n) and ``generators`` G (..., n, g), for some set of factors β."""

    center: FloatArray
    generators: FloatArray

    @classmethod
    @abstractmethod
    def _free(cls, center: FloatArray, generators: FloatArray) -> Self:
        """The set over all factors ``|β| <= 1``."""

    @abstractmethod
    def _with(self, center: FloatArray, generators: FloatArray) -> Self:
        """The set over the same factors with another center and other generators, made by an exact operation."""

    @property
    @abstractmethod
    def _parts(self) -> Parts:
        """The set as plain arrays."""

    @abstractmethod
    def _own_axes(self) -> tuple[tuple[FloatArray, int], ...]:
        """The arrays of the set with the number of their own axes."""

    @abstractmethod
    def volume(self) -> FloatArray:
        """Volume (...): exact where it can be told, else the outer end of ``volume_bracket``."""

    @abstractmethod
    def volume_bracket(self) -> tuple[FloatArray, FloatArray]:
        """(inner, outer) bounds (...) of the volume."""

    @classmethod
    def box(cls, lower: ArrayLike, upper: ArrayLike) -> Self:
        """The box from ``lower`` to ``upper`` (..., n): exact, half-widths rounded outwards by 1 ulp where they are no
        floating-point numbers.

        Raises ``SetError`` where ``lower`` is greater than ``upper``.
        """
        high = checked_dimension(checked(upper, "upper", (None,)), -1, "upper")
        low = checked(lower, "lower", (high.shape[-1],))
        checked_batch(low, 1, "lower", high.shape[:-1])
        if (low > high).any():
            raise SetError("lower is greater than upper somewhere")
        return cls.from_interval(Interval(low, high))

    @classmethod
    def from_interval(cls, interval: Interval | tuple[ArrayLike, ArrayLike]) -> Self:
        """The box of ``interval``, an ``Interval`` of shape (..., n) or a pair (lower, upper) of such: exact, as
        ``box``.

        Raises ``SetError`` for empty and for unbounded intervals.
        """
        if not isinstance(interval, Interval):
            interval = Interval(*checked_bounds(interval, "interval", (None,)))
        checked_dimension(checked(interval.lower, "interval", (None,), infinite=True), -1, "interval")
        if interval.is_empty().any():
            raise SetError("interval is empty somewhere: a zonotope is not")
        if not (np.isfinite(interval.lower) & np.isfinite(interval.upper)).all():
            raise SetError("interval is unbounded somewhere: a zonotope is not")
        return cls._free(interval.midpoint, interval.radius[..., None] * np.eye(interval.shape[-1]))

    @classmethod
    def point(cls, x: ArrayLike) -> Self:
        """The set of the point ``x`` (..., n) alone: exact."""
        center = checked_dimension(checked(x, "x", (None,)), -1, "x")
        return cls._free(center, np.zeros((center.shape[-1], 0)))

    @property
    def batch(self) -> tuple[int, ...]:
        """The batch axes."""
        return batch_shape(*self._own_axes())

    @property
    def dimension(self) -> int:
        """The dimension n of the space."""
        return int(self.center.shape[-1])

    def linear_map(self, matrix: ArrayLike) -> Self:
        """The image under ``matrix`` (..., k, n): exact."""
        m = checked_dimension(self._matrix(matrix), -2, "matrix")
        return self._with((m @ self.center[..., None])[..., 0], m @ self.generators)

    def affine_map(self, matrix: ArrayLike, offset: ArrayLike) -> Self:
        """The image ``{Mx + t}`` for ``matrix`` (..., k, n) and ``offset`` (..., k): exact."""
        return self.linear_map(matrix).translate(offset)

    def scale(self, factor: ArrayLike) -> Self:
        """The set of ``factor * x`` for ``factor`` (...), of either sign: exact."""
        f = self._argument(factor, "factor", ())
        return self._with(f[..., None] * self.center, f[..., None, None] * self.generators)

    def translate(self, offset: ArrayLike) -> Self:
        """The set moved by ``offset`` (..., n): exact."""
        return self._with(self.center + self._argument(offset, "offset", (self.dimension,)), self.generators)

    def project(self, axes: Sequence[int]) -> Self:
        """The projection on the coordinates ``axes``, in that order: exact."""
        kept = checked_axes(axes, self.dimension)
        return self._with(self.center[..., kept], self.generators[..., kept, :])

    def area(self) -> FloatArray:
        """Area (...) of planar sets: exact; of a constrained set up to 1e-9 of the squared extent, never below the true
        area. Raises ``SetError`` in other dimensions."""
        self._planar("area")
        return self.volume()

    def area_bracket(self) -> tuple[FloatArray, FloatArray]:
        """(inner, outer) bounds (...) of the area of planar sets: the exact area, apart by rounding; of a constrained
        set that of the hull of attained points, less what these may lie outside, and that of ``polygon()``."""
        self._planar("area_bracket")
        return self.volume_bracket()

    def contains_point(self, x: ArrayLike) -> BoolArray:
        """True (...) where the point ``x`` (..., n) lies in the set: exact up to 1e-7 of its size."""
        return self._reach(x)[0]

    def factors_of(self, x: ArrayLike) -> FloatArray:
        """Factors β (..., g) with ``c + Gβ = x``, ``|β| <= 1`` and the constraints, if there are any, for the point
        ``x`` (..., n): exact up to 1e-7 of the set's size; rows of NaN where the point is not in the set."""
        return self._reach(x)[1]

    def _reach(self, x: ArrayLike) -> tuple[BoolArray, FloatArray]:
        return membership.reach(*self._parts, self._argument(x, "x", (self.dimension,)))

    def _argument(
        self, value: ArrayLike, name: str, tail: tuple[int | None, ...], *, infinite: bool = False
    ) -> FloatArray:
        """A checked argument whose batch axes go with those of the set."""
        array = checked(value, name, tail, infinite=infinite)
        return array if array.ndim == len(tail) else checked_batch(array, len(tail), name, self.batch)

    def _matrix(self, matrix: ArrayLike) -> FloatArray:
        return self._argument(matrix, "matrix", (None, self.dimension))

    def _planar(self, verb: str) -> None:
        if self.dimension != 2:
            raise SetError(f"{verb} needs a planar set, this one has dimension {self.dimension}: project it first")

    def _corners(self, count: int) -> int:
        """``count``, if a polygon can have so many vertices."""
        if checked_count(count, "count") < 3:
            raise SetError(f"count is {count}, expected no less than 3")
        return count
