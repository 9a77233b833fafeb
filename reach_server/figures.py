"""How sets become the figures of constant size that are published: area, outline, box, zonotope."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reach_server.factor_sets import FactorSet, replace_rows
from reach_server.predicates import Context, Literals
from reach_server.rows import take
from reach_server.sets import planar, reduction, support
from reach_server.tube import Branches, united
from reach_server.windows import Floats

#: Directions in which an outline bounds its set.
OUTLINE = 12
#: Directions from which the area of a constrained set is bounded.
AREA_DIRECTIONS = 32
#: Generators of a published set beyond one per state.
EXTRA_GENERATORS = 2


#: What the predicates of no set refer to.
NOWHERE = Context(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)))


@dataclass(frozen=True, slots=True, eq=False)
class Figures:
    """What is published about the sets of one step, relative to their centers: ``area`` (B,), ``heights`` (B, K) of the
    sides of the outline over its directions, and the box ``hull`` (B, 2, n)."""

    area: Floats
    heights: Floats
    hull: Floats

    def outline(self) -> Floats:
        """The polygons (B, K, 2)."""
        return planar.outer_polygon(self.heights)


@dataclass(frozen=True, slots=True, eq=False)
class PlaneStrips:
    """C strips ``lower <= normal·x <= upper`` about the position alone: normal (C, 2), lower and upper (C,), and the
    literal (C,) that each belongs to. They are the same for every set."""

    normal: Floats
    lower: Floats
    upper: Floats
    literal: NDArray[np.intp]

    @classmethod
    def none(cls) -> "PlaneStrips":
        """No strip."""
        return cls(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.intp))

    @classmethod
    def of(cls, literals: Literals, chosen: Iterable[int], n: int, plane: tuple[int, int]) -> "PlaneStrips":
        """Those of the ``chosen`` ones of some literals over n states."""
        found = [cls.none()]
        others = [i for i in range(n) if i not in plane]
        for literal in chosen:
            if not literals.fixed(literal):
                continue
            strips, _ = literals.strips(literal, np.zeros((0, n)), np.zeros((0, n, 0)), NOWHERE)
            rows = np.flatnonzero(~strips.normal[:, others].any(axis=1))
            owner = np.full(len(rows), literal, dtype=np.intp)
            found.append(cls(strips.normal[rows][:, plane], strips.lower[rows], strips.upper[rows], owner))
        return cls(*(np.concatenate([getattr(f, name) for f in found]) for name in cls.__slots__))


def figures(sets: FactorSet, acting: NDArray[np.bool_], strips: PlaneStrips, plane: tuple[int, int]) -> Figures:
    """Area, outline and box around sets (B), cut once more by the literals that acted on them, (B, L).

    Zonotopes: the area is exact (of the set, where a predicate on the position acts: of its intersection with it), the
    outline and the box are outer bounds. Constrained sets: all three are outer bounds, certified by duality. Each
    side of the outline, and the box, is moved outwards by 1e-6 of the size of the set, more than rounding to float32
    can take back.
    """
    size = np.abs(sets.generators).sum(axis=-1)
    if sets.matrix.shape[1]:
        return _constrained_figures(sets, plane)
    planar_generators = sets.generators[:, plane, :]
    zero = np.zeros((len(size), 2))
    area = planar.zonotope_area(planar_generators)
    heights = support.zonotope_support(zero, planar_generators, planar.directions(OUTLINE))
    hull = np.stack([-size, size], axis=1)
    rows, vertices = _clipped(sets, acting, strips, plane)
    if len(rows):
        area[rows] = np.clip(planar.polygon_area(vertices), 0.0, area[rows])
        heights[rows] = np.minimum(heights[rows], (vertices @ planar.directions(OUTLINE).T).max(axis=1))
        for place, i in enumerate(plane):
            hull[rows, 0, i] = np.maximum(hull[rows, 0, i], vertices[..., place].min(axis=1))
            hull[rows, 1, i] = np.minimum(hull[rows, 1, i], vertices[..., place].max(axis=1))
    return _outwards(area, heights, hull, size, plane)


def _outwards(area: Floats, heights: Floats, hull: Floats, size: Floats, plane: tuple[int, int]) -> Figures:
    margin = 1e-6 * size
    widened = heights + margin[:, plane].sum(axis=1)[:, None]
    return Figures(area, widened, hull + np.stack([-margin, margin], axis=1))


def joined(each: Figures, owner: NDArray[np.intp], center: Floats, around: Floats, plane: tuple[int, int]) -> Figures:
    """Figures of the unions of sets: ``each`` of rows (R,) around ``center`` (R, n) that belong to the union ``owner``
    (R,), ascending, around ``around`` (B, n): outer."""
    if len(owner) == len(around):
        return each
    count, moved = len(around), center - around[owner]
    heights = np.full((count, each.heights.shape[1]), -np.inf)
    np.maximum.at(heights, owner, each.heights + moved[:, plane] @ planar.directions(OUTLINE).T)
    low, high = np.full_like(around, np.inf), np.full_like(around, -np.inf)
    np.minimum.at(low, owner, each.hull[:, 0] + moved)
    np.maximum.at(high, owner, each.hull[:, 1] + moved)
    area = np.zeros(count)
    np.add.at(area, owner, each.area)
    several = np.bincount(owner, minlength=count) > 1
    area[several] = np.minimum(area[several], planar.polygon_area(planar.outer_polygon(heights[several])))
    return Figures(area, heights, np.stack([low, high], axis=1))


def of_tracks(
    step: Branches, chosen: NDArray[np.intp], strips: PlaneStrips, plane: tuple[int, int]
) -> tuple[FactorSet, Figures]:
    """For each chosen track (B,), ascending, each with a branch: a set around its branches, and their figures."""
    rows = np.flatnonzero(np.isin(step.track, chosen))
    owner = np.searchsorted(chosen, step.track[rows])
    around = united(step, chosen)
    each = figures(take(step.sets, rows), step.within[rows], strips, plane)
    return around, joined(each, owner, step.sets.center[rows], around.center, plane)


def where_smaller(
    free: tuple[FactorSet, Figures], cut: tuple[FactorSet, Figures], rows: NDArray[np.intp], *, always: bool
) -> tuple[FactorSet, Figures]:
    """``free`` (B,) with those of ``rows`` replaced by ``cut`` (K,) where that has no greater area, or ``always``."""
    better = np.flatnonzero((cut[1].area <= free[1].area[rows]) | always)
    if not len(better):
        return free
    chosen = Figures(free[1].area.copy(), free[1].heights.copy(), free[1].hull.copy())
    for name in Figures.__slots__:
        getattr(chosen, name)[rows[better]] = getattr(cut[1], name)[better]
    return replace_rows(free[0], rows[better], take(cut[0], better)), chosen


def _clipped(
    sets: FactorSet, acting: NDArray[np.bool_], strips: PlaneStrips, plane: tuple[int, int]
) -> tuple[NDArray[np.intp], Floats]:
    """Rows on which predicates about the position act, and the polygons (R, V, 2) that are left of them."""
    on = acting[:, strips.literal]
    rows = np.flatnonzero(on.any(axis=1))
    if not len(rows):
        return rows, np.zeros((0, 0, 2))
    vertices = planar.zonotope_polygon(np.zeros((len(rows), 2)), sets.generators[rows][:, plane, :])
    for c in np.flatnonzero(on[rows].any(axis=0)):
        normal = strips.normal[c]
        offset = sets.center[rows][:, plane] @ normal
        vertices = planar.clip(vertices, normal, np.where(on[rows, c], strips.upper[c] - offset, np.inf))
        vertices = planar.clip(vertices, -normal, np.where(on[rows, c], offset - strips.lower[c], np.inf))
    return rows, vertices


def _constrained_figures(sets: FactorSet, plane: tuple[int, int]) -> Figures:
    n = sets.center.shape[1]
    size = np.abs(sets.generators).sum(axis=-1)
    planar_generators = sets.generators[:, plane, :]
    unit = np.concatenate([np.eye(n), -np.eye(n)])
    bounds = support.constrained_support(np.zeros_like(sets.center), sets.generators, sets.matrix, sets.offset, unit)
    hull = np.stack([np.maximum(-bounds[:, n:], -size), np.minimum(bounds[:, :n], size)], axis=1)
    zero = np.zeros((len(size), 2))
    heights = support.constrained_support(
        zero, planar_generators, sets.matrix, sets.offset, planar.directions(AREA_DIRECTIONS)
    )
    area = np.clip(planar.polygon_area(planar.outer_polygon(heights)), 0.0, planar.zonotope_area(planar_generators))
    outline = support.constrained_support(zero, planar_generators, sets.matrix, sets.offset, planar.directions(OUTLINE))
    return _outwards(area, outline, hull, size, plane)


def enclosing(sets: FactorSet) -> Floats:
    """Generators (B, n, n + 2) of zonotopes around the sets whose last n columns are diagonal: outer."""
    n = sets.center.shape[1]
    count = n + EXTRA_GENERATORS
    reduced = reduction.boxed(sets.generators, count)
    missing = count - reduced.shape[-1]
    return np.concatenate([np.zeros((*reduced.shape[:-1], missing)), reduced], axis=-1) if missing > 0 else reduced
