"""``ConstrainedZonotope``: ``{c + Gβ : Aβ = b, |β| <= 1}``, any number of leading batch axes ([SDB+16])."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linprog

from reach_server.sets import membership, planar, reduction, support
from reach_server.sets.arrays import Array, SetError, batch_shape, block_diagonal, checked, stack_columns
from reach_server.sets.strips import strip_bounds
from reach_server.sets.zonotope import Zonotope, _strip


@dataclass(frozen=True, eq=False)
class ConstrainedZonotope:
    """Sets with ``center`` (..., n), ``generators`` (..., n, g), ``constraint_matrix`` (..., c, g) and
    ``constraint_offset`` (..., c); may be empty.

    Raises ``SetError`` for wrong shapes, NaN or infinities, and for dimension 0.
    """

    center: Array
    generators: Array
    constraint_matrix: Array
    constraint_offset: Array

    def __post_init__(self) -> None:
        zonotope = Zonotope(self.center, self.generators)
        matrix = checked(self.constraint_matrix, "constraint_matrix", (None, zonotope.generators.shape[-1]))
        offset = checked(self.constraint_offset, "constraint_offset", (matrix.shape[-2],))
        batch_shape((zonotope.center, 1), (zonotope.generators, 2), (matrix, 2), (offset, 1))
        for name, value in (
            ("center", zonotope.center),
            ("generators", zonotope.generators),
            ("constraint_matrix", matrix),
            ("constraint_offset", offset),
        ):
            object.__setattr__(self, name, value)

    @classmethod
    def from_zonotope(cls, zonotope: Zonotope) -> Self:
        """The same set without constraints: exact."""
        g = zonotope.generators.shape[-1]
        return cls(zonotope.center, zonotope.generators, np.zeros((0, g)), np.zeros(0))

    @property
    def batch(self) -> tuple[int, ...]:
        """The batch axes."""
        return batch_shape(
            (self.center, 1), (self.generators, 2), (self.constraint_matrix, 2), (self.constraint_offset, 1)
        )

    @property
    def dimension(self) -> int:
        """The dimension n of the space."""
        return int(self.center.shape[-1])

    def _with(self, center: Array, generators: Array) -> Self:
        return type(self)(center, generators, self.constraint_matrix, self.constraint_offset)

    def linear_map(self, matrix: ArrayLike) -> Self:
        """The image under ``matrix`` (..., k, n): exact."""
        m = checked(matrix, "matrix", (None, self.dimension))
        return self._with((m @ self.center[..., None])[..., 0], m @ self.generators)

    def translate(self, offset: ArrayLike) -> Self:
        """The set moved by ``offset`` (..., n): exact."""
        return self._with(self.center + checked(offset, "offset", (self.dimension,)), self.generators)

    def project(self, axes: tuple[int, ...]) -> Self:
        """The projection on some coordinates: exact."""
        return self._with(self.center[..., axes], self.generators[..., axes, :])

    def minkowski_sum(self, other: "Zonotope | ConstrainedZonotope") -> Self:
        """``{a + b}``: exact [SDB+16, prop. 1]."""
        matrix, offset = self._joined_constraints(other)
        center = self.center + other.center
        return type(self)(center, stack_columns(self.generators, other.generators), matrix, offset)

    def cartesian_product(self, other: "Zonotope | ConstrainedZonotope") -> Self:
        """``{(a, b)}``: exact."""
        matrix, offset = self._joined_constraints(other)
        batch = np.broadcast_shapes(self.batch, other.batch)
        centers = [np.broadcast_to(z.center, (*batch, z.dimension)) for z in (self, other)]
        generators = block_diagonal(self.generators, other.generators)
        return type(self)(np.concatenate(centers, axis=-1), generators, matrix, offset)

    def _joined_constraints(self, other: "Zonotope | ConstrainedZonotope") -> tuple[Array, Array]:
        if isinstance(other, Zonotope):
            other = ConstrainedZonotope.from_zonotope(other)
        matrix = block_diagonal(self.constraint_matrix, other.constraint_matrix)
        batch = matrix.shape[:-2]
        batch = np.broadcast_shapes(batch, self.constraint_offset.shape[:-1], other.constraint_offset.shape[:-1])
        offsets = (self.constraint_offset, other.constraint_offset)
        return matrix, np.concatenate([np.broadcast_to(o, (*batch, o.shape[-1])) for o in offsets], axis=-1)

    def reduce_order(self, order: float) -> Self:
        """An enclosing set with at most ``order * n`` generators (at least n plus the constraints): outer.

        The zonotope of ``(Gβ, Aβ)`` is enclosed as one and the constraints are kept [SDB+16, section 4.2].
        """
        n, rows = self.dimension, self.constraint_matrix.shape[-2]
        lifted = np.concatenate(self._broadcast_factors(), axis=-2)
        reduced = reduction.girard(lifted, max(int(order * n), n + rows))
        return type(self)(self.center, reduced[..., :n, :], reduced[..., n:, :], self.constraint_offset)

    def _broadcast_factors(self) -> tuple[Array, Array]:
        batch = np.broadcast_shapes(self.generators.shape[:-2], self.constraint_matrix.shape[:-2])
        g = self.generators.shape[-1]
        return (
            np.broadcast_to(self.generators, (*batch, self.dimension, g)),
            np.broadcast_to(self.constraint_matrix, (*batch, self.constraint_matrix.shape[-2], g)),
        )

    def keep_newest_constraints(self, count: int) -> Self:
        """The set without its oldest constraints, at most ``count`` are left: outer."""
        rows = self.constraint_matrix.shape[-2]
        first = max(rows - count, 0)
        return type(self)(
            self.center,
            self.generators,
            self.constraint_matrix[..., first:, :],
            self.constraint_offset[..., first:],
        )

    def intersect_strip(self, H: ArrayLike, q: ArrayLike, r: ArrayLike) -> Self:
        """The part with ``|Hx - q| <= r`` (H (..., n); r = inf: inactive): exact, one factor and one row more.

        The paper's Algorithm 3 with the new columns of G zero, on the strip tightened to the zonotope. Where
        that strip is certainly missed, the row added cannot be met: the result is empty.
        """
        return self._cut(checked(H, "H", (self.dimension,)), *_strip(q, r))

    def intersect_halfspace(self, H: ArrayLike, q: ArrayLike) -> Self:
        """The part with ``Hx <= q``: exact, one factor and one row more."""
        return self._cut(checked(H, "H", (self.dimension,)), np.asarray(-np.inf), checked(q, "q", (), infinite=True))

    def _cut(self, normal: Array, lower: Array, upper: Array) -> Self:
        q, r, cuts, empty = strip_bounds(self.center, self.generators, normal, lower, upper)
        heights = (normal[..., None, :] @ self.generators)[..., 0, :]
        acts = cuts | empty
        heights = np.broadcast_to(heights, (*r.shape, heights.shape[-1]))
        row = np.where(acts[..., None], np.concatenate([heights, -r[..., None]], axis=-1), 0.0)
        right = np.where(acts, q - (normal * self.center).sum(axis=-1), 0.0)
        # A missed strip gets the row 0·β = 1.
        row, right = np.where(empty[..., None], 0.0, row), np.where(empty, 1.0, right)
        old = np.concatenate([self.constraint_matrix, np.zeros((*self.constraint_matrix.shape[:-1], 1))], axis=-1)
        batch = np.broadcast_shapes(old.shape[:-2], row.shape[:-1], self.constraint_offset.shape[:-1])
        rows, g = old.shape[-2:]
        matrix = np.concatenate(
            [np.broadcast_to(old, (*batch, rows, g)), np.broadcast_to(row, (*batch, g))[..., None, :]],
            axis=-2,
        )
        offset = np.concatenate(
            [
                np.broadcast_to(self.constraint_offset, (*batch, rows)),
                np.broadcast_to(right, batch)[..., None],
            ],
            axis=-1,
        )
        zero = np.zeros((*self.generators.shape[:-1], 1))
        return type(self)(self.center, np.concatenate([self.generators, zero], axis=-1), matrix, offset)

    def support(self, d: ArrayLike) -> Array:
        """Upper bound of ``d·x`` for directions ``d`` (..., K, n), shape (..., K): outer, certified by duality."""
        return support.constrained_support(
            self.center,
            self.generators,
            self.constraint_matrix,
            self.constraint_offset,
            checked(d, "d", (None, self.dimension)),
        )

    def interval_hull(self) -> tuple[Array, Array]:
        """A box around the set, (lower (..., n), upper (..., n)): outer, certified by duality."""
        unit = np.eye(self.dimension)
        bounds = self.support(np.concatenate([unit, -unit]))
        n = self.dimension
        return -bounds[..., n:], bounds[..., :n]

    def enclosing_zonotope(self) -> Zonotope:
        """The zonotope without the constraints: outer."""
        return Zonotope(self.center, self.generators)

    def polygon(self, count: int = 32) -> Array:
        """Vertices (..., count, 2) of a polygon around planar sets: outer, certified in ``count`` directions."""
        if self.dimension != 2:
            raise SetError(f"polygon needs a planar set, this one has dimension {self.dimension}: project it first")
        return planar.outer_polygon(self.support(planar.directions(count)))

    def area(self, count: int = 32) -> Array:
        """Area (...) of ``polygon(count)``: an upper bound of the set's area."""
        return np.maximum(planar.polygon_area(self.polygon(count)), 0.0)

    def volume(self) -> Array:
        """An upper bound (...) of the volume: the polygon's area in the plane, else that of the interval hull."""
        if self.dimension == 2:
            return self.area()
        lower, upper = self.interval_hull()
        return np.asarray(np.maximum(upper - lower, 0.0).prod(axis=-1))

    def contains_point(self, x: ArrayLike) -> NDArray[np.bool_]:
        """True (...) where the point (..., n) lies in the set, up to 1e-7 of its size: exact."""
        point = checked(x, "x", (self.dimension,))
        return membership.contains(self.center, self.generators, self.constraint_matrix, self.constraint_offset, point)

    def is_empty(self) -> NDArray[np.bool_]:
        """True (...) where the set is certainly empty (Farkas certificate); False says that none was found."""
        found = support.emptiness_certificate(self.constraint_matrix, self.constraint_offset)
        return np.broadcast_to(found, self.batch)

    def sample(self, rng: np.random.Generator, count: int) -> Array:
        """Members (count, n) of one set (batch ``()``), vertices of random directions and their mixtures.

        Raises ``SetError`` for a batch and for an empty set.
        """
        if self.batch:
            raise SetError(f"sample takes one set, this is a batch of shape {self.batch}")
        g = self.generators.shape[-1]
        vertices = []
        matrix, offset = support.unit_rows(self.constraint_matrix, self.constraint_offset)
        for cost in rng.normal(size=(count, g)):
            result = linprog(cost, A_eq=matrix, b_eq=offset, bounds=(-1, 1), method="highs")
            if result.status != 0 or result.x is None:
                raise SetError("sample: the set is empty")
            vertices.append(result.x)
        factors = np.stack(vertices)
        weights = rng.dirichlet(np.full(count, 0.5), size=count // 2)
        factors[: count // 2] = weights @ factors
        return np.asarray(self.center + factors @ self.generators.T)
