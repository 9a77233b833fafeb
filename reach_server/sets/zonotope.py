"""``Zonotope``: ``{c + Gβ : |β| <= 1}``, any number of leading batch axes."""

from dataclasses import dataclass
from typing import Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from reach_server.numeric.checks import (
    SetError,
    batch_shape,
    block_diagonal,
    checked,
    checked_batch,
    checked_dimension,
    stack_columns,
)
from reach_server.numeric.rounding import EPS, add_down, add_up, sum_up
from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.sets import containment, redundancy, sampling, support, volume
from reach_server.sets import halfspace as strips
from reach_server.sets import hull as hulls
from reach_server.sets import intersection as intersections
from reach_server.sets import order_reduction as reduction
from reach_server.sets import polygon as planar
from reach_server.sets._shared_verbs import SharedVerbs
from reach_server.sets.approximation import Direction, compose
from reach_server.sets.parts import Parts, without_rows
from reach_server.sets.sampling import SampleMethod


@runtime_checkable
class ConvexSet(Protocol):
    """What a question about two sets asks of the other one."""

    @property
    def dimension(self) -> int:
        """The dimension n of the space."""

    def support(self, d: ArrayLike) -> FloatArray:
        """An upper bound of ``d·x``."""

    def enclosing_zonotope(self) -> "Zonotope":
        """A zonotope around the set."""


@dataclass(frozen=True, eq=False)
class Zonotope(SharedVerbs):
    """Zonotopes with ``center`` (..., n) and ``generators`` (..., n, g); never empty.

    ``direction`` says how the set relates to the true result of the operations that made it; every operation composes
    it. *Exact* and *outer* hold for exact arithmetic on the given numbers: center and generators carry the rounding of
    their own sums and products, at most ``n + 2`` ulps of the sum of the absolute terms for each operation. A cut that
    misses by less than 1e-9 of the numbers compared counts as touching. Bounds that
    come back as numbers (``support``, ``interval_hull``, ``volume_bracket``) and the lengths that a reduction adds up
    are rounded outwards.

    The arrays are not copied, only the set's view of them is read-only. Numbers are in whatever units the caller uses.
    Raises ``SetError`` for wrong shapes, NaN or infinities, and for dimension 0; so does every verb for its arguments,
    also where their batch axes do not go with those of the set.
    """

    center: FloatArray
    generators: FloatArray
    direction: Direction = Direction.EXACT

    def __post_init__(self) -> None:
        center = checked(self.center, "center", (None,))
        checked_dimension(center, -1, "center")
        generators = checked(self.generators, "generators", (center.shape[-1], None))
        batch_shape((center, 1), (generators, 2))
        if not isinstance(self.direction, Direction):
            raise SetError(f"direction is {self.direction!r}, expected a Direction")
        object.__setattr__(self, "center", center)
        object.__setattr__(self, "generators", generators)

    @classmethod
    def _free(cls, center: FloatArray, generators: FloatArray) -> Self:
        return cls(center, generators)

    def minkowski_sum(self, other: "Zonotope") -> Self:
        """``{a + b}`` for a of this set and b of ``other``: exact [Gir05]; batch axes are broadcast."""
        self._same_space(other, "minkowski_sum")
        return self._with(self.center + other.center, stack_columns(self.generators, other.generators), other.direction)

    def cartesian_product(self, other: "Zonotope") -> Self:
        """``{(a, b)}`` in n1 + n2 dimensions: exact."""
        _zonotope(other, "cartesian_product")
        self._checked_batch_of(other)
        batch = np.broadcast_shapes(self.batch, other.batch)
        centers = [np.broadcast_to(z.center, (*batch, z.dimension)) for z in (self, other)]
        generators = block_diagonal(self.generators, other.generators)
        return self._with(np.concatenate(centers, axis=-1), generators, other.direction)

    def convex_hull(self, other: "Zonotope") -> Self:
        """A zonotope around both sets, with at most ``g1 + g2 + 1`` generators: outer [Gir05]."""
        self._same_space(other, "convex_hull")
        center, generators = hulls.zonotope_hull(self.center, self.generators, other.center, other.generators)
        return self._with(center, generators, Direction.OUTER, other.direction)

    def intersect_strip(self, H: ArrayLike, q: ArrayLike, r: ArrayLike, method: strips.StripMethod = "tight") -> Self:
        """An enclosure of the part with ``|Hx - q| <= r``: outer [ABC05, ABC06].

        H (..., n); q and r (...), r = inf: inactive. With ``tight`` the result is never larger than the set, by area or
        by widths; with ``frobenius`` (Algorithm 2 of [AJS+22]) it may be. Where the intersection is certainly empty the
        set comes back unchanged; ask ``misses_strip``. Raises ``SetError`` for a negative r and an unknown method.
        """
        return self._cut(H, *strips.bounds(q, r, self.batch), method)

    def intersect_halfspace(self, H: ArrayLike, q: ArrayLike, method: strips.StripMethod = "tight") -> Self:
        """An enclosure of the part with ``Hx <= q`` for H (..., n), q (...) (q = inf: inactive): outer; unchanged where
        that part is certainly empty."""
        return self._cut(H, np.asarray(-np.inf), self._argument(q, "q", (), infinite=True), method)

    def intersect_tangents(self, H: ArrayLike, q: ArrayLike, method: strips.StripMethod = "tight") -> Self:
        """An enclosure of the part with ``Hx <= q`` for all rows of H (..., K, n), q (..., K); inf: inactive; outer.

        The cuts follow in the order given; it matters. Where one is certainly missed it changes nothing.
        """
        normals = self._argument(H, "H", (None, self.dimension))
        bounds = self._argument(q, "q", (normals.shape[-2],), infinite=True)
        center, generators = intersections.intersect_halfspaces(
            self.center, self.generators, normals, bounds, strips.known(method)
        )
        return self._with(center, generators, Direction.OUTER)

    def intersect_linearised(
        self,
        J: ArrayLike,
        h0: ArrayLike,
        remainder: tuple[ArrayLike, ArrayLike],
        r: ArrayLike,
        method: strips.StripMethod = "tight",
    ) -> Self:
        """An enclosure of the part with ``|h(x)| <= r`` where ``h(x)`` is in ``h0 + J(x - center) + [lower, upper]``.

        J (..., n); h0, r and both ends of ``remainder`` = (lower, upper) have shape (...,); an infinite remainder or r
        is inactive; outer. Algorithm 2 of [AJS+22] with its parallel columns λr and λG_L added up: the strip
        ``|J(x - c) + h0 + mid| <= r + rad``, rounded outwards.
        """
        normal = self._argument(J, "J", (self.dimension,))
        return self._cut(normal, *strips.linearised(normal, self.center, h0, remainder, r, self.batch), method)

    def intersection(self, other: "Zonotope", matrix: ArrayLike | None = None) -> Self:
        """A zonotope around ``{x in self : Rx in other}`` (R = ``matrix`` (..., k, n), None: identity): outer.

        Some zonotope comes back where that is empty, too; ask ``intersects``. Raises ``SetError`` where the rows of the
        matrix are not as many as the dimensions of ``other``.
        """
        _zonotope(other, "intersection")
        m = np.eye(self.dimension) if matrix is None else self._matrix(matrix)
        if m.shape[-2] != other.dimension:
            raise SetError(f"matrix has shape {m.shape}, expected (..., {other.dimension}, {self.dimension}) for other")
        self._checked_batch_of(other)
        center, generators = intersections.intersect_zonotope(
            self.center, self.generators, m, other.center, other.generators
        )
        return self._with(center, generators, Direction.OUTER, other.direction)

    def misses_strip(self, H: ArrayLike, q: ArrayLike, r: ArrayLike) -> BoolArray:
        """True (...) where no point of the set has ``|Hx - q| <= r``, for H (..., n), q and r (...): certain where
        True, by a relative margin of 1e-9."""
        normal = self._argument(H, "H", (self.dimension,))
        lower, upper = strips.bounds(q, r, self.batch)
        return np.asarray(strips.strip_bounds(self.center, self.generators, normal, lower, upper)[3])

    def _cut(self, H: ArrayLike, lower: FloatArray, upper: FloatArray, method: strips.StripMethod) -> Self:
        normal = self._argument(H, "H", (self.dimension,))
        center, generators, _ = strips.intersect_strip(
            self.center, self.generators, normal, lower, upper, method=strips.known(method)
        )
        return self._with(center, generators, Direction.OUTER)

    def reduce_order(self, order: float, method: reduction.ReductionMethod = "girard") -> Self:
        """An enclosing zonotope with at most ``order * n`` generators (at least n): outer; the same set if there are no
        more. Methods: girard [Gir05], combastel [Com03], pca [KSA17], scott [SDB+16]. Raises ``SetError`` for an order
        that is not positive or an unknown method."""
        count = reduction.generator_count(order, self.dimension)
        generators = reduction.reduce_generators(self.generators, count, method)
        same = generators.shape[-1] == self.generators.shape[-1]
        return self._with(self.center, generators, Direction.EXACT if same else Direction.OUTER)

    def simplify(self) -> Self:
        """The same set without zero generators and with parallel ones merged: exact (see ``redundancy``). A batch keeps
        as many generators as its largest set needs."""
        return self._with(self.center, redundancy.drop_zero(redundancy.merge_parallel(self.generators)))

    def support(self, d: ArrayLike) -> FloatArray:
        """Greatest ``d·x`` for directions ``d`` (..., K, n), shape (..., K): exact, rounded up by ``n + g + 2`` ulps
        of ``|d|·(|c| + |G|1)``."""
        directions = self._argument(d, "d", (None, self.dimension))
        value = support.zonotope_support(self.center, self.generators, directions)
        size = np.abs(self.center) + np.abs(self.generators).sum(axis=-1)
        terms = sum(self.generators.shape[-2:]) + 2
        return np.asarray(value + terms * EPS * (np.abs(directions) @ size[..., None])[..., 0])

    def interval_hull(self) -> tuple[FloatArray, FloatArray]:
        """Least box around the set, (lower (..., n), upper (..., n)): exact, rounded outwards by g ulps of its size."""
        half = sum_up(np.abs(self.generators))
        return add_down(self.center, -half), add_up(self.center, half)

    def volume(self) -> FloatArray:
        """Volume (...): exact [GK10]. Beyond the plane every choice of n generators is looked at: for many generators
        ask ``volume_bracket``."""
        if self.dimension == 2:
            return np.broadcast_to(planar.zonotope_area(self.generators), self.batch)
        return np.broadcast_to(planar.zonotope_volume(self.generators), self.batch)

    def volume_bracket(self) -> tuple[FloatArray, FloatArray]:
        """(inner, outer) bounds (...) of the volume, equal up to rounding where it is cheap (see ``volume``)."""
        inner, outer = volume.zonotope_volume_bracket(self.generators)
        return np.broadcast_to(inner, self.batch), np.broadcast_to(outer, self.batch)

    def polygon(self, count: int | None = None) -> FloatArray:
        """Vertices (..., V, 2) of planar sets, counter-clockwise: exact, V = 2 g (1 without generators). With ``count``
        (at least 3): an outer polygon of that many vertices, tight in as many directions at equal angles. Raises
        ``SetError`` for a smaller count and in other dimensions."""
        self._planar("polygon")
        if count is None:
            return planar.zonotope_polygon(self.center, self.generators)
        # About the center: far from the origin, products with the directions would round away the shape.
        around = Zonotope(np.zeros(2), self.generators).support(planar.directions(self._corners(count)))
        return self.center[..., None, :] + planar.outer_polygon(around)

    def enclosing_zonotope(self) -> "Zonotope":
        """The set itself: exact."""
        return self

    def contains_set(self, other: ConvexSet) -> BoolArray:
        """True (...) where ``other`` certainly lies in this set, up to 1e-7 of its size; False: not shown.

        Up to the plane the support of ``other`` decides: where it is exact, False is certain, too. Beyond, a sufficient
        condition does [ST19], for sets that are no zonotopes about the enclosing one. Raises ``SetError`` for another
        dimension or what is no set.
        """
        if not isinstance(other, ConvexSet):
            raise SetError(f"other is a {type(other).__name__}, expected a Zonotope or a ConstrainedZonotope")
        if other.dimension != self.dimension:
            raise SetError(f"other has dimension {other.dimension}, expected {self.dimension}")
        zonotope = other.enclosing_zonotope()
        self._checked_batch_of(zonotope)
        if self.dimension <= 2 and not isinstance(other, Zonotope):
            normals = containment.face_normals(self.generators)
            normals = np.concatenate([normals, -normals], axis=-2)
            size = np.abs(zonotope.center) + np.abs(zonotope.generators).sum(axis=-1)
            return containment.polytope_contains(
                self.center, self.generators, normals, other.support(normals), size, zonotope.generators.shape[-1]
            )
        return containment.zonotope_contains(self.center, self.generators, zonotope.center, zonotope.generators)

    def intersects(self, other: "Zonotope") -> BoolArray:
        """False (...) where the two sets are certainly disjoint (a separating direction was found); True otherwise.

        Exact up to rounding: in the plane by all directions that matter, beyond by a linear program.
        """
        self._same_space(other, "intersects")
        return ~containment.certainly_disjoint(self.center, self.generators, other.center, other.generators)

    def is_empty(self) -> BoolArray:
        """False (...): exact, a zonotope always holds its center."""
        return np.zeros(self.batch, dtype=bool)

    def sample(self, rng: np.random.Generator, count: int, how: SampleMethod = "inside") -> FloatArray:
        """Members (..., count, n), exact up to rounding.

        ``inside``: uniform by volume; ``boundary``: on the boundary, uniform by area in general position (both: see
        ``tiling``); ``factors``: independent factors, some points with all of them at their bounds. Raises ``SetError``
        for another ``how``.
        """
        return sampling.sample_zonotopes(self.center, self.generators, rng, *sampling.asked(count, how))

    @property
    def _parts(self) -> Parts:
        return without_rows(self.center, self.generators)

    def _own_axes(self) -> tuple[tuple[FloatArray, int], ...]:
        return (self.center, 1), (self.generators, 2)

    def _with(self, center: FloatArray, generators: FloatArray, *steps: Direction) -> Self:
        """A set made from this one by operations, and with operands, of these directions."""
        return type(self)(center, generators, compose(self.direction, *steps))

    def _checked_batch_of(self, other: "Zonotope") -> None:
        checked_batch(other.center, 1, "other", self.batch)
        checked_batch(other.generators, 2, "other", self.batch)

    def _same_space(self, other: "Zonotope", verb: str) -> None:
        _zonotope(other, verb)
        if other.dimension != self.dimension:
            raise SetError(f"other has dimension {other.dimension}, expected {self.dimension}")
        self._checked_batch_of(other)


def _zonotope(other: object, verb: str) -> None:
    if not isinstance(other, Zonotope):
        raise SetError(
            f"other is a {type(other).__name__}, {verb} of a Zonotope expects a Zonotope: "
            "convert one of the two (enclosing_zonotope, ConstrainedZonotope.from_zonotope)"
        )
