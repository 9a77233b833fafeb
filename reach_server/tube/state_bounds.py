"""Sets cut to bounds of each state: no set is larger than the limits allow.

Let S be a set that holds the state, and C the box of the bounds, which holds it, too. Published is an outer bound of
the intersection of both: S cut by the strips of the bounds (mathematics, 4.19), and, where a state still reaches beyond
its bounds then, the cut set with that state replaced by an interval of its own: the product of what the set is in the
other states and of the bounds that both have in this one. Sets that lie within their bounds stay as they are, to the
last bit.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from reach_server.data.regressors import wrap
from reach_server.numeric.slot_table import take_rows
from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.sets import halfspace as strips
from reach_server.sets.kernels.strip import MISSED
from reach_server.sets.raw import RawSets, replace_rows
from reach_server.tube.reach_sets import ReachSets
from reach_server.tube.summaries import OUTLINE_DIRECTIONS, PlaneStrips, summarize

#: A set is not cut for reaching beyond its bounds by less than this part of its size: what rounding outwards adds.
NEGLIGIBLE = 1e-6


def within(
    reach: ReachSets, low: FloatArray, high: FloatArray, plane: tuple[int, int], angles: Sequence[int]
) -> tuple[ReachSets, BoolArray]:
    """The reachable sets, cut to bounds ``low`` and ``high`` (B, N, n) of the states at steps 1 to N, infinite where
    there are none; and which vehicles (B,) have a set that was cut. Those of ``angles`` hold in any turn. Outer."""
    steps, free = list(reach.steps), list(reach.free)
    area, area_free = reach.area.copy(), reach.area_free.copy()
    heights, hull = reach.heights.copy(), reach.hull.copy()
    cut = np.zeros(len(area), dtype=bool)
    for k in range(len(steps)):
        # Of the sets without cuts only the area is published.
        for row_sets, areas in ((free, area_free), (steps, area)):
            sets = row_sets[k]
            bottom, top = _in_turn(sets.center, low[:, k], high[:, k], angles)
            for rows, some in _alike(sets, _beyond(sets, bottom, top)):
                cut[rows] = True
                held = _held(some, bottom[rows], top[rows], plane)
                found = summarize(held, np.zeros((len(rows), 0), dtype=bool), PlaneStrips.none(), plane)
                areas[rows, k] = np.minimum(areas[rows, k], found.area)
                if row_sets is steps:
                    moved = held.center - some.center
                    # No matrix product: its rounding depends on how many rows there are.
                    along = (
                        moved[:, plane[:1]] * OUTLINE_DIRECTIONS[:, 0] + moved[:, plane[1:]] * OUTLINE_DIRECTIONS[:, 1]
                    )
                    heights[rows, k] = np.minimum(heights[rows, k] - along, found.heights)
                    hull[rows, k, 0] = np.maximum(hull[rows, k, 0] - moved, found.hull[:, 0])
                    hull[rows, k, 1] = np.minimum(hull[rows, k, 1] - moved, found.hull[:, 1])
                row_sets[k] = replace_rows(row_sets[k], rows, held)
        larger = np.flatnonzero(cut & (area[:, k] > area_free[:, k]))
        # The set without side information holds the one with it.
        for rows, some in _alike(free[k], larger):
            found = summarize(some, np.zeros((len(rows), 0), dtype=bool), PlaneStrips.none(), plane)
            steps[k] = replace_rows(steps[k], rows, some)
            area[rows, k], heights[rows, k], hull[rows, k] = found.area, found.heights, found.hull
    if not cut.any():
        return reach, cut
    return replace(
        reach, steps=tuple(steps), free=tuple(free), area=area, area_free=area_free, heights=heights, hull=hull
    ), cut


def _in_turn(
    center: FloatArray, low: FloatArray, high: FloatArray, angles: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """The bounds (B, n), those of angles in the turn next to the centers (B, n) of the sets."""
    low, high = low.copy(), high.copy()
    for i in angles:
        bounded = np.isfinite(low[:, i]) & np.isfinite(high[:, i])
        middle = np.where(bounded, (np.where(bounded, low[:, i], 0.0) + np.where(bounded, high[:, i], 0.0)) / 2, 0.0)
        turned = np.where(bounded, center[:, i] + wrap(middle - center[:, i]) - middle, 0.0)
        low[:, i] += turned
        high[:, i] += turned
    return low, high


def _spread(sets: RawSets) -> FloatArray:
    """Half-widths (B, n), summed one by one: zero columns, of which there are more beside wider sets, change no bit."""
    if not sets.generators.shape[2]:
        return np.zeros_like(sets.center)
    return np.asarray(np.cumsum(np.abs(sets.generators), axis=-1)[..., -1])


def _alike(sets: RawSets, rows: NDArray[np.intp]) -> Iterator[tuple[NDArray[np.intp], RawSets]]:
    """Some rows of sets, those with equally many columns together, and their sets without zero columns at the end: so
    no set depends on those beside it."""
    columns = np.asarray(np.concatenate([sets.generators[rows], sets.matrix[rows]], axis=1).any(axis=1))
    used = np.where(np.asarray(columns.any(axis=1)), columns.shape[1] - columns[:, ::-1].argmax(axis=1), 0)
    for count in np.unique(used).tolist():
        chosen = rows[used == count]
        some = take_rows(sets, chosen)
        yield chosen, RawSets(some.center, some.generators[..., :count], some.matrix[..., :count], some.offset)


def _beyond(sets: RawSets, low: FloatArray, high: FloatArray) -> NDArray[np.intp]:
    """Rows of the sets (B) that reach beyond bounds (B, n)."""
    half = _spread(sets)
    slack = NEGLIGIBLE * half + np.spacing(np.abs(sets.center))
    beyond = (sets.center - half < low - slack) | (sets.center + half > high + slack)
    return np.flatnonzero((beyond & np.isfinite(half)).any(axis=1))


def _held(sets: RawSets, low: FloatArray, high: FloatArray, plane: tuple[int, int]) -> RawSets:
    """Outer bounds of sets (B) within bounds (B, n). A set that its bounds exclude, so that one of both is wrong, is
    replaced by them where they exclude it: in these states the bounds alone hold what they hold."""
    n = sets.center.shape[1]
    if not sets.matrix.shape[1]:
        most = np.abs(sets.center) + _spread(sets)
        finite = [np.where(np.isfinite(b), b, s * 2.0 * (most + 1.0)) for b, s in ((low, -1.0), (high, 1.0))]
        found = strips.narrow(
            sets.center, sets.generators, np.eye(n), finite[0], finite[1], np.ones(low.shape, dtype=bool), plane=plane
        )
        retained = np.flatnonzero(~(found.acted & MISSED).any(axis=1))
        sets = replace_rows(sets, retained, RawSets.zonotope(found.center[retained], found.generators[retained]))
    half = _spread(sets)
    slack = NEGLIGIBLE * half + np.spacing(np.abs(sets.center))
    least, greatest = sets.center - half, sets.center + half
    alone = (least < low - slack) | (greatest > high + slack)
    least, greatest = np.maximum(least, low), np.minimum(greatest, high)
    missed = least > greatest
    least, greatest = (
        np.where(missed & np.isfinite(low), low, least),
        np.where(missed & np.isfinite(high), high, greatest),
    )
    alone &= least <= greatest
    middle, wide = (least + greatest) / 2, (greatest - least) / 2
    wide += 2.0 * np.spacing(np.maximum(np.abs(least), np.abs(greatest)))
    center = np.where(alone, middle, sets.center)
    own = np.where(alone, wide, 0.0)[:, :, None] * np.eye(n)
    generators = np.concatenate([np.where(alone[:, :, None], 0.0, sets.generators), own], axis=2)
    matrix = np.concatenate([sets.matrix, np.zeros((*sets.matrix.shape[:2], n))], axis=2)
    return RawSets(center, generators, matrix, sets.offset)
