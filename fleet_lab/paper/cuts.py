"""Sets cut by the paper's functions: Algorithms 2 and 3 as they are published, and as this project does it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_lab.paper.formulas import Disc, Formula, Motion, Strip, active
from reach_server.numeric.checks import stack_columns
from reach_server.numeric.types import FloatArray
from reach_server.predicates.discs import tangents
from reach_server.sets import ConstrainedZonotope, Zonotope
from reach_server.sets import halfspace as strips

#: m: a state counts as outside of a set only if it is by more than this; rounding.
ROUNDING: Final = 1e-9
#: Passes over the strips of a zonotope: they do not commute.
_PASSES: Final = 2


@dataclass(frozen=True, slots=True, eq=False)
class Situation:
    """What a formula refers to in S steps: ``t`` (S,) s of the state that is predicted, and the ``last`` position
    (S, 2) m and heading (S,) rad, which T(x) starts from; the true last position is within ``unknown`` (2, g) of it."""

    t: FloatArray
    last: FloatArray
    heading: FloatArray
    unknown: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """One strip for each of S sets, ``|normal·x - middle| <= radius``: (S, 2), (S,), (S,); an infinite radius where it
    is not asked for. ``remainder`` (S,) is what a linearisation leaves, part of no bound yet."""

    normal: FloatArray
    middle: FloatArray
    radius: FloatArray
    remainder: FloatArray | float = 0.0

    @property
    def widened(self) -> FloatArray:
        """The radius with the remainder."""
        wide: FloatArray = self.radius + self.remainder
        return wide

    def holds(self, position: FloatArray) -> NDArray[np.bool_]:
        """Whether positions (S, 2) lie in their strips, up to rounding."""
        found: NDArray[np.bool_] = np.abs((self.normal * position).sum(axis=1) - self.middle) <= self.widened + ROUNDING
        return found


@dataclass(frozen=True, slots=True, eq=False)
class CutSets:
    """Sets after their cuts, and what says whether each true state lies in its own."""

    sets: Zonotope | ConstrainedZonotope
    judge: Callable[[], NDArray[np.bool_]]

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Whether each true state (S,) lies in its set."""
        return self.judge()


def published_zonotopes(
    sets: Zonotope, formula: Formula, at: Situation, truth: FloatArray, *, remainder: bool = False
) -> CutSets:
    """Algorithm 2 [AJS+22], function after function: an outer bound.

    With ``remainder`` a disc's linearisation carries its Lagrange remainder, as printed. Without, as in the code that
    made the tables, it is an outer bound all the same: a norm is convex, and its linearisation a tangent.
    """
    center, generators = np.array(sets.center), np.array(sets.generators)
    for row in (_strip(strip, at.t) for strip in formula.strips):
        center, generators = algorithm_2(center, generators, row)
    for disc in formula.discs:
        center, generators = algorithm_2(
            center, generators, _linearised(disc, Zonotope(center, generators), at.t, remainder)
        )
    for row in _motion(formula.motion, at):
        center, generators = algorithm_2(center, generators, row)
    found = Zonotope(center, generators)
    return CutSets(found, lambda: holds(found, truth))


def published_constrained(
    sets: Zonotope, formula: Formula, at: Situation, truth: FloatArray, *, remainder: bool = False
) -> CutSets:
    """Algorithm 3 [AJS+22]: exact for strips, an outer bound for discs (see ``published_zonotopes``)."""
    rows = [_strip(strip, at.t) for strip in formula.strips]
    rows += [_linearised(disc, sets, at.t, remainder) for disc in formula.discs]
    return _constrained(sets, [*rows, *_motion(formula.motion, at)], truth)


def our_zonotopes(sets: Zonotope, formula: Formula, at: Situation, truth: FloatArray) -> CutSets:
    """Strips tightened to the set and the best of several λ, a disc by its tangents: an outer bound, never larger than
    the set."""
    rows = _rows(formula, at)
    normal = np.stack([row.normal for row in rows], axis=1)
    middle, radius = (np.stack([getattr(row, name) for row in rows], axis=1) for name in ("middle", "radius"))
    found = Zonotope(sets.center, sets.generators)
    for _ in range(_PASSES):
        cut = strips.narrow(
            found.center, found.generators, normal, middle - radius, middle + radius, np.isfinite(radius)
        )
        found = Zonotope(cut.center, cut.generators[..., : int(cut.used.max())])
    return CutSets(found, lambda: holds(found, truth))


def our_constrained(sets: Zonotope, formula: Formula, at: Situation, truth: FloatArray) -> CutSets:
    """Exact cuts, a disc by its tangents: an outer bound."""
    return _constrained(sets, _rows(formula, at), truth)


def holds(sets: Zonotope, points: FloatArray) -> NDArray[np.bool_]:
    """Whether points (S, 2) lie in their planar zonotopes (S), up to ``ROUNDING``: exact.

    A planar zonotope is the intersection of the strips along its sides, which are parallel to its generators; those
    along the axes do not cut more, and bound one without area.
    """
    center, generators = sets.center, sets.generators
    sides = np.stack([-generators[:, 1], generators[:, 0]], axis=-1)
    length = np.linalg.norm(sides, axis=-1, keepdims=True)
    axes = np.broadcast_to(np.eye(2), (len(center), 2, 2))
    normals = np.concatenate([np.divide(sides, length, out=np.zeros_like(sides), where=length > 0), axes], axis=1)
    reach = np.abs(normals @ generators).sum(axis=-1)
    offset = np.abs((normals @ (points - center)[..., None])[..., 0])
    found: NDArray[np.bool_] = (offset <= reach + ROUNDING).all(axis=-1)
    return found


def _rows(formula: Formula, at: Situation) -> list[Row]:
    tangential = [row for disc in formula.discs for row in _tangents(disc, at.t)]
    return [*(_strip(strip, at.t) for strip in formula.strips), *tangential, *_motion(formula.motion, at)]


def _constrained(sets: Zonotope, rows: list[Row], truth: FloatArray) -> CutSets:
    """The intersection with the rows; the truth is in it iff it is in the set and in every strip."""
    # The same set with parallel generators joined, which outlines are much quicker of.
    found = ConstrainedZonotope.from_zonotope(sets.simplify())
    for row in rows:
        found = found.intersect_strip(row.normal, row.middle, row.widened)
    return CutSets(found, lambda: np.all([holds(sets, truth), *(row.holds(truth) for row in rows)], axis=0))


def printed_motion(sets: Zonotope, formula: Formula, at: Situation, truth: FloatArray) -> CutSets:
    """Algorithm 3 with h6 and h7 as printed, their centers exchanged: no outer bound, a demonstration."""
    assert formula.motion is not None
    rows = [_strip(strip, at.t) for strip in formula.strips]
    return _constrained(sets, [*rows, *motion_as_printed(formula.motion, at)], truth)


def algorithm_2(center: FloatArray, generators: FloatArray, row: Row) -> tuple[FloatArray, FloatArray]:
    """One pass of Algorithm 2 [AJS+22], lines 4 to 11, for centers (S, 2) and generators (S, 2, g), with the λ of least
    Frobenius norm, also where the strip does not cut: outer, and often larger than before."""
    asked = np.isfinite(row.radius)
    radius = np.where(asked, row.radius, 0.0)
    remainder = np.where(asked & np.isfinite(row.remainder), row.remainder, 0.0)
    asked &= np.isfinite(row.remainder)
    heights = (row.normal[:, None] @ generators)[:, 0]
    spread = (generators @ heights[..., None])[..., 0]
    gain = (heights**2).sum(axis=1) + radius**2 + remainder**2
    gained = np.where(asked[:, None], spread / gain[:, None], 0.0)
    moved = center + gained * (row.middle - (row.normal * center).sum(axis=1))[:, None]
    kept = generators - gained[..., None] * heights[:, None]
    return moved, stack_columns(kept, (gained * radius[:, None])[..., None], (gained * remainder[:, None])[..., None])


def _strip(strip: Strip, t: FloatArray) -> Row:
    normal = np.broadcast_to(np.array(strip.normal), (len(t), 2))
    return Row(normal, np.full(len(t), strip.middle), np.where(active(strip, t), strip.radius, np.inf))


def _linearised(disc: Disc, sets: Zonotope, t: FloatArray, remainder: bool) -> Row:
    """``| |x - q| | <= r`` linearised at the centers of the sets.

    The Hessian of the norm is (I - nnᵀ)/ρ: on a box whose least distance from q is ρ0 its entries are at most 1/ρ0 on
    the diagonal and 1/(2 ρ0) beside it, so for |x - x*| <= d the remainder is at most (d1² + d2² + d1 d2)/(2 ρ0)
    (Althoff 2010, p. 65); unbounded where the box holds q.
    """
    offset = sets.center - disc.center
    distance = np.maximum(np.hypot(*offset.T), np.finfo(np.float64).tiny)
    normal = offset / distance[:, None]
    # h0 + n (x - x*) with h0 = |x* - q| is n (x - q).
    row = Row(normal, normal @ np.array(disc.center), np.where(active(disc, t), disc.radius, np.inf))
    if not remainder:
        return row
    half = np.abs(sets.generators).sum(axis=-1)
    nearest = np.hypot(*np.maximum(np.abs(offset) - half, 0.0).T)
    bent = (half**2).sum(axis=1) / 2 + half.prod(axis=1) / 2
    with np.errstate(divide="ignore"):
        return Row(row.normal, row.middle, row.radius, np.where(nearest > 0, bent / nearest, np.inf))


def _tangents(disc: Disc, t: FloatArray) -> Iterator[Row]:
    """The tangents of a disc, those of opposite points as one strip."""
    normals, bounds = tangents(np.array(disc.center), disc.radius)
    half, on = len(normals) // 2, active(disc, t)
    for normal, upper, lower in zip(normals[:half], bounds[:half], -bounds[half:], strict=True):
        wide = np.broadcast_to(normal, (len(t), 2))
        yield Row(wide, np.full(len(t), (upper + lower) / 2), np.where(on, (upper - lower) / 2, np.inf))


def _motion(motion: Motion | None, at: Situation) -> Iterator[Row]:
    """The two strips of T(x), widened by what is unknown of the last position."""
    if motion is None:
        return
    for turn, side in ((motion.turn, -1.0), (-motion.turn, 1.0)):
        direction = at.heading + turn
        left = np.column_stack([-np.sin(direction), np.cos(direction)])
        blurred = np.abs(left @ at.unknown).sum(axis=1)
        middle = (left * at.last).sum(axis=1) + side * motion.height / 2
        yield Row(left, middle, motion.height / 2 + blurred)


def motion_as_printed(motion: Motion, at: Situation) -> list[Row]:
    """h6 and h7 with the slopes and centers of the paper, exchanged as they are: no outer bounds.

    Corners as in its figure: 1 is the last position, 2 and 3 lie along heading + θ and heading - θ, 4 is opposite.
    """
    side = motion.diagonal / (2 * np.cos(motion.turn))
    x, y = at.last.T
    corners = [at.last + side * np.column_stack([np.cos(at.heading + s), np.sin(at.heading + s)])
               for s in (motion.turn, -motion.turn)]  # fmt: skip
    m1, m2 = ((c[:, 1] - y) / (c[:, 0] - x) for c in corners)
    c1, c2 = y - m1 * x, y - m2 * x
    c3 = corners[0][:, 1] - m2 * corners[0][:, 0]
    c4 = corners[1][:, 1] - m1 * corners[1][:, 0]
    h6 = Row(np.column_stack([-m2, np.ones_like(m2)]), (c1 + c4) / 2, np.abs(c2 - c3) / 2)
    h7 = Row(np.column_stack([-m1, np.ones_like(m1)]), (c2 + c3) / 2, np.abs(c1 - c4) / 2)
    return [h6, h7]
