"""``ConstrainedZonotope``: ``{c + Gβ : Aβ = b, |β| <= 1}``, any number of leading batch axes ([SDB+16])."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self, Union

import numpy as np
from numpy.typing import ArrayLike

from reach_server.numeric.checks import (
    SetError,
    batch_shape,
    block_diagonal,
    checked,
    checked_axes,
    checked_batch,
    checked_count,
    checked_dimension,
    stack_columns,
)
from reach_server.numeric.intervals import Interval
from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.sets import constrained_questions, constraint_reduction, outline, precise, support
from reach_server.sets import halfspace as strips
from reach_server.sets import order_reduction as reduction
from reach_server.sets import polygon as planar
from reach_server.sets import sampling as members
from reach_server.sets.approximation import Direction, compose
from reach_server.sets.constraint_reduction import Parts
from reach_server.sets.kernels import membership
from reach_server.sets.support import Certificate, EmptinessCertificate, Solution
from reach_server.sets.zonotope import ConvexSet, SampleMethod, Zonotope, _strip

AnyZonotope = Union[Zonotope, "ConstrainedZonotope"]


@dataclass(frozen=True, eq=False)
class ConstrainedZonotope:
    """Sets with ``center`` (..., n), ``generators`` (..., n, g), ``constraint_matrix`` (..., c, g) and
    ``constraint_offset`` (..., c); may be empty.

    ``direction`` says how the set relates to the true result of the operations that made it; every operation composes
    it. *Exact* and *outer* hold for exact arithmetic on the given numbers: center and generators carry the rounding of
    their own sums and products, some ulps of the terms; each row of the constraints is off by some ulps of its own size
    (``reduce_constraints``: both by 1e-11 at most). Emptiness is proved by a margin above that, so a set that holds a
    point is never called empty; what misses a cut by less than 1e-9 of the numbers compared counts as touching it, and
    the nearest points are kept. Numbers that come back as bounds (``support``, ``interval_hull``, ``polygon``, the
    outer end of a bracket) include what they may have lost by rounding. An empty set has support -inf, the hull [inf,
    -inf], a polygon of NaN, volume 0 and samples of NaN, wherever its emptiness was proved.

    Every bounded polytope is one [SDB+16]. Numbers are in whatever units the caller uses. Raises ``SetError`` for wrong
    shapes, NaN or infinities, and for dimension 0; so does every verb for its arguments, also where their batch axes do
    not go with those of the set.
    """

    center: FloatArray
    generators: FloatArray
    constraint_matrix: FloatArray
    constraint_offset: FloatArray
    direction: Direction = Direction.EXACT

    def __post_init__(self) -> None:
        zonotope = Zonotope(self.center, self.generators, self.direction)
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
        return cls(zonotope.center, zonotope.generators, np.zeros((0, g)), np.zeros(0), zonotope.direction)

    @classmethod
    def box(cls, lower: ArrayLike, upper: ArrayLike) -> Self:
        """The box from ``lower`` to ``upper`` (..., n): exact, half-widths rounded outwards by 1 ulp where they are no
        floating-point numbers."""
        return cls.from_zonotope(Zonotope.box(lower, upper))

    @classmethod
    def from_interval(cls, interval: Interval | tuple[ArrayLike, ArrayLike]) -> Self:
        """The box of ``interval``, an ``Interval`` of shape (..., n) or a pair (lower, upper) of such: exact, as
        ``box``.

        Raises ``SetError`` for empty and for unbounded intervals.
        """
        return cls.from_zonotope(Zonotope.from_interval(interval))

    @classmethod
    def point(cls, x: ArrayLike) -> Self:
        """The set of the point ``x`` (..., n) alone: exact."""
        return cls.from_zonotope(Zonotope.point(x))

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
        m = checked_dimension(self._argument(matrix, "matrix", (None, self.dimension)), -2, "matrix")
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

    def minkowski_sum(self, other: AnyZonotope) -> Self:
        """``{a + b}`` for a of this set and b of ``other``: exact [SDB+16]; batch axes are broadcast."""
        added = self._other(other)
        matrix, offset = self._joined_constraints(added)
        generators = stack_columns(self.generators, added.generators)
        return self._made(self.center + added.center, generators, matrix, offset, added.direction)

    def cartesian_product(self, other: AnyZonotope) -> Self:
        """``{(a, b)}`` in n1 + n2 dimensions: exact."""
        second = self._other(other, same_space=False)
        matrix, offset = self._joined_constraints(second)
        batch = np.broadcast_shapes(self.batch, second.batch)
        center = np.concatenate([np.broadcast_to(z.center, (*batch, z.dimension)) for z in (self, second)], axis=-1)
        return self._made(center, block_diagonal(self.generators, second.generators), matrix, offset, second.direction)

    def convex_hull(self, other: AnyZonotope) -> Self:
        """The least convex set around both: exact [RK22, theorem 5].

        With g1, g2 generators and c1, c2 rows it has ``3 (g1 + g2) + 1`` generators and ``c1 + c2 + 2 (g1 + g2)`` rows.
        An empty set adds nothing.
        """
        second = self._other(other)
        g1, g2 = self.generators.shape[-1], second.generators.shape[-1]
        g = g1 + g2
        batch = np.broadcast_shapes(self.batch, second.batch)
        # x = λ x1 + (1 - λ) x2 with λ = (1 + ξ)/2; factors (λβ1, (1 - λ)β2, ξ, slacks).
        half_shift = np.broadcast_to((self.center - second.center)[..., None] / 2, (*batch, self.dimension, 1))
        generators = stack_columns(self.generators, second.generators, half_shift, np.zeros((self.dimension, 2 * g)))
        joined, offset = self._joined_constraints(second)
        rows = joined.shape[-2]
        first_rows = self.constraint_matrix.shape[-2]
        matrix = np.zeros((*batch, rows + 2 * g, 3 * g + 1))
        right = np.full((*batch, rows + 2 * g), -0.5)
        matrix[..., :rows, :g] = joined
        sign = np.where(np.arange(rows) < first_rows, -0.5, 0.5)
        matrix[..., :rows, g] = sign * offset
        right[..., :rows] = offset / 2
        # |λβ1| <= λ and |(1 - λ)β2| <= 1 - λ, each side with a slack.
        own = np.where(np.arange(g) < g1, -0.5, 0.5)
        matrix[..., rows:, :g] = np.concatenate([np.eye(g), -np.eye(g)])
        matrix[..., rows:, g] = np.concatenate([own, own])
        matrix[..., rows:, g + 1 :] = np.eye(2 * g)
        return self._made((self.center + second.center) / 2, generators, matrix, right, second.direction)

    def intersect_strip(self, H: ArrayLike, q: ArrayLike, r: ArrayLike) -> Self:
        """The part with ``|Hx - q| <= r`` for H (..., n), q and r (...) (r = inf: inactive): exact, one factor and one
        row more.

        Algorithm 3 of [AJS+22] with the new columns of G zero, on the strip tightened to the zonotope. Where that strip
        is certainly missed, the row added cannot be met: the result is empty.
        """
        normal = self._argument(H, "H", (self.dimension,))
        self._argument(q, "q", ())
        self._argument(r, "r", (), infinite=True)
        lower, upper = _strip(q, r)
        return self._cut(normal[..., None, :], lower[..., None], upper[..., None])

    def intersect_halfspace(self, H: ArrayLike, q: ArrayLike) -> Self:
        """The part with ``Hx <= q`` for H (..., n), q (...) (q = inf: inactive): exact, one factor and one row more."""
        normal = self._argument(H, "H", (self.dimension,))
        bound = self._argument(q, "q", (), infinite=True)
        return self._cut(normal[..., None, :], np.full(1, -np.inf), bound[..., None])

    def intersect_tangents(self, H: ArrayLike, q: ArrayLike) -> Self:
        """The part with ``Hx <= q`` for all rows of H (..., K, n), q (..., K) (q = inf: inactive): exact, K factors and
        rows more."""
        normals = self._argument(H, "H", (None, self.dimension))
        bounds = self._argument(q, "q", (normals.shape[-2],), infinite=True)
        return self._cut(normals, np.full(1, -np.inf), bounds)

    def intersect_linearised(
        self, J: ArrayLike, h0: ArrayLike, remainder: tuple[ArrayLike, ArrayLike], r: ArrayLike
    ) -> Self:
        """An enclosure of the part with ``|h(x)| <= r`` where ``h(x)`` is in ``h0 + J(x - center) + [lower, upper]``.

        J (..., n); h0, r and both ends of ``remainder`` = (lower, upper) have shape (...,); an infinite remainder or r
        is inactive; outer: one factor and one row more. Algorithm 3 of [AJS+22] with its two columns -r and G_L added
        up: the strip ``|J(x - c) + h0 + mid| <= r + rad``, rounded outwards.
        """
        normal = self._argument(J, "J", (self.dimension,))
        lower, upper = strips.linearised(normal, self.center, h0, remainder, r, self.batch)
        return self._cut(normal[..., None, :], lower[..., None], upper[..., None], Direction.OUTER)

    def intersection(self, other: AnyZonotope, matrix: ArrayLike | None = None) -> Self:
        """``{x in self : Rx in other}`` (R = ``matrix`` (..., k, n), None: identity): exact [SDB+16].

        Raises ``SetError`` where the rows of the matrix are not as many as the dimensions of ``other``.
        """
        second = self._other(other, same_space=matrix is None)
        m = np.eye(self.dimension) if matrix is None else self._argument(matrix, "matrix", (None, self.dimension))
        if m.shape[-2] != second.dimension:
            raise SetError(
                f"matrix has shape {m.shape}, other has dimension {second.dimension}: expected "
                f"(..., {second.dimension}, {self.dimension})"
            )
        joined, offset = self._joined_constraints(second)
        # Rows that cancel out must vanish: what rounding leaves of them would tie down factors.
        own = self.generators if matrix is None else precise.product(m, self.generators)
        heights = stack_columns(own, -second.generators)
        right = precise.remainder(second.center, m, self.center)
        batch = np.broadcast_shapes(joined.shape[:-2], offset.shape[:-1], heights.shape[:-2], right.shape[:-1])
        rows = [np.broadcast_to(a, batch + a.shape[-2:]) for a in (joined, heights)]
        offsets = [np.broadcast_to(a, batch + a.shape[-1:]) for a in (offset, right)]
        generators = stack_columns(self.generators, np.zeros((self.dimension, second.generators.shape[-1])))
        return self._made(
            self.center, generators, np.concatenate(rows, axis=-2), np.concatenate(offsets, axis=-1), second.direction
        )

    def _cut(
        self, normals: FloatArray, lower: FloatArray, upper: FloatArray, step: Direction = Direction.EXACT
    ) -> Self:
        """The part with ``lower <= normals @ x <= upper`` (..., K, n), (..., K)."""
        q, r, cuts, empty = strips.strip_bounds(
            self.center[..., None, :], self.generators[..., None, :, :], normals, lower, upper
        )
        acts = cuts & ~empty
        heights = normals @ self.generators
        middle = (normals @ self.center[..., None])[..., 0]
        batch = batch_shape((r, 1), *self._own_axes())
        count, g = normals.shape[-2], self.generators.shape[-1]
        rows = self.constraint_matrix.shape[-2]
        matrix = np.zeros((*batch, rows + count, g + count))
        offset = np.zeros((*batch, rows + count))
        matrix[..., :rows, :g] = self.constraint_matrix
        offset[..., :rows] = self.constraint_offset
        matrix[..., rows:, :g] = np.where(acts[..., None], heights, 0.0)
        matrix[..., rows:, g:] = np.where(acts, -r, 0.0)[..., None] * np.eye(count)
        # A missed strip gets the row 0·β = 1.
        offset[..., rows:] = np.where(empty, 1.0, np.where(acts, q - middle, 0.0))
        generators = np.concatenate([self.generators, np.zeros((*self.generators.shape[:-1], count))], axis=-1)
        return self._made(self.center, generators, matrix, offset, step)

    def reduce_order(self, order: float, method: reduction.ReductionMethod = "girard") -> Self:
        """An enclosing set with at most ``order * n`` generators (at least n plus the constraints): outer; the same set
        if there are no more.

        The zonotope of ``(Gβ, Aβ)`` is enclosed as one and the constraints are kept [SDB+16, section 4.3]; methods as
        for zonotopes. It gains from ``rescale`` and ``reduce_constraints`` beforehand.
        """
        count = reduction.generator_count(order, self.dimension)
        n, rows = self.dimension, self.constraint_matrix.shape[-2]
        lifted = stack_rows(self.generators, self.constraint_matrix)
        # Powers of two, which round nothing: generators of unlike coordinates and rows are ranked alike.
        widths = np.abs(lifted).sum(axis=-1, keepdims=True)
        unit = np.where(widths > 0, np.ldexp(1.0, np.frexp(widths)[1]), 1.0)
        reduced = unit * reduction.reduce_generators(lifted / unit, max(count, n + rows), method)
        same = reduced.shape[-1] == lifted.shape[-1]
        if same:
            return self
        return self._made(
            self.center, reduced[..., :n, :], reduced[..., n:, :], self.constraint_offset, Direction.OUTER
        )

    def reduce_constraints(self, count: int, candidates: int = 2) -> Self:
        """An enclosing set with at most ``count`` constraints (and a generator less for each that went): outer; the
        same set if there are no more.

        One by one, after rescaling ([SDB+16, section 4.2]; see ``constraint_reduction.reduce_constraints``); more
        ``candidates`` take longer and give smaller sets. An empty set may become one that is not. Raises ``SetError``
        for a negative count.
        """
        kept = checked_count(count, "count")
        if kept >= self.constraint_matrix.shape[-2]:
            return self
        tried = max(checked_count(candidates, "candidates"), 1)
        return self._made(*constraint_reduction.reduce_constraints(self._parts, kept, tried), Direction.OUTER)

    def keep_newest_constraints(self, count: int) -> Self:
        """The set without its oldest constraints, at most ``count`` are left: outer."""
        rows = self.constraint_matrix.shape[-2]
        first = max(rows - checked_count(count, "count"), 0)
        return self._made(
            self.center,
            self.generators,
            self.constraint_matrix[..., first:, :],
            self.constraint_offset[..., first:],
            Direction.OUTER if first else Direction.EXACT,
        )

    def rescale(self) -> Self:
        """The same set over factors that each reach both of their bounds: exact [SDB+16, eq. 24]. Factors that the
        constraints tie down to less than 1e-5 stay as they are."""
        return self._made(*constraint_reduction.rescale(self._parts))

    def simplify(self) -> Self:
        """The same set without redundant rows and columns: exact (see ``constraint_reduction.simplify``). A batch keeps
        as many of each as its largest set needs."""
        return self._made(*constraint_reduction.simplify(self._parts))

    def support(self, d: ArrayLike) -> FloatArray:
        """Upper bound of ``d·x`` for directions ``d`` (..., K, n), shape (..., K): outer, certified by duality and
        tight up to rounding; -inf where the set is certainly empty."""
        found = self._solve(d)
        return np.where(found.empty, -np.inf, found.bound)

    def support_certificate(self, d: ArrayLike) -> Certificate:
        """The bounds of ``support`` for ``d`` (..., K, n) with the dual weights that prove them: outer."""
        found = self._solve(d)
        empty = found.empty
        weights = np.where(empty[..., None], found.ray[..., None, :], found.weights)
        return Certificate(np.where(empty, -np.inf, found.bound), weights)

    def _solve(self, d: ArrayLike) -> Solution:
        directions = self._argument(d, "d", (None, self.dimension))
        return support.solve(self.center, self.generators, self.constraint_matrix, self.constraint_offset, directions)

    def interval_hull(self) -> tuple[FloatArray, FloatArray]:
        """Least box around the set, (lower (..., n), upper (..., n)): outer, certified by duality, tight up to
        rounding; (inf, -inf) where the set is certainly empty."""
        unit = np.eye(self.dimension)
        bounds = self.support(np.concatenate([unit, -unit]))
        n = self.dimension
        lower, upper = -bounds[..., n:], bounds[..., :n]
        # Of a set that only rounding made empty the bounds may cross: the hull of both.
        crossed = (lower > upper) & np.isfinite(lower)
        return np.where(crossed, upper, lower), np.where(crossed, lower, upper)

    def is_empty(self) -> BoolArray:
        """True (...) where the set is certainly empty (Farkas certificate); False: none was found, which is exact up to
        a margin of 1e-9."""
        return self.emptiness_certificate().empty

    def emptiness_certificate(self) -> EmptinessCertificate:
        """Where the set is certainly empty (...), with the Farkas weights (..., c) that prove it; False: not shown."""
        found = support.farkas(self.constraint_matrix, self.constraint_offset)
        batch = self.batch
        if found.empty.shape == batch:
            return found
        weights = np.broadcast_to(found.weights, batch + found.weights.shape[-1:])
        return EmptinessCertificate(np.broadcast_to(found.empty, batch), weights)

    def polygon(self, count: int | None = None) -> FloatArray:
        """Vertices (..., V, 2) of planar sets, counter-clockwise: exact up to 1e-9 of the set's extent, and outer; sets
        with fewer vertices than V repeat the last one. With ``count`` (at least 3): that many vertices of an outer
        polygon, certified in as many directions at equal angles. Raises ``SetError`` for a smaller count and in other
        dimensions."""
        self._planar("polygon")
        if count is None:
            return self._outline().outer
        if checked_count(count, "count") < 3:
            raise SetError(f"count is {count}, expected no less than 3")
        # About the center: far from the origin, products with the directions would round away the shape.
        found = support.solve(
            np.zeros(2), self.generators, self.constraint_matrix, self.constraint_offset, planar.directions(count)
        )
        heights = found.bound + 4 * EPS * np.abs(self.center).sum(axis=-1)[..., None]
        vertices = self.center[..., None, :] + planar.outer_polygon(heights)
        return np.where(found.empty[..., None], np.nan, vertices)

    def _outline(self) -> outline.Outline:
        return outline.outline(self.center, self.generators, self.constraint_matrix, self.constraint_offset)

    def area(self) -> FloatArray:
        """Area (...) of planar sets: exact up to 1e-9 of the squared extent, never below the true area.

        Raises ``SetError`` in other dimensions.
        """
        self._planar("area")
        return self.area_bracket()[1]

    def area_bracket(self) -> tuple[FloatArray, FloatArray]:
        """(inner, outer) bounds (...) of the area of planar sets: of the hull of attained points, less what these may
        lie outside, and of ``polygon()``."""
        self._planar("area_bracket")
        # About the origin: far from it, rounding of the vertices would show.
        found = outline.outline(np.zeros(2), self.generators, self.constraint_matrix, self.constraint_offset)
        inner, outer = (planar.polygon_area(np.nan_to_num(v)) for v in (found.inner, found.outer))
        # Attained points are members up to what the linear programs are accurate to: a strip along the outline.
        lost = outline.ROUNDING * np.abs(self.generators).sum(axis=(-2, -1))
        edges = np.nan_to_num(np.roll(found.inner, -1, axis=-2) - found.inner)
        inner = inner * (1 - 1e-12) - lost * (np.sqrt((edges**2).sum(axis=-1)).sum(axis=-1) + 4 * lost)
        inner, outer = np.maximum(np.minimum(inner, outer), 0.0), np.maximum(outer, 0.0)
        return np.broadcast_to(inner, self.batch), np.broadcast_to(outer * (1 + 4 * EPS), self.batch)

    def volume(self) -> FloatArray:
        """Volume (...): exact in one and two dimensions up to rounding and never below the true one, beyond the outer
        end of ``volume_bracket``."""
        return self.volume_bracket()[1]

    def volume_bracket(self) -> tuple[FloatArray, FloatArray]:
        """(inner, outer) bounds (...) of the volume: from attained points and from certified directions.

        In three to five dimensions they are refined to 1e-3 of each other, or for four rounds, set by set; beyond, the
        inner bound is 0 and the outer one that of the interval hull.
        """
        if self.dimension == 2:
            return self.area_bracket()
        if self.dimension == 1:
            # About the origin: far from it, rounding of the ends would show.
            ends = replace(self, center=np.zeros(1)).support([[1.0], [-1.0]])
            width = np.broadcast_to(np.maximum(ends.sum(axis=-1) * (1 + EPS), 0.0), self.batch)
            return np.maximum(width - 1e-9 * np.abs(self.generators).sum(axis=(-2, -1)), 0.0), width
        parts = constraint_reduction.common_batch(self._parts)
        batch = self.batch
        found = np.zeros((*batch, 2))
        for place in np.ndindex(*batch):
            found[place] = constrained_questions.volume_bracket(constraint_reduction.at(parts, place))
        return found[..., 0], found[..., 1]

    def enclosing_zonotope(self) -> Zonotope:
        """A zonotope around the set: outer, the set itself without constraints.

        The smallest of four (by area, or by the widths): the generators without the constraints, the same over what
        these leave the factors, all constraints eliminated, and the interval hull. n generators more hold what rounding
        may have lost.
        """
        n, rows = self.dimension, self.constraint_matrix.shape[-2]
        if not rows:
            return Zonotope(self.center, self.generators, self.direction)
        parts = constraint_reduction.common_batch(self._parts)
        g = max(parts[1].shape[-1], n)
        bounded = constraint_reduction.within_bounds(parts)
        eliminated = constraint_reduction.eliminate_all(parts)
        lower, upper = self.interval_hull()
        inhabited = np.isfinite(lower).all(axis=-1, keepdims=True)
        interval = Interval(np.where(inhabited, lower, parts[0]), np.where(inhabited, upper, parts[0]))
        hull = (interval.midpoint, interval.radius[..., None] * np.eye(n))
        options = [parts[:2], bounded, eliminated[:2], hull]
        centers = np.stack([np.broadcast_to(c, parts[0].shape) for c, _ in options], axis=-2)
        padded = np.zeros((*parts[1].shape[:-2], len(options), n, g))
        for k, (_, generators) in enumerate(options):
            padded[..., k, :, : generators.shape[-1]] = generators
        best = strips.log_size(padded, None).argmin(axis=-1)[..., None, None]
        center = np.take_along_axis(centers, best, axis=-2)[..., 0, :]
        generators = np.take_along_axis(padded, best[..., None], axis=-3)[..., 0, :, :]
        # What sums and elimination may have lost; flat sets show it.
        size = np.abs(parts[1]).sum(axis=-1)
        terms = np.abs(generators).sum(axis=-1) + np.abs(parts[0]) + np.abs(center) + size
        rounding = (((g + 8) * EPS) * terms + eliminated[2])[..., None] * np.eye(n)
        return Zonotope(center, stack_columns(generators, rounding), compose(self.direction, Direction.OUTER))

    def contains_point(self, x: ArrayLike) -> BoolArray:
        """True (...) where the point ``x`` (..., n) lies in the set: exact up to 1e-7 of its size."""
        return self._reach(x)[0]

    def factors_of(self, x: ArrayLike) -> FloatArray:
        """Factors β (..., g) with ``c + Gβ = x``, ``Aβ = b`` and ``|β| <= 1`` for the point ``x`` (..., n): exact up to
        1e-7 of the set's size; rows of NaN where the point is not in the set."""
        return self._reach(x)[1]

    def _reach(self, x: ArrayLike) -> tuple[BoolArray, FloatArray]:
        point = self._argument(x, "x", (self.dimension,))
        return membership.reach(*self._parts, point)

    def contains_set(self, other: ConvexSet) -> BoolArray:
        """True (...) where ``other`` certainly lies in this set, up to 1e-7 of its size, the rounding of the centers
        and 1e-12 of the generators of ``other``; False: not shown.

        In the plane the outlines decide, up to that margin both ways, and in one dimension the intervals; beyond, a
        sufficient linear program for each pair (an affine map between the factors, [ST19]). An empty ``other`` lies in
        all.
        """
        inner = self._other(other)
        batch = batch_shape(*self._own_axes(), *inner._own_axes())
        empty = inner.is_empty()
        if self.dimension == 1:
            reach, theirs_reach = (np.abs(one.generators).sum(axis=-1) for one in (self, inner))
            slack = constrained_questions.SLACK * reach + 4 * EPS * (np.abs(self.center) + np.abs(inner.center))
            slack = slack + outline.ROUNDING * theirs_reach
            low, high = self.interval_hull()
            inner_low, inner_high = inner.interval_hull()
            inside = ((low <= inner_low + slack) & (inner_high <= high + slack)).all(axis=-1) & ~self.is_empty()
            return np.broadcast_to(inside | empty, batch)
        if self.dimension == 2:
            mine, theirs = self._outline(), inner._outline()
            size, theirs_size = (np.abs(one.generators).sum(axis=(-2, -1)) for one in (self, inner))
            far = (np.abs(self.center) + np.abs(inner.center)).sum(axis=-1)
            size = size + (8 * EPS * far + outline.ROUNDING * theirs_size) / constrained_questions.SLACK
            inside = constrained_questions.polygon_contains(mine.normals, mine.heights, size, theirs.outer)
            return np.broadcast_to((inside & mine.exact & ~mine.empty) | empty, batch)
        mine_parts = constraint_reduction.common_batch(self._parts, batch)
        inner_parts = constraint_reduction.common_batch(inner._parts, batch)
        found = np.array(np.broadcast_to(empty, batch))
        for place in np.argwhere(~found):
            pair = (constraint_reduction.at(parts, tuple(place)) for parts in (mine_parts, inner_parts))
            found[tuple(place)] = constrained_questions.contains(*pair)
        return found

    def intersects(self, other: AnyZonotope) -> BoolArray:
        """False (...) where the two sets are certainly disjoint (the intersection has a Farkas certificate); True
        otherwise, exact up to a margin of 1e-9."""
        return ~self.intersection(self._other(other)).is_empty()

    def sample(self, rng: np.random.Generator, count: int, how: SampleMethod = "inside") -> FloatArray:
        """Members (..., count, n), exact up to 1e-9 of the set's size; NaN where the set is certainly empty.

        ``inside`` and ``boundary``: in the plane uniform by area and by length; else from an inner point towards the
        boundary in random directions, part of the way and all of it. ``factors``: mixtures of random vertices of the
        factors' polytope, every third one such a vertex. Raises ``SetError`` for another ``how``.
        """
        if how not in ("inside", "boundary", "factors"):
            raise SetError(f"how is {how!r}, expected one of inside, boundary, factors")
        number = checked_count(count, "count")
        parts = constraint_reduction.common_batch(self._parts)
        batch = self.batch
        size = math.prod(batch)
        center, generators, matrix, offset = (a.reshape(size, *a.shape[len(batch) :]) for a in parts)
        if how != "factors" and self.dimension == 2:
            vertices = self._outline().inner
            vertices = vertices.reshape(size, *vertices.shape[-2:])
            return members.from_outline(vertices, rng, number, boundary=how == "boundary").reshape(*batch, number, 2)
        if how == "factors":
            factors = members.mixtures(matrix, offset, rng, number)
        else:
            middle, factors = members.shots((center, generators, matrix, offset), rng, number)
            if how == "inside":
                part = rng.random((size, number, 1)) ** (1 / self.dimension)
                factors = middle + part * (factors - middle)
        points = center[:, None] + factors @ np.swapaxes(generators, -1, -2)
        points = np.where(self.is_empty().reshape(size, 1, 1), np.nan, points)
        return np.asarray(points.reshape(*batch, number, self.dimension))

    @property
    def _parts(self) -> Parts:
        return self.center, self.generators, self.constraint_matrix, self.constraint_offset

    def _own_axes(self) -> tuple[tuple[FloatArray, int], ...]:
        return (self.center, 1), (self.generators, 2), (self.constraint_matrix, 2), (self.constraint_offset, 1)

    def _argument(
        self, value: ArrayLike, name: str, tail: tuple[int | None, ...], *, infinite: bool = False
    ) -> FloatArray:
        """A checked argument whose batch axes go with those of the set."""
        array = checked(value, name, tail, infinite=infinite)
        return array if array.ndim == len(tail) else checked_batch(array, len(tail), name, self.batch)

    def _other(self, other: object, *, same_space: bool = True) -> "ConstrainedZonotope":
        if isinstance(other, Zonotope):
            other = ConstrainedZonotope.from_zonotope(other)
        if not isinstance(other, ConstrainedZonotope):
            raise SetError(f"other is a {type(other).__name__}, expected a Zonotope or a ConstrainedZonotope")
        if same_space and other.dimension != self.dimension:
            raise SetError(f"other has dimension {other.dimension}, expected {self.dimension}")
        for array, own in other._own_axes():
            checked_batch(array, own, "other", self.batch)
        return other

    def _joined_constraints(self, other: "ConstrainedZonotope") -> tuple[FloatArray, FloatArray]:
        matrix = block_diagonal(self.constraint_matrix, other.constraint_matrix)
        offsets = (self.constraint_offset, other.constraint_offset)
        batch = np.broadcast_shapes(matrix.shape[:-2], *(o.shape[:-1] for o in offsets))
        return matrix, np.concatenate([np.broadcast_to(o, (*batch, o.shape[-1])) for o in offsets], axis=-1)

    def _with(self, center: FloatArray, generators: FloatArray) -> Self:
        return self._made(center, generators, self.constraint_matrix, self.constraint_offset)

    def _made(
        self, center: FloatArray, generators: FloatArray, matrix: FloatArray, offset: FloatArray, *steps: Direction
    ) -> Self:
        """A set made from this one by operations, and with operands, of these directions."""
        return type(self)(center, generators, matrix, offset, compose(self.direction, *steps))

    def _planar(self, verb: str) -> None:
        if self.dimension != 2:
            raise SetError(f"{verb} needs a planar set, this one has dimension {self.dimension}: project it first")


def stack_rows(*blocks: FloatArray) -> FloatArray:
    """Matrices (..., n_i, g) one below the other, batch axes broadcast."""
    batch = np.broadcast_shapes(*(block.shape[:-2] for block in blocks))
    return np.concatenate([np.broadcast_to(b, (*batch, *b.shape[-2:])) for b in blocks], axis=-2)
