"""Tubes without branches whose sets follow from one another: all vehicles and steps in one compiled loop.

The result equals that of ``branching`` with a ``Recursion`` where one alternative remains at each step
(``cut_schedule``): at every step the set is moved (``step_kernel``), then cut. The sets without cuts are computed
beside those with cuts; up to the first active cut both are the same, and are computed once. A set that cuts did not
make smaller is published without them.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from reach_server.models.set_membership import Fitted
from reach_server.numeric.jit import ZERO, kernel, leaf_kernel
from reach_server.numeric.types import BoolArray, FloatArray, IntArray
from reach_server.predicates.cut_kinds import CutMethod
from reach_server.sets.kernels.planar import figures_one
from reach_server.sets.kernels.strip import ACTED, WORK, narrow_one
from reach_server.sets.raw import RawSets
from reach_server.tube.cut_schedule import CutSchedule
from reach_server.tube.recursion import Recursion
from reach_server.tube.step_kernel import StepSpec, StepWorkspace, advance_one, alive, columns_added, step_workspace
from reach_server.tube.unbranched import AskedStrips, UnbranchedTubes, asked_strips, most_asked


class InitialSets(NamedTuple):
    """What tubes start from, one row per vehicle: sets of now ``start`` (V, n) with ``generators``
    (V, n, g), past inputs (V, lags, m), boxes of the future ones, ``center`` and ``half`` (V, N, m)."""

    start: FloatArray
    generators: FloatArray
    past: FloatArray
    center: FloatArray
    half: FloatArray


class Track(NamedTuple):
    """A set at one step: ``center`` (z,), ``generators`` (z, G), and its summary, ``heights`` (K,), ``hull`` (2, n)."""

    center: FloatArray
    generators: FloatArray
    heights: FloatArray
    hull: FloatArray


class TubeWorkspace(NamedTuple):
    """Arrays of one tube: the track without cuts and the one with them, what each strip did, and workspaces."""

    own: Track
    cut: Track
    marks: NDArray[np.uint8]
    on: BoolArray
    none: BoolArray
    work: FloatArray
    vertices: FloatArray
    step: StepWorkspace


def recursion_tubes(
    motion: Recursion,
    start: RawSets,
    rows: NDArray[np.intp],
    schedule: CutSchedule,
    plane: tuple[int, int],
    cuts: CutMethod,
) -> UnbranchedTubes:
    """Tubes of the vehicles of some ``rows`` (B,) of a motion, which begin at ``start`` (all vehicles, n, without rows
    of constraints), cut by their ``schedule`` (B). ``cuts`` is ``zonotope`` or ``frobenius``; outer bounds."""
    inputs, rules = motion.inputs, motion.rules
    # One kind of array, or each kind is compiled when it comes first: one set for all vehicles is read-only.
    arrays = (start.center, start.generators, inputs.past, inputs.center, inputs.half)
    initial = InitialSets(*(np.require(array, requirements=("C", "W")) for array in arrays))
    # Inputs that are points need no generators, so their lags need no columns.
    lifted = rules.lags * rules.m if inputs.half[rows].any() else 0
    least = max(rules.order * (motion.layout.n + lifted), start.generators.shape[2])
    widest = least + 2 * most_asked(schedule)
    return _recursion_tubes(
        initial, motion.fitted, rules, rows.astype(np.int64), asked_strips(schedule, plane, cuts), widest
    )


@kernel
def _recursion_tubes(
    initial: InitialSets, fitted: Fitted, rules: StepSpec, rows: IntArray, strips: AskedStrips, widest: int
) -> UnbranchedTubes:
    """Tubes of some rows; ``widest`` columns are enough for a set after a reduction or a cut."""
    (vehicles, steps, count), n, sides = strips.asked.shape, initial.start.shape[1], len(strips.directions)
    z, steps = n + rules.lags * rules.m, steps - 1
    columns = widest + columns_added(fitted, rules)
    shape = (vehicles, steps)
    found = UnbranchedTubes(
        np.zeros((vehicles, steps, n)), np.zeros((vehicles, steps, n, widest)), np.zeros(shape, np.int64),
        np.zeros((vehicles, steps, n)), np.zeros((vehicles, steps, n, widest)), np.zeros(shape), np.zeros(shape),
        np.zeros((vehicles, steps, sides)), np.zeros((vehicles, steps, 2, n)),
        np.zeros((vehicles, steps + 1, count), np.bool_), np.full(vehicles, -1), np.ones(vehicles, np.bool_),
        np.zeros(vehicles, np.bool_),
    )  # fmt: skip
    own = Track(np.zeros(z), np.zeros((z, columns)), np.zeros(sides), np.zeros((2, n)))
    cut = Track(np.zeros(z), np.zeros((z, columns)), np.zeros(sides), np.zeros((2, n)))
    workspace = TubeWorkspace(
        own, cut, np.zeros(count, np.uint8), np.zeros(count, np.bool_), np.zeros(0, np.bool_),
        np.zeros((WORK, max(z, columns))), np.zeros((2, 2 * (columns + count) + 1, 2)),
        step_workspace(fitted, columns, z),
    )  # fmt: skip
    for b in range(vehicles):
        _tube(initial, fitted, rules, rows[b], b, strips, found, workspace)
    return found


@leaf_kernel
def _tube(
    initial: InitialSets,
    fitted: Fitted,
    rules: StepSpec,
    v: int,
    b: int,
    strips: AskedStrips,
    found: UnbranchedTubes,
    workspace: TubeWorkspace,
) -> None:
    """Compute the tube of row v into row b of ``found``."""
    n, z, count = initial.start.shape[1], len(workspace.own.center), len(strips.lower)
    own, cut, on = workspace.own, workspace.cut, workspace.on
    k, cutting, split = 0, True, False
    own_used = own_live = cut_used = cut_live = ZERO
    while k < strips.asked.shape[1]:
        if k == 0:
            own_used = _begin(initial, v, own)
            own_live = alive(own.generators, own_used, z, n)
        else:
            u, half = initial.center[v, k - 1], initial.half[v, k - 1]
            own_used, own_live, wrong = advance_one(
                own.center, own.generators, own_used, own_live, fitted, v, u, half, rules, workspace.step
            )
            found.contradicted[b] |= wrong
            if split:
                cut_used, cut_live, _ = advance_one(
                    cut.center, cut.generators, cut_used, cut_live, fitted, v, u, half, rules, workspace.step
                )
            found.area_free[b, k - 1] = _summarize(own, own_used, n, strips, workspace.none, workspace)
        asks = False
        for c in range(count):
            on[c] = strips.asked[b, k, c] and cutting
            asks = asks or on[c]
        if asks:
            if not split:
                cut_used, cut_live = own_used, own_live
                _copy(own, own_used, own_live, cut)
            # Rows that do not live are left out.
            cut_used, empty = narrow_one(
                cut.center[:cut_live], cut.generators[:cut_live], cut_used, strips.normal, strips.lower, strips.upper,
                on, strips.plane[0], strips.plane[1], strips.frobenius, workspace.marks, workspace.work,
            )  # fmt: skip
            if empty:
                # Nothing is left: all of the tube is published without cuts.
                found.ended[b], k, cutting, split = k, 0, False, False
                continue
            for c in range(count):
                found.active[b, k, c] = workspace.marks[c] & ACTED != 0
                split = split or strips.frobenius or found.active[b, k, c]
                # A strip that did not cut holds on the whole set.
                on[c] = found.active[b, k, c] and strips.planar[c]
        if k > 0:
            better, area = False, found.area_free[b, k - 1]
            if split:
                cut_area = _summarize(cut, cut_used, n, strips, on, workspace)
                better = strips.frobenius or cut_area <= area
                area = cut_area if better else area
            found.area[b, k - 1] = area
            _publish_free(own, own_used, n, b, k - 1, found)
            if better:
                _publish(cut, cut_used, n, b, k - 1, found)
            else:
                _publish(own, own_used, n, b, k - 1, found)
        k += 1


@leaf_kernel
def _summarize(track: Track, used: int, n: int, strips: AskedStrips, on: BoolArray, workspace: TubeWorkspace) -> float:
    """The area of a track; its heights and hull are set."""
    return figures_one(
        track.center, track.generators, used, n, strips.plane[0], strips.plane[1], strips.flat, strips.lower,
        strips.upper, on, strips.directions, track.heights, track.hull, workspace.vertices, workspace.work,
    )  # fmt: skip


@leaf_kernel
def _publish(track: Track, used: int, n: int, b: int, k: int, found: UnbranchedTubes) -> None:
    found.used[b, k] = used
    for i in range(n):
        found.center[b, k, i] = track.center[i]
        for j in range(used):
            found.generators[b, k, i, j] = track.generators[i, j]
        for j in range(2):
            found.hull[b, k, j, i] = track.hull[j, i]
            found.bounded[b] &= abs(track.center[i] + track.hull[j, i]) < np.inf
    for i in range(len(track.heights)):
        found.heights[b, k, i] = track.heights[i]


@leaf_kernel
def _publish_free(track: Track, used: int, n: int, b: int, k: int, found: UnbranchedTubes) -> None:
    for i in range(n):
        found.free_center[b, k, i] = track.center[i]
        for j in range(used):
            found.free_generators[b, k, i, j] = track.generators[i, j]
        for j in range(2):
            found.bounded[b] &= abs(track.center[i] + track.hull[j, i]) < np.inf


@leaf_kernel
def _begin(initial: InitialSets, v: int, track: Track) -> int:
    """The set of now over the state and the lagged inputs; columns used."""
    (_, n), (_, lags, m) = initial.start.shape, initial.past.shape
    center, generators = track.center, track.generators
    for row in range(len(generators)):
        for k in range(generators.shape[1]):
            generators[row, k] = 0.0
    used = 0
    for k in range(initial.generators.shape[2]):
        some = False
        for i in range(n):
            generators[i, used] = initial.generators[v, i, k]
            some = some or generators[i, used] != 0.0
        used += some
    for i in range(n):
        center[i] = initial.start[v, i]
    for lag in range(lags):
        for i in range(m):
            center[n + lag * m + i] = initial.past[v, lag, i]
    return used


@leaf_kernel
def _copy(track: Track, used: int, live: int, other: Track) -> None:
    for row in range(len(track.center)):
        other.center[row] = track.center[row]
        for k in range(used if row < live else other.generators.shape[1]):
            other.generators[row, k] = track.generators[row, k] if row < live else 0.0
