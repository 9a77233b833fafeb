"""Tubes without branches: sets, cuts and summaries of all vehicles and steps in one compiled loop.

The result equals that of ``branching`` and ``summaries`` where one alternative remains at each step (``cut_schedule``),
without a batch per step. A set that cuts did not make smaller is published without them.
"""

from typing import NamedTuple

import numpy as np

from reach_server.numeric.jit import reduction_kernel, stacked
from reach_server.numeric.types import BoolArray, FloatArray, IntArray
from reach_server.predicates.cut_kinds import CUT_KINDS, CutMethod
from reach_server.sets.kernels.planar import figures_one
from reach_server.sets.kernels.strip import ACTED, WORK, narrow_one
from reach_server.tube.cut_schedule import CutSchedule
from reach_server.tube.summaries import OUTLINE_DIRECTIONS

__all__ = ["AskedStrips", "CutSchedule", "UnbranchedTubes", "asked_strips", "box_tubes", "most_asked"]


class UnbranchedTubes(NamedTuple):
    """Tubes of B vehicles over steps 1 to N, as published: ``center`` (B, N, n) and ``generators`` (B, N, n, G), zero
    beyond the first ``used`` (B, N) columns; the sets without cuts ``free_center`` (B, N, n), ``free_generators``.

    ``area``, ``area_free`` (B, N), ``heights`` (B, N, K) and ``hull`` (B, N, 2, n) as in ``SetSummary``, relative to
    the centers. ``active`` (B, N + 1, C): the strips of the schedule that cut at steps 0 to N. ``ended`` (B,): the
    first step at which the cuts left certainly nothing, -1 where there is none; a vehicle with an end is published
    without cuts. ``bounded`` (B,): all sets are finite. ``contradicted`` (B,): data excludes the stated bounds.
    """

    center: FloatArray
    generators: FloatArray
    used: IntArray
    free_center: FloatArray
    free_generators: FloatArray
    area: FloatArray
    area_free: FloatArray
    heights: FloatArray
    hull: FloatArray
    active: BoolArray
    ended: IntArray
    bounded: BoolArray
    contradicted: BoolArray

    def active_literals(self, schedule: CutSchedule, count: int) -> BoolArray:
        """Which of ``count`` literals cut at steps 0 to N, (B, N + 1, L)."""
        found = np.zeros((*self.active.shape[:2], count), dtype=bool)
        for c, literal in enumerate(schedule.strips.literal.tolist()):
            found[:, :, literal] |= self.active[:, :, c]
        return found


class AskedStrips(NamedTuple):
    """A schedule for kernels: the strips of ``ScheduledStrips``, asked for where ``asked`` (B, N + 1, C); the plane;
    ``frobenius``, whether a cut is kept that makes the set larger; and the ``directions`` (K, 2) of outlines."""

    asked: BoolArray
    normal: FloatArray
    lower: FloatArray
    upper: FloatArray
    planar: BoolArray
    flat: FloatArray
    plane: tuple[int, int]
    frobenius: bool
    directions: FloatArray


class BoxSets(NamedTuple):
    """The sets without cuts at steps 1 to N, center (B, N, n) and generators (B, N, n, g), and those of now,
    ``start_center`` (B, n) and ``start_generators`` (B, n, g0)."""

    center: FloatArray
    generators: FloatArray
    start_center: FloatArray
    start_generators: FloatArray


def asked_strips(schedule: CutSchedule, plane: tuple[int, int], cuts: CutMethod) -> AskedStrips:
    """A schedule in the form that kernels take, cut by the method ``cuts``."""
    strips = schedule.strips
    return AskedStrips(
        schedule.asked, strips.normal, strips.lower, strips.upper, strips.planar, strips.flat, plane,
        CUT_KINDS[cuts].keeps_larger_result, OUTLINE_DIRECTIONS,
    )  # fmt: skip


def most_asked(schedule: CutSchedule) -> int:
    """The greatest number of strips that are asked of one set."""
    return int(schedule.asked.sum(axis=2).max(initial=0))


def box_tubes(
    center: FloatArray,
    generators: FloatArray,
    start_center: FloatArray,
    start_generators: FloatArray,
    schedule: CutSchedule,
    plane: tuple[int, int],
    cuts: CutMethod,
) -> UnbranchedTubes:
    """Tubes whose sets, center (B, N, n) and generators (B, N, n, g), do not depend on how the one before was cut.

    ``start_center`` (B, n) and ``start_generators`` (B, n, g0) are the sets of now, of which the cuts of step 0 may
    leave nothing. ``cuts`` is ``zonotope`` or ``frobenius``; outer bounds either way.
    """
    count = len(center)
    sets = BoxSets(
        stacked(center, 2, (count,), count), stacked(generators, 3, (count,), count),
        stacked(start_center, 1, (count,), count), stacked(start_generators, 2, (count,), count),
    )  # fmt: skip
    strips = asked_strips(schedule, plane, cuts)
    # All columns that two passes may add, so that no set depends on what is asked of others.
    added = most_asked(schedule) * (1 if strips.frobenius else 2)
    return _box_tubes(sets, strips, added)


@reduction_kernel
def _box_tubes(sets: BoxSets, asked: AskedStrips, added: int) -> UnbranchedTubes:
    """The tubes of ``box_tubes``, with room for ``added`` columns of cuts."""
    free_center, free_generators, start_center, start_generators = sets
    normals, lower, upper, planar, flat = asked.normal, asked.lower, asked.upper, asked.planar, asked.flat
    (plane0, plane1), frobenius, directions = asked.plane, asked.frobenius, asked.directions
    vehicles, steps, n, g = free_generators.shape
    first, strips, sides = start_generators.shape[2], len(lower), len(directions)
    widest = max(g, first) + added
    center, generators = np.zeros((vehicles, steps, n)), np.zeros((vehicles, steps, n, widest))
    used = np.full((vehicles, steps), g)
    area, area_free = np.zeros((vehicles, steps)), np.zeros((vehicles, steps))
    heights, hull = np.zeros((vehicles, steps, sides)), np.zeros((vehicles, steps, 2, n))
    active, ended = np.zeros((vehicles, steps + 1, strips), dtype=np.bool_), np.full(vehicles, -1)
    bounded = np.ones(vehicles, dtype=np.bool_)
    # What belongs to one set at a time lies in arrays of its own: looking up parts of large ones costs more than this.
    own_center, own, own_heights, own_hull = np.zeros(n), np.zeros((n, widest)), np.zeros(sides), np.zeros((2, n))
    cut_center, cut, cut_heights, cut_hull = np.zeros(n), np.zeros((n, widest)), np.zeros(sides), np.zeros((2, n))
    flags, on, none = np.zeros(strips, dtype=np.uint8), np.zeros(strips, dtype=np.bool_), np.zeros(0, dtype=np.bool_)
    work, vertices = np.zeros((WORK, max(n, widest))), np.zeros((2, 2 * (widest + strips) + 1, 2))
    for b in range(vehicles):
        k, cutting = 0, True
        while k <= steps:
            columns = g if k > 0 else first
            for i in range(n):
                own_center[i] = free_center[b, k - 1, i] if k > 0 else start_center[b, i]
                for j in range(columns):
                    own[i, j] = free_generators[b, k - 1, i, j] if k > 0 else start_generators[b, i, j]
            if k > 0:
                area[b, k - 1] = figures_one(
                    own_center, own, columns, n, plane0, plane1, flat, lower, upper, none,
                    directions, own_heights, own_hull, vertices, work,
                )  # fmt: skip
                area_free[b, k - 1] = area[b, k - 1]
            asks = False
            for c in range(strips):
                on[c] = asked.asked[b, k, c] and cutting
                asks = asks or on[c]
            better = False
            if asks:
                for i in range(n):
                    cut_center[i] = own_center[i]
                    for j in range(widest):
                        cut[i, j] = own[i, j] if j < columns else 0.0
                columns, empty = narrow_one(
                    cut_center, cut, columns, normals, lower, upper, on, plane0, plane1, frobenius, flags, work
                )
                if empty:
                    # Nothing is left: all of the tube is published without cuts.
                    ended[b], k, cutting = k, 0, False
                    continue
                acts = frobenius
                for c in range(strips):
                    active[b, k, c] = flags[c] & ACTED != 0
                    acts = acts or active[b, k, c]
                    on[c] = on[c] and planar[c]
                if acts and k > 0:
                    cut_area = figures_one(
                        cut_center, cut, columns, n, plane0, plane1, flat, lower, upper, on,
                        directions, cut_heights, cut_hull, vertices, work,
                    )  # fmt: skip
                    better = frobenius or cut_area <= area_free[b, k - 1]
                    if better:
                        area[b, k - 1] = cut_area
            if k > 0:
                used[b, k - 1] = columns if better else g
                for i in range(n):
                    center[b, k - 1, i] = cut_center[i] if better else own_center[i]
                    for j in range(used[b, k - 1]):
                        generators[b, k - 1, i, j] = cut[i, j] if better else own[i, j]
                    for j in range(2):
                        hull[b, k - 1, j, i] = cut_hull[j, i] if better else own_hull[j, i]
                        bounded[b] = bounded[b] and abs(own_center[i] + own_hull[j, i]) < np.inf
                for i in range(sides):
                    heights[b, k - 1, i] = cut_heights[i] if better else own_heights[i]
            k += 1
    return UnbranchedTubes(
        center, generators, used, free_center, free_generators, area, area_free, heights, hull, active, ended, bounded,
        np.zeros(vehicles, dtype=np.bool_),
    )  # fmt: skip
