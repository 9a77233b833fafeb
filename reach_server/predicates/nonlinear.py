"""Predicates ``h >= 0`` of any smooth h: cuts that depend on the set that is cut, and on the context.

A set holds states y whose true states are ``x = y + Bζ``, ``|ζ| <= 1`` (noise and motion, ``StateUncertainty``). So x
lies in the zonotope ``<c, [G, B]>``, over which h is expanded. Any ``h(x) <= top + a·(x - c)`` there gives, for x with
``h(x) >= 0``, the half-space ``a·x >= a·c - top``, and for y ``a·y >= a·c - top - |aB|₁``. It is one for each set;
where h is concave on the box, many (see ``concave``). A predicate says nothing where h is not defined, so a box that is
not wholly in its domain is not cut.
"""

from dataclasses import dataclass

import numpy as np

from reach_server.numeric.rounding import add_down, add_up
from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.predicates.concave import border, directions, tangents
from reach_server.predicates.expansion import Above, Expansion
from reach_server.predicates.halfspace import verdict_of
from reach_server.predicates.interface import Context, StateUncertainty, Strips, Verdict
from reach_server.predicates.interval_ad.arithmetic import Bounds
from reach_server.predicates.interval_ad.enclosure import PredicateFunction
from reach_server.predicates.interval_ad.linear_range import dot, product, reach
from reach_server.sets.kernels.strip import EMPTY_MARGIN

#: Tangents are stacked where what is missing to concavity adds less than this, relative to the range of h.
NEARLY_CONCAVE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class NonlinearEnclosure:
    """The predicate ``function >= 0`` over the first n states of a class."""

    function: PredicateFunction
    n: int
    uncertainty: StateUncertainty

    @property
    def fixed(self) -> bool:
        """False."""
        return False

    def verdict(self, center: FloatArray, generators: FloatArray, context: Context) -> Verdict:
        """See ``PredicateEnclosure``: by bounds of h over the set."""
        with np.errstate(all="ignore"):
            moved, _ = self._expanded(center, generators, context, self.uncertainty.still())
            same = not self.uncertainty.motion.any() and not self.function.timed
            still = moved if same else self._expanded(center, generators, context, None)[0]
            return verdict_of((-still).above().greatest <= 0, moved.above().negative)

    def strips(self, center: FloatArray, generators: FloatArray, context: Context) -> tuple[Strips, BoolArray]:
        """See ``PredicateEnclosure``: normal (R, C, n), half-spaces from below."""
        with np.errstate(all="ignore"):
            expansion, given = self._expanded(center, generators, context, self.uncertainty)
            above = expansion.above()
            normal, bound = self._half_spaces(expansion, above, given)
            empty = self._empty(expansion, above, given, normal, bound)
            coordinates = list(self.function.coordinates)
            lower = add_down(bound, -reach(normal, self.uncertainty.generators[coordinates]))
        wide = np.zeros((*bound.shape, self.n))
        wide[..., coordinates] = normal
        return Strips(wide, lower, np.full_like(lower, np.inf)), empty

    def _expanded(
        self, center: FloatArray, generators: FloatArray, context: Context, uncertainty: StateUncertainty | None
    ) -> tuple[Expansion, Bounds]:
        """The expansion over the true states of sets, as far as they may have moved; None: states as they are."""
        coordinates = list(self.function.coordinates)
        rows = len(center)
        columns = generators[:, coordinates]
        if uncertainty is not None:
            more = uncertainty.generators[coordinates]
            columns = np.concatenate([columns, np.broadcast_to(more, (rows, *more.shape))], axis=2)
        given = self.function.given(context, rows, None if uncertainty is None else uncertainty.margin)
        return Expansion.of(self.function, center[:, coordinates], columns, given), given

    def _half_spaces(self, expansion: Expansion, above: Above, given: Bounds) -> tuple[FloatArray, FloatArray]:
        """``normal·x >= bound`` (R, C, s), (R, C) for true states."""
        rows, s = expansion.center.shape
        if not s:
            return np.zeros((rows, 0, 0)), np.zeros((rows, 0))
        level = add_down(dot(above.normal, expansion.center)[0], -above.top)
        level = np.where(np.isfinite(level), level, -np.inf)
        concave = self._concave(expansion, above.curvature)
        if not concave.any():
            return above.normal[:, None], level[:, None]
        normal = np.zeros((rows, len(directions(s)), s))
        bound = np.full(normal.shape[:2], -np.inf)
        normal[:, 0], bound[:, 0] = above.normal, level
        some = expansion[concave]
        chosen = given[0][:, concave], given[1][:, concave]
        points = border(self.function, some, chosen)
        normal[concave], bound[concave] = tangents(
            self.function, points, chosen, some.center, some.half, above.curvature[concave]
        )
        return normal, bound

    def _concave(self, expansion: Expansion, curvature: FloatArray) -> BoolArray:
        """Where tangents can be stacked (R,)."""
        if self.function.affine:
            return np.zeros(len(curvature), dtype=bool)
        missing = np.maximum(curvature, 0.0) * 2 * (expansion.half**2).sum(axis=1)
        low, high = expansion.box.value
        bounded = expansion.box.smooth & np.isfinite(high - low)
        return np.asarray(bounded & (missing <= NEARLY_CONCAVE * (high - low)))

    def _empty(
        self, expansion: Expansion, above: Above, given: Bounds, normal: FloatArray, bound: FloatArray
    ) -> BoolArray:
        """Where h is certainly negative on the set, or on what its half-spaces leave of its box."""
        empty = above.negative
        # A center that may satisfy the predicate leaves no hope.
        doubtful = ~empty & (expansion.point.value[1] < 0)
        if not doubtful.any() or not normal.shape[1]:
            return empty
        lower, upper, removed = contracted(
            expansion.lower[doubtful], expansion.upper[doubtful], normal[doubtful], bound[doubtful]
        )
        remaining = self.function.values(lower, upper, (given[0][:, doubtful], given[1][:, doubtful]))[1]
        empty[doubtful] = removed | (remaining < -EMPTY_MARGIN * above.size[doubtful])
        return empty


def contracted(
    lower: FloatArray, upper: FloatArray, normal: FloatArray, bound: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Boxes (R, s) without what half-spaces ``normal·x >= bound`` (R, C, s), (R, C) exclude: outer; and where nothing
    is left of them, by more than the rounding of the comparison."""
    low, high = lower.copy(), upper.copy()
    margin = EMPTY_MARGIN * (np.abs(lower) + np.abs(upper))
    removed = np.zeros(len(lower), dtype=bool)
    for c in range(bound.shape[1]):
        a = normal[:, c]
        most = np.maximum(product(a, low)[1], product(a, high)[1])
        for i in range(lower.shape[1]):
            others = np.zeros(len(lower))
            for j in range(lower.shape[1]):
                others = others if j == i else add_up(others, most[:, j])
            # a_i x_i >= bound - what the others can add at most
            with np.errstate(all="ignore"):
                end = add_down(bound[:, c], -others) / a[:, i]
                before, beyond = np.nextafter(end, -np.inf), np.nextafter(end, np.inf)
            low_i = np.where((a[:, i] > 0) & np.isfinite(end), np.maximum(low[:, i], before), low[:, i])
            high_i = np.where((a[:, i] < 0) & np.isfinite(end), np.minimum(high[:, i], beyond), high[:, i])
            removed |= low_i > high_i + margin[:, i]
            crossed = low_i > high_i
            low[:, i] = np.where(crossed, low[:, i], low_i)
            high[:, i] = np.where(crossed, high[:, i], high_i)
            most[:, i] = np.maximum(product(a[:, i], low[:, i])[1], product(a[:, i], high[:, i])[1])
    return low, high, removed
