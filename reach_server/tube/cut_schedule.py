"""Cut schedules: the strips that cut each step of a tube without branches.

At each step an obligation has alternatives, each with the literals that it asks for now. A tube is *unbranched* where
one alternative remains at every step and its literals have fixed strips. An alternative is ruled out

* if one of its strips certainly misses the set without cuts, which holds all states that can be reached then;
* if another one covers it: the obligation after it entails that after the other, and each strip of the other that is
  not asked of it holds on the whole set without cuts. Then its trajectories satisfy all that is asked of the other.

The alternatives of an obligation are looked up once.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.jit import reduction_kernel, stacked
from reach_server.numeric.types import BoolArray, FloatArray, IntArray
from reach_server.predicates import Literals
from reach_server.sets.kernels.strip import WORK, tightened
from side_info.progression import TRUE, Table

Rows = NDArray[np.intp]

#: An obligation with more alternatives than this is left to branching tubes.
MOST_ALTERNATIVES = 8
_UNKNOWN, _UNUSABLE = -1, -2


@dataclass(frozen=True, slots=True, eq=False)
class ScheduledStrips:
    """C strips ``lower <= normal·x <= upper``, the same for every set: normal (C, n), lower and upper (C,), the literal
    (C,) that each belongs to; ``planar`` (C,) those of the position alone, and their normals ``flat`` (C, 2) there."""

    normal: FloatArray
    lower: FloatArray
    upper: FloatArray
    literal: Rows
    planar: BoolArray
    flat: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class CutSchedule:
    """Which of the ``strips`` are asked of B vehicles at steps 0 to N: ``asked`` (B, N + 1, C). ``unbranched`` (B,):
    for which vehicles the schedule holds; the others need branches, and nothing is asked of them here."""

    unbranched: BoolArray
    asked: BoolArray
    strips: ScheduledStrips

    @staticmethod
    def nothing(count: int, steps: int, n: int) -> "CutSchedule":
        """The schedule of ``count`` vehicles with n states of which nothing is asked."""
        active = np.zeros((count, steps + 1, 0), dtype=bool)
        return CutSchedule(np.ones(count, dtype=bool), active, _no_strips(n))

    def rows(self, rows: Rows) -> "CutSchedule":
        """The schedule of some vehicles."""
        return CutSchedule(self.unbranched[rows], self.asked[rows], self.strips)


class CutScheduler:
    """Cut schedules for the obligations of a table.

    Args:
        table: where the obligations are; another table needs another scheduler.
        literals: those that the table speaks about.
        n: states of the class.
        plane: the position states; None where there are none.
    """

    def __init__(self, table: Table, literals: Literals, n: int, plane: tuple[int, int] | None) -> None:
        self.table = table
        self._literals = literals
        self._n = n
        self._plane = plane
        #: By obligation: start of its first alternative and their number.
        self._first: IntArray = np.full(64, _UNKNOWN, dtype=np.int64)
        self._count: IntArray = np.zeros(64, dtype=np.int64)
        #: By alternative: strips asked for, next obligation, and which ones of its node entail what comes after it.
        self._asked: BoolArray = np.zeros((64, 16), dtype=bool)
        self._next: IntArray = np.zeros(64, dtype=np.int64)
        self._weaker: BoolArray = np.zeros((64, MOST_ALTERNATIVES), dtype=bool)
        self._alternatives = 0
        self._strips = _no_strips(n)

    def of(
        self,
        row: Rows,
        obligation: IntArray,
        tested: BoolArray,
        steps: int,
        center: FloatArray | None,
        generators: FloatArray | None,
    ) -> CutSchedule:
        """The schedule of B vehicles over ``steps`` N after now.

        ``row`` (R,), ascending, and ``obligation`` (R,): what is asked of which vehicle; more than one of a vehicle
        needs branches, none asks for nothing. ``tested`` (B,): whether the sets of now may be cut. center (B, N + 1, n)
        and generators (B, N + 1, n, g) of the sets without cuts at steps 0 to N, or None where these are not known.
        """
        count = len(tested)
        asked = np.full(count, TRUE, dtype=np.int64)
        asked[row] = obligation
        single = np.bincount(row, minlength=count) <= 1
        if center is None or generators is None:
            known, center, generators = False, np.zeros((1, steps + 1, 0)), np.zeros((1, steps + 1, 0, 0))
        else:
            known = True
        sets = stacked(center, 2, (len(center),), len(center)), stacked(generators, 3, (len(center),), len(center))
        while True:
            strips = self._strips
            unbranched, active, used, unknown = _walk(
                asked, single, tested, steps, known, *sets, self._first, self._count, self._asked, self._next,
                self._weaker, strips.normal, strips.lower, strips.upper,
            )  # fmt: skip
            if not len(unknown):
                break
            self._look_up(np.unique(unknown))
        if not used.all():
            retained = np.flatnonzero(used)
            active, strips = np.ascontiguousarray(active[:, :, retained]), _some(strips, retained)
        return CutSchedule(unbranched, active, strips)

    def _look_up(self, obligations: IntArray) -> None:
        """Look up what some obligations ask for."""
        expansion = self.table.expand(obligations)
        masks = self.table.masks(expansion.literal_set, self._literals.count)
        counts = np.diff(expansion.start)
        free_to_use = self._fixed(masks)
        usable = np.ones(len(obligations), dtype=bool)
        np.logical_and.at(usable, expansion.parent, free_to_use)
        usable &= (counts > 0) & (counts <= MOST_ALTERNATIVES)
        start = self._alternatives
        self._alternatives += len(masks)
        self._register(np.flatnonzero(masks[usable[expansion.parent]].any(axis=0)))
        width = len(self._strips.literal)
        self._asked = _grown(_wider(self._asked, width), self._alternatives, 0)
        self._next = _grown(self._next, self._alternatives, 0)
        self._weaker = _grown(self._weaker, self._alternatives, 0)
        self._asked[start : self._alternatives, :width] = masks[:, self._strips.literal]
        self._next[start : self._alternatives] = expansion.next
        if (counts > 1).any():
            i, j = self.table.subsumption(expansion)
            fits = usable[expansion.parent[i]]
            i, j = i[fits], j[fits]
            self._weaker[start + j, i - expansion.start[expansion.parent[i]]] = True
        most = int(obligations.max()) + 1
        self._first, self._count = _grown(self._first, most, _UNKNOWN), _grown(self._count, most, 0)
        self._first[obligations] = np.where(usable, start + expansion.start[:-1], _UNUSABLE)
        self._count[obligations] = counts

    def _fixed(self, masks: BoolArray) -> BoolArray:
        """Whether all literals of alternatives (A, L) have fixed strips, (A,)."""
        used = np.flatnonzero(masks.any(axis=0))
        moving = [literal for literal in used.tolist() if not self._literals.fixed(literal)]
        return np.logical_not(masks[:, moving].any(axis=1))

    def _register(self, literals: Rows) -> None:
        """Add the strips of some literals."""
        known = set(self._strips.literal.tolist())
        for literal in sorted(set(literals.tolist()) - known):
            strips, before = self._literals.fixed_strips(literal), self._strips
            plane = (0, 0) if self._plane is None else self._plane
            others = [i for i in range(self._n) if i not in plane]
            planar = ~strips.normal[:, others].any(axis=1) & (self._plane is not None)
            self._strips = ScheduledStrips(
                np.concatenate([before.normal, strips.normal]),
                np.concatenate([before.lower, strips.lower]),
                np.concatenate([before.upper, strips.upper]),
                np.concatenate([before.literal, np.full(len(strips.lower), literal, dtype=np.intp)]),
                np.concatenate([before.planar, planar]),
                # In the order that kernels are compiled for, whatever indexing makes of it.
                np.ascontiguousarray(np.concatenate([before.flat, strips.normal[:, list(plane)]])),
            )


@reduction_kernel
def _walk(
    obligation: IntArray,
    single: BoolArray,
    tested: BoolArray,
    steps: int,
    known: bool,
    center: FloatArray,
    generators: FloatArray,
    first: IntArray,
    count: IntArray,
    asked: BoolArray,
    following: IntArray,
    weaker: BoolArray,
    normals: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
) -> tuple[BoolArray, BoolArray, BoolArray, IntArray]:
    """Unbranched (B,), asked (B, N + 1, C), which strips are asked for at all (C,), obligations not looked up yet."""
    vehicles, strips = len(obligation), len(lower)
    unbranched, active = np.zeros(vehicles, dtype=np.bool_), np.zeros((vehicles, steps + 1, strips), dtype=np.bool_)
    used, unknown = np.zeros(strips, dtype=np.bool_), np.zeros(vehicles, dtype=np.int64)
    missing = 0
    z, g = generators.shape[2:]
    work, cuts, misses = np.zeros((WORK, max(z, g))), np.zeros(strips, dtype=np.bool_), np.zeros(strips, dtype=np.bool_)
    for b in range(vehicles):
        now, steps_done = obligation[b], 0
        while single[b] and steps_done <= steps:
            k = steps_done
            if now >= len(first) or first[now] == _UNKNOWN:
                unknown[missing] = now
                missing += 1
                break
            chosen, alternatives = first[now], count[now]
            if chosen == _UNUSABLE:
                break
            if alternatives > 1:
                if not known or (k == 0 and not tested[b]):
                    break
                for c in range(strips):
                    wanted = False
                    for a in range(chosen, chosen + alternatives):
                        wanted = wanted or asked[a, c]
                    if wanted:
                        found = tightened(center[b, k], generators[b, k], g, normals, c, lower[c], upper[c], work)
                        cuts[c], misses[c] = found[3], found[4]
                chosen = _only(chosen, alternatives, asked, weaker, cuts, misses)
                if chosen < 0:
                    break
            if k > 0 or tested[b]:
                for c in range(strips):
                    active[b, k, c] = asked[chosen, c]
            now = following[chosen]
            steps_done += 1
        unbranched[b] = steps_done > steps
        for k in range(steps + 1):
            for c in range(strips):
                active[b, k, c] = active[b, k, c] and unbranched[b]
                used[c] = used[c] or active[b, k, c]
    return unbranched, active, used, unknown[:missing]


@reduction_kernel
def _only(first: int, count: int, asked: BoolArray, weaker: BoolArray, cuts: BoolArray, misses: BoolArray) -> int:
    """The alternative out of ``count`` that holds all trajectories, -1 where it takes several or none is left."""
    strips = len(cuts)
    for one in range(count):
        holds, alive = True, True
        for c in range(strips):
            alive = alive and not (asked[first + one, c] and misses[c])
        for other in range(count):
            if not alive or not holds:
                break
            if other == one:
                continue
            removed, covered = False, weaker[first + one, other]
            for c in range(strips):
                removed = removed or (asked[first + other, c] and misses[c])
                covered = covered and not (asked[first + one, c] and cuts[c] and not asked[first + other, c])
            holds = removed or covered
        if alive and holds:
            return first + one
    return -1


def _no_strips(n: int) -> ScheduledStrips:
    return ScheduledStrips(
        np.zeros((0, n)), np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.intp), np.zeros(0, dtype=bool),
        np.zeros((0, 2)),
    )  # fmt: skip


def _some(strips: ScheduledStrips, retained: Rows) -> ScheduledStrips:
    return ScheduledStrips(
        strips.normal[retained], strips.lower[retained], strips.upper[retained], strips.literal[retained],
        strips.planar[retained], strips.flat[retained],
    )  # fmt: skip


def _grown(array: NDArray[Any], rows: int, fill: int) -> NDArray[Any]:
    """``array`` with at least ``rows`` rows, those added filled with ``fill``."""
    if rows <= len(array):
        return array
    added = np.full((max(rows, 2 * len(array)) - len(array), *array.shape[1:]), fill, dtype=array.dtype)
    return np.concatenate([array, added])


def _wider(array: BoolArray, columns: int) -> BoolArray:
    """``array`` with at least that many columns, those added False."""
    if columns <= array.shape[1]:
        return array
    return np.pad(array, ((0, 0), (0, max(columns, 2 * array.shape[1]) - array.shape[1])))
