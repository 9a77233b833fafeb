"""Summaries of constant size that are published of sets: area, outline, box, zonotope."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.jit import reduction_kernel, stacked
from reach_server.numeric.slot_table import take_rows
from reach_server.numeric.types import FloatArray
from reach_server.predicates import Literals
from reach_server.sets import order_reduction as reduction
from reach_server.sets import polygon as planar
from reach_server.sets import support
from reach_server.sets.kernels.planar import OUTWARDS, figures_one
from reach_server.sets.kernels.strip import WORK
from reach_server.sets.raw import RawSets, replace_rows
from reach_server.tube.branching import Branches, united

#: Directions in which an outline bounds its set.
OUTLINE = 12
OUTLINE_DIRECTIONS = planar.directions(OUTLINE)
#: Directions from which the area of a constrained set is bounded.
AREA_DIRECTIONS = 32
#: Generators of a published set beyond one per state.
EXTRA_GENERATORS = 2


@dataclass(frozen=True, slots=True, eq=False)
class SetSummary:
    """The summary of the sets of one step, relative to their centers: ``area`` (B,), ``heights`` (B, K) of the sides of
    the outline over its directions, and the box ``hull`` (B, 2, n)."""

    area: FloatArray
    heights: FloatArray
    hull: FloatArray

    def outline(self) -> FloatArray:
        """The polygons (B, K, 2)."""
        return planar.outer_polygon(self.heights)


@dataclass(frozen=True, slots=True, eq=False)
class PlaneStrips:
    """C strips ``lower <= normal·x <= upper`` about the position alone: normal (C, 2), lower and upper (C,), and the
    literal (C,) that each belongs to. They are the same for every set."""

    normal: FloatArray
    lower: FloatArray
    upper: FloatArray
    literal: NDArray[np.intp]

    @classmethod
    def none(cls) -> "PlaneStrips":
        """No strip."""
        return cls(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.intp))

    @classmethod
    def of(cls, literals: Literals, chosen: Iterable[int], n: int, plane: tuple[int, int]) -> "PlaneStrips":
        """The strips about the position of the ``chosen`` literals over n states."""
        found = [cls.none()]
        others = [i for i in range(n) if i not in plane]
        for literal in chosen:
            if not literals.fixed(literal):
                continue
            strips = literals.fixed_strips(literal)
            rows = np.flatnonzero(~strips.normal[:, others].any(axis=1))
            owner = np.full(len(rows), literal, dtype=np.intp)
            found.append(cls(strips.normal[rows][:, plane], strips.lower[rows], strips.upper[rows], owner))
        return cls(*(np.concatenate([getattr(f, name) for f in found]) for name in cls.__slots__))


def summarize(sets: RawSets, acting: NDArray[np.bool_], strips: PlaneStrips, plane: tuple[int, int]) -> SetSummary:
    """Area, outline and box around sets (B), cut once more by the literals that cut them, (B, L).

    Zonotopes: the area is exact (of the set, where a predicate on the position acts: of its intersection with it), the
    outline and the box are outer bounds. Constrained sets: all three are outer bounds, certified by duality. Each
    side of the outline, and the box, is moved outwards by ``OUTWARDS`` of the size of the set.
    """
    if sets.matrix.shape[1]:
        return _constrained_figures(sets, plane)
    count = len(sets.center)
    area, heights, hull = _summarize_rows(
        stacked(sets.center, 1, (count,), count), stacked(sets.generators, 2, (count,), count), *plane,
        np.ascontiguousarray(strips.normal), strips.lower, strips.upper,
        np.ascontiguousarray(acting[:, strips.literal]), OUTLINE_DIRECTIONS,
    )  # fmt: skip
    return SetSummary(area, heights, hull)


@reduction_kernel
def _summarize_rows(
    center: FloatArray, generators: FloatArray, plane0: int, plane1: int,
    normals: FloatArray, lower: FloatArray, upper: FloatArray, on: NDArray[np.bool_], directions: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """``figures_one`` of center (R, n) and generators (R, n, g), with strips on where ``on`` (R, C) says."""
    count, n, g = generators.shape
    area, heights, hull = np.zeros(count), np.zeros((count, len(directions))), np.zeros((count, 2, n))
    vertices, work = np.zeros((2, 2 * (g + len(lower)) + 1, 2)), np.zeros((WORK, max(n, g)))
    own_center, own, acting = np.zeros(n), np.zeros((n, g)), np.zeros(len(lower), dtype=np.bool_)
    for p in range(count):
        for k in range(n):
            own_center[k] = center[p, k]
            for i in range(g):
                own[k, i] = generators[p, k, i]
        for c in range(len(lower)):
            acting[c] = on[p, c]
        area[p] = figures_one(
            own_center, own, g, n, plane0, plane1, normals, lower, upper, acting,
            directions, heights[p], hull[p], vertices, work,
        )  # fmt: skip
    return area, heights, hull


def _outwards(
    area: FloatArray, heights: FloatArray, hull: FloatArray, size: FloatArray, plane: tuple[int, int]
) -> SetSummary:
    margin = OUTWARDS * size
    widened = heights + margin[:, plane].sum(axis=1)[:, None]
    return SetSummary(area, widened, hull + np.stack([-margin, margin], axis=1))


def union_summary(
    each: SetSummary, owner: NDArray[np.intp], center: FloatArray, around: FloatArray, plane: tuple[int, int]
) -> SetSummary:
    """Summaries of the unions of sets: ``each`` of rows (R,) around ``center`` (R, n) that belong to the union
    ``owner`` (R,), ascending, around ``around`` (B, n): outer."""
    if len(owner) == len(around):
        return each
    count, moved = len(around), center - around[owner]
    heights = np.full((count, each.heights.shape[1]), -np.inf)
    np.maximum.at(heights, owner, each.heights + moved[:, plane] @ OUTLINE_DIRECTIONS.T)
    low, high = np.full_like(around, np.inf), np.full_like(around, -np.inf)
    np.minimum.at(low, owner, each.hull[:, 0] + moved)
    np.maximum.at(high, owner, each.hull[:, 1] + moved)
    area = np.zeros(count)
    np.add.at(area, owner, each.area)
    several = np.bincount(owner, minlength=count) > 1
    area[several] = np.minimum(area[several], planar.polygon_area(planar.outer_polygon(heights[several])))
    return SetSummary(area, heights, np.stack([low, high], axis=1))


def of_tracks(
    step: Branches, chosen: NDArray[np.intp], strips: PlaneStrips, plane: tuple[int, int]
) -> tuple[RawSets, SetSummary]:
    """For each chosen track (B,), ascending, each with a branch: a set around its branches, and their summary."""
    rows = np.flatnonzero(np.isin(step.track, chosen))
    owner = np.searchsorted(chosen, step.track[rows])
    around = united(step, chosen)
    each = summarize(take_rows(step.sets, rows), step.within[rows], strips, plane)
    return around, union_summary(each, owner, step.sets.center[rows], around.center, plane)


def where_smaller(
    free: tuple[RawSets, SetSummary], cut: tuple[RawSets, SetSummary], rows: NDArray[np.intp], *, always: bool
) -> tuple[RawSets, SetSummary]:
    """``free`` (B,) with those of ``rows`` replaced by ``cut`` (K,) where that has no greater area, or ``always``."""
    better = np.flatnonzero((cut[1].area <= free[1].area[rows]) | always)
    if not len(better):
        return free
    chosen = SetSummary(free[1].area.copy(), free[1].heights.copy(), free[1].hull.copy())
    for name in SetSummary.__slots__:
        getattr(chosen, name)[rows[better]] = getattr(cut[1], name)[better]
    return replace_rows(free[0], rows[better], take_rows(cut[0], better)), chosen


def _constrained_figures(sets: RawSets, plane: tuple[int, int]) -> SetSummary:
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
    outline = support.constrained_support(zero, planar_generators, sets.matrix, sets.offset, OUTLINE_DIRECTIONS)
    return _outwards(area, outline, hull, size, plane)


def enclosing(sets: RawSets) -> FloatArray:
    """Generators (B, n, n + 2) of zonotopes around the sets whose last n columns are diagonal: outer."""
    n = sets.center.shape[1]
    count = n + EXTRA_GENERATORS
    reduced = reduction.boxed(sets.generators, count)
    missing = count - reduced.shape[-1]
    return np.concatenate([np.zeros((*reduced.shape[:-1], missing)), reduced], axis=-1) if missing > 0 else reduced
