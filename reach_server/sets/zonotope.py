"""``Zonotope``: ``{c + Gβ : |β| <= 1}``, any number of leading batch axes."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from reach_server.sets import membership, planar, reduction, strips, support
from reach_server.sets.arrays import Array, SetError, batch_shape, block_diagonal, checked, stack_columns


@dataclass(frozen=True, eq=False)
class Zonotope:
    """Zonotopes with ``center`` (..., n) and ``generators`` (..., n, g); never empty.

    Raises ``SetError`` for wrong shapes, NaN or infinities, and for dimension 0.
    """

    center: Array
    generators: Array

    def __post_init__(self) -> None:
        center = checked(self.center, "center", (None,))
        generators = checked(self.generators, "generators", (center.shape[-1], None))
        if center.shape[-1] == 0:
            raise SetError(f"center has shape {center.shape}: a set needs at least one dimension")
        batch_shape((center, 1), (generators, 2))
        object.__setattr__(self, "center", center)
        object.__setattr__(self, "generators", generators)

    @classmethod
    def box(cls, lower: ArrayLike, upper: ArrayLike) -> Self:
        """The box from ``lower`` to ``upper`` (..., n), exact up to rounding."""
        low, high = checked(lower, "lower", (None,)), checked(upper, "upper", (None,))
        if (low > high).any():
            raise SetError("lower is greater than upper somewhere")
        half = (high - low) / 2
        return cls((low + high) / 2, half[..., None] * np.eye(half.shape[-1]))

    @property
    def batch(self) -> tuple[int, ...]:
        """The batch axes."""
        return batch_shape((self.center, 1), (self.generators, 2))

    @property
    def dimension(self) -> int:
        """The dimension n of the space."""
        return int(self.center.shape[-1])

    def linear_map(self, matrix: ArrayLike) -> Self:
        """The image under ``matrix`` (..., k, n): exact."""
        m = checked(matrix, "matrix", (None, self.dimension))
        return type(self)((m @ self.center[..., None])[..., 0], m @ self.generators)

    def translate(self, offset: ArrayLike) -> Self:
        """The set moved by ``offset`` (..., n): exact."""
        return type(self)(self.center + checked(offset, "offset", (self.dimension,)), self.generators)

    def project(self, axes: tuple[int, ...]) -> Self:
        """The projection on some coordinates: exact."""
        return type(self)(self.center[..., axes], self.generators[..., axes, :])

    def minkowski_sum(self, other: "Zonotope") -> Self:
        """``{a + b}``: exact [Gir05]."""
        return type(self)(self.center + other.center, stack_columns(self.generators, other.generators))

    def cartesian_product(self, other: "Zonotope") -> Self:
        """``{(a, b)}``: exact."""
        batch = np.broadcast_shapes(self.batch, other.batch)
        centers = [np.broadcast_to(z.center, (*batch, z.dimension)) for z in (self, other)]
        return type(self)(np.concatenate(centers, axis=-1), block_diagonal(self.generators, other.generators))

    def reduce_order(self, order: float) -> Self:
        """An enclosing zonotope with at most ``order * n`` generators (at least n): outer [Gir05]."""
        return type(self)(self.center, reduction.girard(self.generators, int(order * self.dimension)))

    def intersect_strip(self, H: ArrayLike, q: ArrayLike, r: ArrayLike, method: strips.StripMethod = "tight") -> Self:
        """An enclosure of the part with ``|Hx - q| <= r`` (H (..., n); r = inf: inactive): outer.

        Where the intersection is certainly empty the set comes back unchanged; ask ``misses_strip``.
        """
        lower, upper = _strip(q, r)
        return self._cut(H, lower, upper, method)

    def intersect_halfspace(self, H: ArrayLike, q: ArrayLike, method: strips.StripMethod = "tight") -> Self:
        """An enclosure of the part with ``Hx <= q``: outer; unchanged where that part is certainly empty."""
        return self._cut(H, np.asarray(-np.inf), checked(q, "q", (), infinite=True), method)

    def misses_strip(self, H: ArrayLike, q: ArrayLike, r: ArrayLike) -> NDArray[np.bool_]:
        """True where no point of the set has ``|Hx - q| <= r``; certain where True (exact up to rounding)."""
        normal = checked(H, "H", (self.dimension,))
        return np.asarray(strips.strip_bounds(self.center, self.generators, normal, *_strip(q, r))[3])

    def _cut(self, H: ArrayLike, lower: Array, upper: Array, method: strips.StripMethod) -> Self:
        normal = checked(H, "H", (self.dimension,))
        center, generators, _ = strips.intersect_strip(
            self.center, self.generators, normal, lower, upper, method=method
        )
        return type(self)(center, generators)

    def support(self, d: ArrayLike) -> Array:
        """Greatest ``d·x`` for directions ``d`` (..., K, n), shape (..., K): exact."""
        return support.zonotope_support(self.center, self.generators, checked(d, "d", (None, self.dimension)))

    def interval_hull(self) -> tuple[Array, Array]:
        """Least box around the set, (lower (..., n), upper (..., n)): exact."""
        half = np.abs(self.generators).sum(axis=-1)
        return self.center - half, self.center + half

    def volume(self) -> Array:
        """Volume (...): exact; every choice of n generators is looked at, so for small sets beyond the plane."""
        if self.dimension == 2:
            return np.broadcast_to(planar.zonotope_area(self.generators), self.batch)
        return np.broadcast_to(planar.zonotope_volume(self.generators), self.batch)

    def polygon(self) -> Array:
        """Vertices (..., V, 2) of planar sets, counter-clockwise: exact."""
        if self.dimension != 2:
            raise SetError(f"polygon needs a planar set, this one has dimension {self.dimension}: project it first")
        return planar.zonotope_polygon(self.center, self.generators)

    def contains_point(self, x: ArrayLike) -> NDArray[np.bool_]:
        """True (...) where the point (..., n) lies in the set, up to 1e-7 of its size: exact."""
        point = checked(x, "x", (self.dimension,))
        empty = np.zeros((0, self.generators.shape[-1]))
        return membership.contains(self.center, self.generators, empty, np.zeros(0), point)

    def is_empty(self) -> NDArray[np.bool_]:
        """False (...): a zonotope always holds its center."""
        return np.zeros(self.batch, dtype=bool)

    def sample(self, rng: np.random.Generator, count: int) -> Array:
        """Members (..., count, n) drawn by independent factors, some of them at the factors' bounds."""
        g = self.generators.shape[-1]
        factors = rng.uniform(-1, 1, (*self.batch, count, g))
        extreme = rng.random((*self.batch, count, 1)) < 0.3
        factors = np.where(extreme, np.where(factors < 0, -1.0, 1.0), factors)
        return np.asarray(self.center[..., None, :] + factors @ np.swapaxes(self.generators, -1, -2))


def _strip(q: ArrayLike, r: ArrayLike) -> tuple[Array, Array]:
    middle, radius = checked(q, "q", ()), checked(r, "r", (), infinite=True)
    if (radius < 0).any():
        raise SetError(f"r must not be negative, its least value is {radius.min()}")
    return middle - radius, middle + radius
