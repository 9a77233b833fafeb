"""Set-membership bounds of a residual function from data, compiled.

Data j = 1 … T has regressors z_j and residuals ``r_j = y+_j - M [1; z_j]``; the residual function e, at the true
regressors ξ_j of the data, satisfies ``e(ξ_j) ∈ r_j ⊕ N`` (``model``), N symmetric, and ``|e_i(ξ) - e_i(ξ')| <= Σ_c
L_ic |ξ_c - ξ'_c|``. On a box of regressors with center q and half-widths h

    drift_ji = Σ_c L_ic (|q - z_j|_c + h_c + |z_noise|_c)

bounds, by component, how far e is from ``e(ξ_j)``: ``|ξ_jc - z_jc| <= |z_noise|_c``. It takes the place of the covering
radius of the paper, and needs no covering assumption: far from all data it is large. So for every datum

    e ∈ r_j ⊕ N ⊕ box(drift_j)                                                                      (1)

*Residual hull:* ``e ∈ hull ⊕ N ⊕ box(drift_j)``, hull the box of all residuals, for any one j. All components must take
the same j: with the least drift of each a correlated N would lose values. Taken is the j of least drift, measured by
the widths of hull and N.

*Set membership* [MN04]: (1) holds for all data at once, so that in every direction d

    max_j (d·r_j - Σ_i |d_i| drift_ji) - |dᵀN|₁ <= d·e <= min_j (d·r_j + Σ_i |d_i| drift_ji) + |dᵀN|₁

Directions are the axes and, per model, some in which N is thin: in the axes alone a correlated N would be counted by
its box. The set is what is smaller of hull and box of the axes, cut by the strips of the other directions (of all
directions if it is the hull): every cut is an enclosure that is not larger, so neither is the result, than the hull of
the same data. Where a lower bound exceeds its upper bound the data contradicts N or L; the hull is taken, and that is
said. Without any bound L every single datum would speak about the whole set: then the hull is taken, too; such models
hold no data.

*Any subset of the data is sound*, as each datum gives a bound of its own. ``data_selection`` chooses, for some points
on the path of the vehicle, the data that bind there: those of least ``±d·r_j + Σ|d_i| drift_ji`` in every direction,
and those of least drift. The half-widths of the set do not matter to the choice, they are the same for all data.

Rounding. N carries what the residuals may have lost (``model``); what is computed here are sums of at most
p + n + 4 terms, positive but for the residuals, and bounds are moved outwards by ``(p + n + 8) EPS`` times their sizes.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.jit import NO, kernel, leaf_kernel
from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import FloatArray, IntArray
from reach_server.sets.kernels.planar import pair_area
from reach_server.sets.kernels.strip import WORK, narrow_one

#: A lower bound exceeds an upper one if it does by more than this, relative to the two.
CONTRADICTION = 1e-9
TINY = float(np.finfo(np.float64).tiny)


class Fitted(NamedTuple):
    """Arrays of ``residual_model.Model``, one row per vehicle, all contiguous."""

    matrix: FloatArray
    z: FloatArray
    residual: FloatArray
    held: IntArray
    low: FloatArray
    high: FloatArray
    noise: FloatArray
    slope: FloatArray
    z_noise: FloatArray
    directions: FloatArray


class HullWorkspace(NamedTuple):
    """Intermediate arrays of ``residual_one``: ``drift`` (n, B), ``distance`` (2, B), ``sides`` (6, n + K),
    ``normals`` (n + K, n), ``active`` and ``acted`` (n + K,), ``center`` (n,), ``generators`` (n, C), ``cuts``."""

    drift: FloatArray
    distance: FloatArray
    sides: FloatArray
    normals: FloatArray
    active: NDArray[np.bool_]
    acted: NDArray[np.uint8]
    center: FloatArray
    generators: FloatArray
    cuts: FloatArray


@kernel
def hull_workspace(fitted: Fitted) -> HullWorkspace:
    """Workspace for the sets of some models."""
    n, data = fitted.residual.shape[1], fitted.residual.shape[2]
    directions = n + fitted.directions.shape[1]
    columns = fitted.noise.shape[2] + n + 2 * directions
    normals = np.zeros((directions, n))
    for i in range(n):
        normals[i, i] = 1.0
    return HullWorkspace(
        np.empty((n, data)), np.empty((2, data)), np.zeros((6, directions)), normals, np.empty(directions, np.bool_),
        np.empty(directions, np.uint8), np.empty(n), np.zeros((n, columns)), np.empty((WORK, max(n, columns))),
    )  # fmt: skip


@leaf_kernel
def _drifts(fitted: Fitted, v: int, q: FloatArray, workspace: HullWorkspace) -> None:
    """``Σ_c L_ic |q - z_j|_c`` of all data of a vehicle."""
    n, count = len(workspace.drift), fitted.held[v]
    # Indices instead of views of rows: a view costs as much as the work on it.
    for i in range(n):
        for j in range(count):
            workspace.drift[i, j] = 0.0
    for c in range(len(q)):
        at = q[c]
        for j in range(count):
            workspace.distance[0, j] = abs(at - fitted.z[v, c, j])
        for i in range(n):
            slope = fitted.slope[v, i, c]
            if slope != 0.0:
                for j in range(count):
                    workspace.drift[i, j] += slope * workspace.distance[0, j]


@leaf_kernel
def weigh(fitted: Fitted, v: int, weights: FloatArray) -> None:
    """One over the widths of hull and N, by component."""
    widest = 0.0
    for i in range(len(weights)):
        weights[i] = (fitted.high[v, i] - fitted.low[v, i]) / 2
        for g in range(fitted.noise.shape[2]):
            weights[i] += abs(fitted.noise[v, i, g])
        widest = max(widest, weights[i])
    for i in range(len(weights)):
        weights[i] = 1.0 / max(weights[i], 1e-6 * widest) if widest > 0.0 else 1.0


@leaf_kernel
def _nearest(count: int, workspace: HullWorkspace, weights: FloatArray) -> int:
    """The datum of least weighted drift."""
    best, least = 0, np.inf
    for j in range(count):
        size = 0.0
        for i in range(len(weights)):
            size += weights[i] * workspace.drift[i, j]
        if size < least:
            best, least = j, size
    return best


@leaf_kernel
def _sides(fitted: Fitted, v: int, direction: int, constant: FloatArray, workspace: HullWorkspace) -> None:
    """Bounds of d·e over all data: ``sides[0]`` and ``sides[1]``."""
    n, count = len(workspace.drift), fitted.held[v]
    for j in range(count):
        workspace.distance[0, j] = 0.0
        workspace.distance[1, j] = 0.0
    slack, reach = 0.0, 0.0
    for i in range(n):
        d = workspace.normals[direction, i]
        if d != 0.0:
            slack += abs(d) * constant[i]
            reach += abs(d) * max(abs(fitted.low[v, i]), abs(fitted.high[v, i]))
            for j in range(count):
                workspace.distance[0, j] += d * fitted.residual[v, i, j]
                workspace.distance[1, j] += abs(d) * workspace.drift[i, j]
    for g in range(fitted.noise.shape[2]):
        height = 0.0
        for i in range(n):
            height += workspace.normals[direction, i] * fitted.noise[v, i, g]
        slack += abs(height)
    low, high = -np.inf, np.inf
    for j in range(count):
        low = max(low, workspace.distance[0, j] - workspace.distance[1, j])
        high = min(high, workspace.distance[0, j] + workspace.distance[1, j])
    margin = (fitted.slope.shape[2] + n + 8) * EPS
    workspace.sides[0, direction] = low - slack - margin * (abs(low) + reach + slack)
    workspace.sides[1, direction] = high + slack + margin * (abs(high) + reach + slack)


@leaf_kernel
def _hull(fitted: Fitted, v: int, half: FloatArray, extra: FloatArray, workspace: HullWorkspace) -> int:
    """The hull set with ``half`` (n,) for its box, and a box of ``extra`` half-widths beside it; its columns."""
    n, g = len(workspace.center), fitted.noise.shape[2]
    for i in range(n):
        workspace.center[i] = (fitted.low[v, i] + fitted.high[v, i]) / 2
        for k in range(g):
            workspace.generators[i, k] = fitted.noise[v, i, k]
        workspace.generators[i, i] += half[i] + extra[i]
    return int(g)


@leaf_kernel
def _axis_box(extra: FloatArray, workspace: HullWorkspace) -> int:
    """The box of the bounds in the axes, enlarged by ``extra`` half-widths; its columns."""
    n = len(workspace.center)
    for i in range(n):
        low, high = workspace.sides[0, i], workspace.sides[1, i]
        workspace.center[i] = (low + high) / 2
        for k in range(n):
            workspace.generators[i, k] = 0.0
        # Half the difference may round below what the rounded center needs.
        workspace.generators[i, i] = (high - low) / 2 + EPS * (abs(low) + abs(high)) + extra[i]
    return n


@leaf_kernel
def _log_size(generators: FloatArray, used: int, plane0: int, plane1: int) -> float:
    """Logarithm of the area in the plane times the widths of the other coordinates."""
    size = 0.0
    if plane0 >= 0:
        size = np.log(max(pair_area(generators, plane0, plane1, used), TINY))
    for i in range(len(generators)):
        if i not in (plane0, plane1):
            width = 0.0
            for k in range(used):
                width += 2 * abs(generators[i, k])
            size += np.log(max(width, TINY))
    return size


@leaf_kernel
def residual_one(
    fitted: Fitted,
    v: int,
    q: FloatArray,
    half: FloatArray,
    extra: FloatArray,
    membership: bool,
    plane0: int,
    plane1: int,
    workspace: HullWorkspace,
) -> tuple[int, bool]:
    """The set that holds e on the regressors ``q ± half`` (p,), plus a box of half-widths ``extra`` (n,),
    written to ``workspace.center`` and ``workspace.generators``: the number of its columns, and whether the data
    contradicts the stated bounds."""
    n = len(workspace.center)
    constant, hull_half = workspace.sides[2], workspace.sides[4]
    known, nearest = False, 0
    for i in range(n):
        constant[i], hull_half[i] = 0.0, 0.0
        for c in range(len(q) if fitted.z.shape[2] > 0 else 0):
            slope = fitted.slope[v, i, c]
            if slope != 0.0:
                constant[i] += slope * (half[c] + fitted.z_noise[v, c])
                known = True
    if known:
        weights = workspace.sides[3, :n]
        _drifts(fitted, v, q, workspace)
        weigh(fitted, v, weights)
        nearest = _nearest(fitted.held[v], workspace, weights)
        for i in range(n):
            # Bounds of slopes say nothing without a datum.
            hull_half[i] = workspace.drift[i, nearest] + constant[i] if fitted.held[v] > 0 else np.inf
    margin = 1.0 + (len(q) + n + 8) * EPS
    for i in range(n):
        low, high = fitted.low[v, i], fitted.high[v, i]
        hull_half[i] = (hull_half[i] + (high - low) / 2) * margin + EPS * (abs(low) + abs(high))
    if not (membership and known):
        return _hull(fitted, v, hull_half, extra, workspace), False
    for direction in range(len(workspace.normals)):
        workspace.active[direction] = direction < n
        if direction >= n:
            for i in range(n):
                workspace.normals[direction, i] = fitted.directions[v, direction - n, i]
                workspace.active[direction] = workspace.active[direction] or workspace.normals[direction, i] != 0.0
        if workspace.active[direction]:
            _sides(fitted, v, direction, constant, workspace)
            low, high = workspace.sides[0, direction], workspace.sides[1, direction]
            # Written so that a NaN counts as a contradiction.
            if not low <= high + CONTRADICTION * (abs(low) + abs(high)):
                return _hull(fitted, v, hull_half, extra, workspace), True
            workspace.sides[0, direction], workspace.sides[1, direction] = min(low, high), max(low, high)
    return _smaller(fitted, v, hull_half, extra, plane0, plane1, workspace)


@leaf_kernel
def _smaller(
    fitted: Fitted, v: int, hull_half: FloatArray, extra: FloatArray, plane0: int, plane1: int, workspace: HullWorkspace
) -> tuple[int, bool]:
    """The smaller one of hull and box, cut by the strips that are left; see ``residual_one``.

    The box lies in the interval hull of the hull set: the bounds of one datum, the nearest, would lie there already.
    """
    n, nothing = len(workspace.center), workspace.sides[5]
    cuts = False
    for direction in range(n, len(workspace.active)):
        cuts = cuts or workspace.active[direction]
    used = _axis_box(nothing if cuts else extra, workspace)
    box_size = _log_size(workspace.generators, used, plane0, plane1)
    used = _hull(fitted, v, hull_half, nothing, workspace)
    if box_size <= _log_size(workspace.generators, used, plane0, plane1):
        used = _axis_box(nothing if cuts else extra, workspace)
        if not cuts:
            return used, False
        for i in range(n):
            workspace.active[i] = False
    used, empty = narrow_one(
        workspace.center, workspace.generators, used, workspace.normals, workspace.sides[0], workspace.sides[1],
        workspace.active, plane0, plane1, NO, workspace.acted, workspace.cuts,
    )  # fmt: skip
    if empty:
        return _hull(fitted, v, hull_half, extra, workspace), True
    for k in range(n):
        for i in range(n):
            workspace.generators[i, used + k] = extra[i] if i == k else 0.0
    return used + n, False


@kernel
def residual_sets(
    fitted: Fitted, center: FloatArray, half: FloatArray, membership: bool, plane0: int, plane1: int
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """``residual_one`` for a box (V, p) of every vehicle: centers (V, n), generators (V, n, g), contradicted (V,)."""
    count, n = fitted.low.shape
    workspace = hull_workspace(fitted)
    centers, generators = np.empty((count, n)), np.zeros((count, n, workspace.generators.shape[1]))
    contradicted = np.empty(count, np.bool_)
    nothing = np.zeros(n)
    for v in range(count):
        used, wrong = residual_one(fitted, v, center[v], half[v], nothing, membership, plane0, plane1, workspace)
        contradicted[v] = wrong
        centers[v] = workspace.center
        generators[v, :, :used] = workspace.generators[:, :used]
    return centers, generators, contradicted
