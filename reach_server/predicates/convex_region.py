"""Discs and ellipsoids: regions whose tangents are the same for every set.

Where h is a parabola whose Hessian H has no eigenvalue above ``-λ < 0``, a state with ``h >= 0`` is near the peak p:
``0 <= h(p) + ∇h(p) d - ½ λ |d|²`` gives ``|d| <= (|∇h(p)| + sqrt(|∇h(p)|² + 2 λ h(p))) / λ``. In that box all
tangents hold (see ``concave``), and no state outside of it matters. At opposite points of the border tangents are
parallel, so that two make one strip.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from reach_server.numeric.rounding import add_up
from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.predicates.concave import directions
from reach_server.predicates.concave import tangents as tangents_at
from reach_server.predicates.discs import DISC_TANGENTS, tangents
from reach_server.predicates.halfspace import FixedStrips, missed
from reach_server.predicates.interface import HOLDS, NEVER, Context, StateUncertainty, Strips, Verdict
from reach_server.predicates.interval_ad.enclosure import PredicateFunction
from reach_server.predicates.nonlinear import NonlinearEnclosure
from reach_server.predicates.remainders import greatest_curvature, middle, upper_dot
from side_info.stl.expression import Expression, Name, Negation, Number, Power, Sum
from side_info.stl.predicates import DiscPredicate


@dataclass(frozen=True, slots=True, eq=False)
class ConvexRegionEnclosure:
    """A region within the tangents ``region``, and its definition, which says whether a set lies in it."""

    region: FixedStrips
    definition: NonlinearEnclosure

    @property
    def fixed(self) -> bool:
        """True."""
        return True

    def verdict(self, center: FloatArray, generators: FloatArray, context: Context) -> Verdict:
        """See ``PredicateEnclosure``."""
        found = self.definition.verdict(center, generators, context)
        beyond = missed(self.region.moved, center, generators) & (found != HOLDS)
        return np.where(beyond, NEVER, found).astype(np.int8)

    def strips(self, center: FloatArray, generators: FloatArray, context: Context) -> tuple[Strips, BoolArray]:
        """See ``PredicateEnclosure``."""
        return self.region.cut, missed(self.region.cut, center, generators)


def disc_strips(
    predicate: DiscPredicate, index: Mapping[str, int], n: int, uncertainty: StateUncertainty
) -> FixedStrips:
    """The strips of a disc's tangents."""
    directions, bounds = tangents(np.array(list(predicate.center.values())), predicate.radius)
    half = DISC_TANGENTS // 2
    normal = np.zeros((half, n))
    for name, column in zip(predicate.center, directions[:half].T, strict=True):
        # A profile may map both coordinates to the same state.
        normal[:, index[name]] += column
    return FixedStrips(normal, -bounds[half:], bounds[:half], uncertainty)


def disc_expression(predicate: DiscPredicate) -> Expression:
    """``r² - (x - q)²`` over both coordinates."""

    def number(value: float) -> Expression:
        return Negation(Number(-value)) if value < 0 else Number(value)

    offsets = (Sum((Name(name), Negation(number(value)))) for name, value in predicate.center.items())
    squares = (Negation(Power(offset, Number(2.0))) for offset in offsets)
    return Sum((Power(Number(predicate.radius), Number(2.0)), *squares))


def ellipsoid_strips(function: PredicateFunction, n: int, uncertainty: StateUncertainty) -> FixedStrips | None:
    """The strips of tangents around ``h >= 0``; None where that is no ellipsoid, or hardly one."""
    s = function.dimension
    if not function.quadratic or not s:
        return None
    with np.errstate(all="ignore"):
        found = _ellipsoid(function)
    if found is None:
        return None
    half_normal, lower, upper = found
    normal = np.zeros((len(lower), n))
    normal[:, list(function.coordinates)] = half_normal
    return FixedStrips(normal, lower, upper, uncertainty)


def _ellipsoid(function: PredicateFunction) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """normal (C, s), lower and upper (C,) over the states of the function."""
    s = function.dimension
    nothing = np.zeros((0, 1)), np.zeros((0, 1))
    origin = np.zeros((1, s))
    at_origin = function.enclosure(origin, origin, nothing)
    curvature = greatest_curvature(at_origin.hessian)
    hessian, gradient = middle(at_origin.hessian)[0][0], middle(at_origin.gradient)[0][0]
    # An ellipsoid a million times longer than wide is as good as unbounded.
    if not curvature[0] < -1e-12 * np.abs(hessian).max():
        return None
    peak = np.linalg.solve(hessian, -gradient)[None]
    enclosure = function.enclosure(peak, peak, nothing)
    highest = enclosure.value[1][0]
    steep = np.maximum(np.abs(enclosure.gradient[0]), np.abs(enclosure.gradient[1])).sum()
    if not (np.isfinite(highest) and np.isfinite(steep)) or enclosure.value[0][0] <= 0:
        return None
    bend = -curvature[0]
    far = np.full((1, s), (1 + 1e-9) * (steep + np.sqrt(steep**2 + 2 * bend * highest)) / bend)
    values, vectors = np.linalg.eigh(-hessian / (2 * highest))
    root = (vectors / np.sqrt(values)) @ vectors.T
    points = peak + directions(s) @ root
    normal, bound = (a[0] for a in tangents_at(function, points[None], nothing, peak, far, curvature))
    if not np.isfinite(bound).all():
        return None
    half = len(bound) // 2
    apart = upper_dot(np.abs(normal[:half] + normal[half:]) * (1 + 1e-9), np.abs(peak) + 2 * far)
    return normal[:half], bound[:half], add_up(-bound[half:], apart)
