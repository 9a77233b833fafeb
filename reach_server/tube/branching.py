"""Tubes with branches: sets that move over the horizon, each with what its formula still asks for.

A branch is a set and an obligation. At each step every alternative of the obligation becomes a branch of its own, cut
by the predicates that it asks for; a branch that is certainly empty is dropped. A trajectory that satisfies the formula
chooses one alternative at each step, satisfies its predicates and goes on with its obligation, so that it lies in a
branch at every step: the union of the branches is an outer bound. What keeps the branches few only enlarges it:

* a branch is dropped for another of the same parent if the other's obligation is implied and no predicate cut the
  other that was not asked of the first (then its trajectories are in the other's set);
* branches of equal obligation become one, around both;
* beyond ``MOST_BRANCHES`` obligations are weakened until enough of them are equal.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.slot_table import take_rows
from reach_server.numeric.types import FloatArray
from reach_server.predicates import Literals
from reach_server.predicates.apply import StepContexts, cut_sets
from reach_server.predicates.cut_kinds import CutMethod
from reach_server.predicates.infeasible_subset import conflicting
from reach_server.sets import halfspace as strips
from reach_server.sets import order_reduction as reduction
from reach_server.sets.hull import zonotope_hull
from reach_server.sets.raw import RawSets, replace_rows
from reach_server.side_information.scenarios import MOST_BRANCHES
from side_info.progression import Table

#: Generators of two sets that are paired, one by one, in a set around both; the rest of each is boxed.
KEPT_IN_HULLS: Final = 8

Rows = NDArray[np.intp]


class Motion(Protocol):
    """A model that moves sets from step to step."""

    @property
    def horizon(self) -> int:
        """Steps N."""

    def begin(self, start: RawSets, vehicle: Rows) -> RawSets:
        """Sets (R, z) to be moved, from sets (R, n) of states now; the first n coordinates stay the states."""

    def advance(self, sets: RawSets, k: int, vehicle: Rows) -> tuple[RawSets, NDArray[np.bool_]]:
        """Sets (R) after step ``k`` (from 0) of the vehicles (R,), and where the data excludes the stated bounds."""


@dataclass(frozen=True, slots=True, eq=False)
class Hypotheses:
    """T tubes to compute: ``vehicle`` (T,) of each, the sets that they start from, and their obligations now:
    ``obligation`` (R,) of track ``track`` (R,), ascending. ``tested`` (T,): the sets of now may be cut. ``free`` (T,):
    the track of the same vehicle that asks for nothing, whose sets hold those of all others."""

    vehicle: Rows
    start: RawSets
    track: Rows
    obligation: NDArray[np.int64]
    tested: NDArray[np.bool_]
    free: Rows | None = None

    @property
    def count(self) -> int:
        """Number of tracks T."""
        return len(self.vehicle)


@dataclass(frozen=True, slots=True, eq=False)
class SideInformation:
    """The table of obligations, the literals and how they cut; ``contexts(k)`` gives the contexts of predicates at step
    k, by literal and tracks (K,)."""

    table: Table
    literals: Literals
    contexts: StepContexts
    cuts: CutMethod
    plane: tuple[int, int] | None


@dataclass(frozen=True, slots=True, eq=False)
class Branches:
    """R branches at one step: ``track`` (R,) ascending, what each still asks for (R,), its set, and ``within`` (R, L),
    the literals that cut at this step all that is in it."""

    track: Rows
    obligation: NDArray[np.int64]
    sets: RawSets
    within: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Tube:
    """Branches at steps 0 (now) to N, over the n states; of a track that has ended there are none any more.

    ``active`` (T, N + 1, L): the literals that cut a branch of the track at a step. ``ended`` (T,): step at which the
    last branch of a track was certainly empty, -1 where some are left; ``responsible`` (T, L): the literals that left
    nothing there. ``contradicted`` (T,): data excludes the stated bounds.
    """

    steps: list[Branches]
    active: NDArray[np.bool_]
    ended: NDArray[np.int64]
    responsible: NDArray[np.bool_]
    contradicted: NDArray[np.bool_]


def propagate(tracks: Hypotheses, motion: Motion, side: SideInformation, n: int) -> Tube:
    """The tubes of some tracks over N steps; every set is an outer bound while bounds and side information hold."""
    literals = side.literals.count
    tube = Tube(
        [],
        np.zeros((tracks.count, motion.horizon + 1, literals), dtype=bool),
        np.full(tracks.count, -1, dtype=np.int64),
        np.zeros((tracks.count, literals), dtype=bool),
        np.zeros(tracks.count, dtype=bool),
    )
    sets = motion.begin(take_rows(tracks.start, tracks.track), tracks.vehicle[tracks.track])
    branches = Branches(tracks.track, tracks.obligation, sets, np.zeros((len(tracks.track), literals), dtype=bool))
    for k in range(motion.horizon + 1):
        if k:
            vehicle = tracks.vehicle[branches.track]
            sets, wrong = motion.advance(branches.sets, k - 1, vehicle)
            tube.contradicted[branches.track] |= wrong
            branches = Branches(branches.track, branches.obligation, sets, branches.within)
        branches = _narrowed(branches, k, side, tracks.tested if k == 0 else None, n, tube)
        branches = _fewer(branches, side, tracks.free, n)
        tube.steps.append(Branches(branches.track, branches.obligation, _states(branches.sets, n), branches.within))
    return tube


def _states(sets: RawSets, n: int) -> RawSets:
    return RawSets(sets.center[:, :n], sets.generators[:, :n], sets.matrix, sets.offset)


def _narrowed(
    branches: Branches,
    k: int,
    side: SideInformation,
    tested: NDArray[np.bool_] | None,
    n: int,
    tube: Tube,
) -> Branches:
    """The branches after the alternatives of step ``k``; records in ``tube`` what cut them, and where none is left."""
    table = side.table
    expansion = table.expand(branches.obligation)
    parent = expansion.parent
    track = branches.track[parent]
    asked = table.masks(expansion.literal_set, side.literals.count)
    # A received sample has come no way yet.
    cutting = asked if tested is None else asked & tested[track][:, None] & ~side.literals.looks_back
    cut = cut_sets(
        take_rows(branches.sets, parent), cutting, side.literals, side.contexts(k, track),
        side.cuts, n, side.plane,
    )  # fmt: skip
    alive = np.logical_not(cut.empty.any(axis=1))
    removed = np.setdiff1d(branches.track, track[alive])
    tube.ended[removed] = k
    of = side.contexts(k, track)
    for row in np.flatnonzero(np.isin(track, removed)).tolist():
        tube.responsible[track[row]] |= cut.empty[row]
        asked_here = np.flatnonzero(cutting[row]).tolist()
        one = take_rows(branches.sets, parent[[row]])
        tube.responsible[track[row], conflicting(one, row, asked_here, side.literals, of, n)] = True
    pairs = table.subsumption(expansion)
    retained = np.flatnonzero(alive & ~_covered(pairs, asked, cut.active, alive))
    found = Branches(track[retained], expansion.next[retained], take_rows(cut.sets, retained), cut.active[retained])
    np.logical_or.at(tube.active[:, k], found.track, found.within)
    return found


def _covered(
    pairs: tuple[Rows, Rows], asked: NDArray[np.bool_], active: NDArray[np.bool_], alive: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Which rows (R,) need not be followed: another row that stays covers their trajectories.

    ``pairs`` (i, j): the obligation after i entails that after j, both of one parent. Row j covers i if every literal
    that cut j was asked of i, too.
    """
    i, j = pairs
    covers = alive[i] & alive[j] & ~(active[j] & ~asked[i]).any(axis=1)
    i, j = i[covers], j[covers]
    covered = np.zeros(len(alive), dtype=bool)
    covered[i] = True
    # Covering is no order where predicates are cut one after another: what is dropped needs a cover that stays.
    safe = np.zeros(len(alive), dtype=bool)
    safe[i[~covered[j]]] = True
    return covered & safe


def _fewer(branches: Branches, side: SideInformation, free: Rows | None, n: int) -> Branches:
    """At most ``MOST_BRANCHES`` branches a track, and none of equal obligation: what becomes one gets a set around all
    of them, or the set without side information where that is smaller."""
    track, obligation = branches.track, branches.obligation.copy()
    counts = np.bincount(track) if len(track) else np.zeros(0, dtype=np.intp)
    for crowded in np.flatnonzero(counts > MOST_BRANCHES).tolist():
        rows = np.flatnonzero(track == crowded)
        weaker = side.table.cap(sorted(set(obligation[rows].tolist())), MOST_BRANCHES)
        obligation[rows] = [weaker[o] for o in obligation[rows].tolist()]
    if len(track) == np.count_nonzero(counts):
        return Branches(track, obligation, branches.sets, branches.within)
    pair = np.stack([track, obligation], axis=1)
    unique, inverse, sizes = np.unique(pair, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(inverse.ravel(), kind="stable")
    first = np.cumsum(sizes) - sizes
    within = np.ones((len(unique), branches.within.shape[1]), dtype=bool)
    np.logical_and.at(within, inverse.ravel(), branches.within)
    sets = take_rows(branches.sets, order[first])
    for index in range(1, int(sizes.max(initial=1))):
        rows = np.flatnonzero(sizes > index)
        sets = replace_rows(
            sets, rows, _around(take_rows(sets, rows), take_rows(branches.sets, order[first[rows] + index]))
        )
    merged = np.flatnonzero(sizes > 1)
    if free is not None and len(merged):
        whole = take_rows(branches.sets, np.searchsorted(track, free[unique[merged, 0]]))
        larger = _log_size(take_rows(sets, merged), n, side) > _log_size(whole, n, side)
        sets = replace_rows(sets, merged[larger], take_rows(whole, larger))
    return Branches(unique[:, 0].astype(np.intp), unique[:, 1].astype(np.int64), sets, within)


def _log_size(sets: RawSets, n: int, side: SideInformation) -> FloatArray:
    return strips.log_size(sets.generators[:, :n], side.plane)


def _around(one: RawSets, other: RawSets) -> RawSets:
    """Zonotopes around two sets each; constraints are dropped, and generators beyond those kept are boxed: outer."""
    count = KEPT_IN_HULLS + one.center.shape[1]
    first, second = (reduction.girard(sets.generators, count) for sets in (one, other))
    return RawSets.zonotope(*zonotope_hull(one.center, first, other.center, second))


def united(branches: Branches, tracks: Sequence[int] | Rows) -> RawSets:
    """One set per track of ``tracks`` (ascending, each with a branch) around all of its branches: outer, and the branch
    itself where there is one only."""
    wanted = np.asarray(tracks, dtype=np.intp)
    first = np.searchsorted(branches.track, wanted, side="left")
    sizes = np.searchsorted(branches.track, wanted, side="right") - first
    sets: RawSets = take_rows(branches.sets, first)
    for index in range(1, int(sizes.max(initial=1))):
        rows = np.flatnonzero(sizes > index)
        sets = replace_rows(sets, rows, _around(take_rows(sets, rows), take_rows(branches.sets, first[rows] + index)))
    return sets
