"""Linear upper bounds of h over zonotopes.

For true states x of a zonotope around c, with d = x - c, gradient J(c) and the gradients J and Hessians H over its box:

    h(x) <= h(c) + J(c) d + sup ½ dᵀH d          where h is twice continuously differentiable (Taylor, Lagrange)
    h(x) <= h(c) + a d + sup |J - a| |d|         for any a (mean value theorem)

The remainder of the first is bounded as in ``remainders``. What the context leaves open makes h(c) and J(c) intervals,
each holding the value for the true context: with a the midpoint of J(c), ``|J(c) - a| |d|`` is added. The lesser of the
two constants is taken. Where neither is bounded the constant is +inf.
"""

from dataclasses import dataclass

import numpy as np

from reach_server.numeric.rounding import add_down, add_up, sum_up
from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.predicates.interval_ad.arithmetic import Bounds
from reach_server.predicates.interval_ad.enclosure import PredicateFunction, TaylorEnclosure
from reach_server.predicates.interval_ad.linear_range import reach
from reach_server.predicates.remainders import greatest_curvature, greatest_quadratic, middle, upper_dot
from reach_server.sets.kernels.strip import EMPTY_MARGIN


@dataclass(frozen=True, slots=True, eq=False)
class Expansion:
    """h over zonotopes ``center`` (R, s), ``generators`` (R, s, g) with boxes ``lower``, ``upper`` and half-widths
    ``half`` (R, s): its Taylor enclosures over the ``box`` and at the center (``point``)."""

    center: FloatArray
    generators: FloatArray
    half: FloatArray
    lower: FloatArray
    upper: FloatArray
    box: TaylorEnclosure
    point: TaylorEnclosure

    @staticmethod
    def of(function: PredicateFunction, center: FloatArray, generators: FloatArray, given: Bounds) -> "Expansion":
        """The expansion of a predicate function, from one evaluation for all boxes and centers."""
        half = sum_up(np.abs(generators))
        lower, upper = add_down(center, -half), add_up(center, half)
        twice = np.concatenate([given[0], given[0]], axis=1), np.concatenate([given[1], given[1]], axis=1)
        both = function.enclosure(np.concatenate([lower, center]), np.concatenate([upper, center]), twice)
        rows = len(center)
        return Expansion(center, generators, half, lower, upper, both[:rows], both[rows:])

    def __getitem__(self, rows: BoolArray) -> "Expansion":
        return Expansion(
            self.center[rows], self.generators[rows], self.half[rows], self.lower[rows], self.upper[rows],
            self.box[rows], self.point[rows],
        )  # fmt: skip

    def __neg__(self) -> "Expansion":
        return Expansion(self.center, self.generators, self.half, self.lower, self.upper, -self.box, -self.point)

    def above(self) -> "Above":
        """A linear upper bound of h on the set."""
        value = self.point.value[1]
        tangent, uncertain = middle(self.point.gradient)
        curvature = greatest_curvature(self.box.hessian)
        curved = greatest_quadratic(self.box.hessian, self.generators, curvature)
        by_taylor = add_up(add_up(value, upper_dot(uncertain, self.half)), curved)
        slope, spread = middle(self.box.gradient)
        by_mean = add_up(value, upper_dot(spread, self.half))
        usable = self.box.smooth & np.isfinite(np.minimum(by_taylor, by_mean))
        taylor = by_taylor <= by_mean
        normal = np.where((usable & taylor)[:, None], tangent, np.where(usable[:, None], slope, 0.0))
        top = np.where(usable, np.where(taylor, by_taylor, by_mean), np.inf)
        linear = np.where(usable, add_up(top, reach(normal, self.generators)), np.inf)
        size = np.where(np.isfinite(value), np.abs(value), 0.0)
        size = size + upper_dot(np.abs(normal), np.abs(self.center) + self.half)
        return Above(normal, top, np.minimum(self.box.value[1], linear), size, curvature)


@dataclass(frozen=True, slots=True, eq=False)
class Above:
    """``h(x) <= top + normal·(x - c)`` and ``h(x) <= greatest`` on the set: normal (R, s), top and greatest (R,).

    ``size`` (R,): how large the numbers are that h is made of there, as far as its value and slope tell; ``curvature``
    (R,): no eigenvalue of a Hessian is greater.
    """

    normal: FloatArray
    top: FloatArray
    greatest: FloatArray
    size: FloatArray
    curvature: FloatArray

    @property
    def negative(self) -> BoolArray:
        """Where h is certainly negative on the whole set, by more than the rounding of the set itself."""
        return np.asarray(self.greatest < -EMPTY_MARGIN * self.size)
