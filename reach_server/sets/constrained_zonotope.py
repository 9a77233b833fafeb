"""``ConstrainedZonotope``: ``{c + Gβ : Aβ = b, |β| <= 1}``, any number of leading batch axes ([SDB+16])."""

from dataclasses import dataclass
from typing import Self, Union

import numpy as np
from numpy.typing import ArrayLike

from reach_server.numeric.checks import (
    SetError,
    batch_shape,
    block_diagonal,
    checked,
    checked_batch,
    checked_count,
    stack_columns,
)
from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.sets import (
    constraint_reduction,
    containment,
    enclosure,
    factor_bounds,
    outline,
    redundancy,
    support,
    volume,
)
from reach_server.sets import halfspace as strips
from reach_server.sets import hull as hulls
from reach_server.sets import intersection as intersections
from reach_server.sets import order_reduction as reduction
from reach_server.sets import sampling as members
from reach_server.sets._shared_verbs import SharedVerbs
from reach_server.sets.approximation import Direction, compose
from reach_server.sets.parts import Parts, batch_of, joined_constraints, without_rows
from reach_server.sets.sampling import SampleMethod
from reach_server.sets.support import Certificate, EmptinessCertificate
from reach_server.sets.zonotope import ConvexSet, Zonotope

AnyZonotope = Union[Zonotope, "ConstrainedZonotope"]


@dataclass(frozen=True, eq=False)
class ConstrainedZonotope(SharedVerbs):
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
        return cls(*without_rows(zonotope.center, zonotope.generators), zonotope.direction)

    @classmethod
    def _free(cls, center: FloatArray, generators: FloatArray) -> Self:
        return cls(*without_rows(center, generators))

    def minkowski_sum(self, other: AnyZonotope) -> Self:
        """``{a + b}`` for a of this set and b of ``other``: exact [SDB+16]; batch axes are broadcast."""
        added = self._other(other)
        generators = stack_columns(self.generators, added.generators)
        joined = joined_constraints(self._parts, added._parts)
        return self._made(self.center + added.center, generators, *joined, added.direction)

    def cartesian_product(self, other: AnyZonotope) -> Self:
        """``{(a, b)}`` in n1 + n2 dimensions: exact."""
        second = self._other(other, same_space=False)
        batch = batch_of(self._parts, second._parts)
        center = np.concatenate([np.broadcast_to(z.center, (*batch, z.dimension)) for z in (self, second)], axis=-1)
        generators = block_diagonal(self.generators, second.generators)
        return self._made(center, generators, *joined_constraints(self._parts, second._parts), second.direction)

    def convex_hull(self, other: AnyZonotope) -> Self:
        """The least convex set around both: exact [RK22, theorem 5].

        With g1, g2 generators and c1, c2 rows it has ``3 (g1 + g2) + 1`` generators and ``c1 + c2 + 2 (g1 + g2)`` rows.
        An empty set adds nothing.
        """
        second = self._other(other)
        return self._made(*hulls.constrained_hull(self._parts, second._parts), second.direction)

    def intersect_strip(self, H: ArrayLike, q: ArrayLike, r: ArrayLike) -> Self:
        """The part with ``|Hx - q| <= r`` for H (..., n), q and r (...) (r = inf: inactive): exact, one factor and one
        row more.

        Algorithm 3 of [AJS+22] with the new columns of G zero, on the strip tightened to the zonotope. Where that strip
        is certainly missed, the row added cannot be met: the result is empty.
        """
        normal = self._argument(H, "H", (self.dimension,))
        self._argument(q, "q", ())
        self._argument(r, "r", (), infinite=True)
        lower, upper = strips.bounds(q, r, self.batch)
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
        m = np.eye(self.dimension) if matrix is None else self._matrix(matrix)
        if m.shape[-2] != second.dimension:
            raise SetError(
                f"matrix has shape {m.shape}, other has dimension {second.dimension}: expected "
                f"(..., {second.dimension}, {self.dimension})"
            )
        cut = intersections.intersect_constrained(self._parts, second._parts, None if matrix is None else m)
        return self._made(*cut, second.direction)

    def _cut(
        self, normals: FloatArray, lower: FloatArray, upper: FloatArray, step: Direction = Direction.EXACT
    ) -> Self:
        """The part with ``lower <= normals @ x <= upper`` (..., K, n), (..., K)."""
        return self._made(*strips.cut_constrained(self._parts, normals, lower, upper), step)

    def reduce_order(self, order: float, method: reduction.ReductionMethod = "girard") -> Self:
        """An enclosing set with at most ``order * n`` generators (at least n plus the constraints): outer; the same set
        if there are no more.

        The zonotope of ``(Gβ, Aβ)`` is enclosed as one and the constraints are kept [SDB+16, section 4.3]; methods as
        for zonotopes. It gains from ``rescale`` and ``reduce_constraints`` beforehand.
        """
        count = reduction.generator_count(order, self.dimension)
        generators, matrix = reduction.reduce_lifted(self.generators, self.constraint_matrix, count, method)
        if generators.shape[-1] == self.generators.shape[-1]:
            return self
        return self._made(self.center, generators, matrix, self.constraint_offset, Direction.OUTER)

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
        return self._made(*factor_bounds.rescale(self._parts))

    def simplify(self) -> Self:
        """The same set without redundant rows and columns: exact (see ``redundancy.simplify``). A batch keeps as
        many of each as its largest set needs."""
        return self._made(*redundancy.simplify(self._parts))

    def support(self, d: ArrayLike) -> FloatArray:
        """Upper bound of ``d·x`` for directions ``d`` (..., K, n), shape (..., K): outer, certified by duality and
        tight up to rounding; -inf where the set is certainly empty."""
        return support.parts_support(self._parts, self._argument(d, "d", (None, self.dimension)))

    def support_certificate(self, d: ArrayLike) -> Certificate:
        """The bounds of ``support`` for ``d`` (..., K, n) with the dual weights that prove them: outer."""
        found = support.solve(*self._parts, self._argument(d, "d", (None, self.dimension)))
        empty = found.empty
        weights = np.where(empty[..., None], found.ray[..., None, :], found.weights)
        return Certificate(np.where(empty, -np.inf, found.bound), weights)

    def interval_hull(self) -> tuple[FloatArray, FloatArray]:
        """Least box around the set, (lower (..., n), upper (..., n)): outer, certified by duality, tight up to
        rounding; (inf, -inf) where the set is certainly empty."""
        return support.interval_hull(self._parts)

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
            return outline.outline(*self._parts).outer
        return outline.polygon_around(self._parts, self._corners(count))

    def volume(self) -> FloatArray:
        """Volume (...): exact in one and two dimensions up to rounding and never below the true one, beyond the outer
        end of ``volume_bracket``."""
        return self.volume_bracket()[1]

    def volume_bracket(self) -> tuple[FloatArray, FloatArray]:
        """(inner, outer) bounds (...) of the volume: from attained points and from certified directions.

        In three to five dimensions they are refined to 1e-3 of each other, or for four rounds, set by set; beyond, the
        inner bound is 0 and the outer one that of the interval hull.
        """
        return volume.constrained_volume_bracket(self._parts)

    def enclosing_zonotope(self) -> Zonotope:
        """A zonotope around the set: outer, the set itself without constraints.

        The smallest of four (by area, or by the widths): the generators without the constraints, the same over what
        these leave the factors, all constraints eliminated, and the interval hull. n generators more hold what rounding
        may have lost.
        """
        if not self.constraint_matrix.shape[-2]:
            return Zonotope(self.center, self.generators, self.direction)
        return Zonotope(*enclosure.enclosing_zonotope(self._parts), compose(self.direction, Direction.OUTER))

    def contains_set(self, other: ConvexSet) -> BoolArray:
        """True (...) where ``other`` certainly lies in this set, up to 1e-7 of its size, the rounding of the centers
        and 1e-12 of the generators of ``other``; False: not shown.

        In the plane the outlines decide, up to that margin both ways, and in one dimension the intervals; beyond, a
        sufficient linear program for each pair (an affine map between the factors, [ST19]). An empty ``other`` lies in
        all.
        """
        return containment.constrained_contains(self._parts, self._other(other)._parts)

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
        return members.sample_constrained(self._parts, rng, *members.asked(count, how))

    @property
    def _parts(self) -> Parts:
        return self.center, self.generators, self.constraint_matrix, self.constraint_offset

    def _own_axes(self) -> tuple[tuple[FloatArray, int], ...]:
        return (self.center, 1), (self.generators, 2), (self.constraint_matrix, 2), (self.constraint_offset, 1)

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

    def _with(self, center: FloatArray, generators: FloatArray) -> Self:
        return self._made(center, generators, self.constraint_matrix, self.constraint_offset)

    def _made(
        self, center: FloatArray, generators: FloatArray, matrix: FloatArray, offset: FloatArray, *steps: Direction
    ) -> Self:
        """A set made from this one by operations, and with operands, of these directions."""
        return type(self)(center, generators, matrix, offset, compose(self.direction, *steps))
