"""The data that bound the residual function best along the path of a vehicle, compiled.

Any choice is sound (``set_membership``, which has the bounds). For some points on the path these are chosen: the data
of least ``±d·r_j + Σ_i |d_i| drift_ji`` in every direction d, which are those that bind there, and the data of least
weighted drift, which serve the hull. The path is that of the centers of the sets: one step after the other by the model
alone.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from reach_server.models.set_membership import Fitted, weigh
from reach_server.numeric.jit import kernel, leaf_kernel
from reach_server.numeric.types import FloatArray, IntArray

#: Points on the path of a vehicle for which data is chosen.
POINTS = 3


class Data(NamedTuple):
    """Transitions of V vehicles, the data last so that loops over it run through memory in order: regressors ``z``
    (V, p, T), targets ``y`` (V, n, T), and which of them count, ``valid`` (V, T). Here also those of
    one vehicle, without the first axis."""

    z: FloatArray
    y: FloatArray
    valid: NDArray[np.bool_]


class SelectionWorkspace(NamedTuple):
    """Arrays of a search: ``residual`` and ``drift`` (n, T), ``score`` (T,), ``best`` (lists, k) ascending and
    ``index`` (lists, k) of the data found, -1 where none, ``chosen`` (T,)."""

    residual: FloatArray
    drift: FloatArray
    score: FloatArray
    best: FloatArray
    found: IntArray
    chosen: NDArray[np.bool_]


@kernel
def selection_workspace(fitted: Fitted, size: int, points: int, membership: bool) -> SelectionWorkspace:
    """Workspace to search ``size`` data for ``points`` points, as many of each kind as fit into ``fitted``."""
    n = fitted.low.shape[1]
    kinds = 1 + 2 * (n + fitted.directions.shape[1]) if membership else 1
    each = max(1, fitted.z.shape[2] // (points * kinds))
    return SelectionWorkspace(
        np.empty((n, size)), np.empty((n, size)), np.empty(size), np.empty((points * kinds, each)),
        np.empty((points * kinds, each), np.int64), np.empty(size, np.bool_),
    )  # fmt: skip


@leaf_kernel
def _residuals(data: Data, fitted: Fitted, v: int, residual: FloatArray) -> None:
    """``y - M [1; z]`` of all data."""
    for i in range(len(residual)):
        row, target, constant = residual[i], data.y[i], fitted.matrix[v, i, 0]
        for j in range(len(row)):
            row[j] = target[j] - constant
        for c in range(len(data.z)):
            z, slope = data.z[c], fitted.matrix[v, i, 1 + c]
            for j in range(len(row)):
                row[j] -= slope * z[j]


@leaf_kernel
def _drifts(data: Data, fitted: Fitted, v: int, at: FloatArray, drift: FloatArray) -> None:
    """``Σ_c L_ic |at - z_j|_c`` of all data."""
    for i in range(len(drift)):
        row = drift[i]
        row[:] = 0.0
        for c in range(len(at)):
            z, slope, middle = data.z[c], fitted.slope[v, i, c], at[c]
            if slope != 0.0:
                for j in range(len(row)):
                    row[j] += slope * abs(middle - z[j])


@leaf_kernel
def _rank(score: FloatArray, valid: NDArray[np.bool_], best: FloatArray, index: IntArray) -> None:
    """The data of least score."""
    last = len(best) - 1
    best[:] = np.inf
    index[:] = -1
    for j in range(len(score)):
        if score[j] < best[last] and valid[j]:
            k = last
            while k > 0 and best[k - 1] > score[j]:
                best[k], index[k] = best[k - 1], index[k - 1]
                k -= 1
            best[k], index[k] = score[j], j


@leaf_kernel
def _add(rows: FloatArray, i: int, factor: float, score: FloatArray) -> None:
    row = rows[i]
    for j in range(len(score)):
        score[j] += factor * row[j]


@leaf_kernel
def _search(
    data: Data,
    fitted: Fitted,
    v: int,
    points: FloatArray,
    weights: FloatArray,
    membership: bool,
    workspace: SelectionWorkspace,
) -> None:
    """Find the data of least score of every kind at every point."""
    n, directions = len(workspace.drift), fitted.directions.shape[1]
    kinds = len(workspace.best) // len(points)
    if membership:
        _residuals(data, fitted, v, workspace.residual)
    for number in range(len(points)):
        _drifts(data, fitted, v, points[number], workspace.drift)
        kind = number * kinds
        workspace.score[:] = 0.0
        for i in range(n):
            _add(workspace.drift, i, weights[i], workspace.score)
        _rank(workspace.score, data.valid, workspace.best[kind], workspace.found[kind])
        for direction in range(n + directions if membership else 0):
            for side in range(2):
                kind += 1
                workspace.found[kind] = -1
                workspace.score[:] = 0.0
                speaks = False
                for i in range(n):
                    d = (1.0 if i == direction else 0.0) if direction < n else fitted.directions[v, direction - n, i]
                    if d != 0.0:
                        speaks = True
                        _add(workspace.residual, i, d if side == 0 else -d, workspace.score)
                        _add(workspace.drift, i, abs(d), workspace.score)
                if speaks:
                    _rank(workspace.score, data.valid, workspace.best[kind], workspace.found[kind])


@leaf_kernel
def _select(data: Data, fitted: Fitted, v: int, index: int) -> None:
    """Add one datum to those that bound the residual function."""
    held = fitted.held[v]
    for c in range(data.z.shape[0]):
        fitted.z[v, c, held] = data.z[c, index]
    for i in range(data.y.shape[0]):
        residual = data.y[i, index] - fitted.matrix[v, i, 0]
        for c in range(data.z.shape[0]):
            residual -= fitted.matrix[v, i, 1 + c] * data.z[c, index]
        fitted.residual[v, i, held] = residual
    fitted.held[v] = held + 1


@leaf_kernel
def choose_one(
    data: Data,
    fitted: Fitted,
    v: int,
    points: FloatArray,
    weights: FloatArray,
    membership: bool,
    workspace: SelectionWorkspace,
) -> None:
    """Fill ``z``, ``residual`` and ``held`` of model v from the data of its vehicle, at most as many as there is room
    for: all if they are no more, else those that ``points`` (P, p) need; at least one if there is any. None without any
    bound L, where a single datum says nothing about other regressors."""
    size, most = len(data.valid), fitted.z.shape[2]
    fitted.held[v] = 0
    available = 0
    for j in range(size):
        available += data.valid[j]
    knows = False
    for i in range(data.y.shape[0]):
        for c in range(data.z.shape[0]):
            knows = knows or fitted.slope[v, i, c] > 0.0
    if not knows:
        return
    if available > most:
        _search(data, fitted, v, points, weights, membership, workspace)
        workspace.chosen[:] = False
        # The best of every kind first, in case there is not room for all.
        for k in range(workspace.found.shape[1]):
            for kind in range(len(workspace.found)):
                index = workspace.found[kind, k]
                if index >= 0 and not workspace.chosen[index] and fitted.held[v] < most:
                    workspace.chosen[index] = True
                    _select(data, fitted, v, index)
    if fitted.held[v] == 0:
        for j in range(size):
            if data.valid[j] and fitted.held[v] < most:
                _select(data, fitted, v, j)


@kernel
def choose_many(
    data: Data, rows: IntArray, fitted: Fitted, membership: bool, free: IntArray, increments: bool,
    state: FloatArray, past: FloatArray, inputs: FloatArray,
) -> None:  # fmt: skip
    """``choose_one`` for models whose data stand in ``rows`` (B,) of ``data``, on the paths that begin at ``state`` (B,
    n), with lagged inputs ``past`` (B, lags, m) and centers of inputs ``inputs`` (B, N, m).

    ``free``: the states among the regressors. ``increments``: the model gives changes of states, not states.
    """
    count, steps, m = inputs.shape
    lags, n, p = past.shape[1], state.shape[1], fitted.slope.shape[2]
    points = np.empty((min(POINTS, steps), p))
    workspace = selection_workspace(fitted, data.valid.shape[1], len(points), membership)
    weights, here, after, at = np.empty(n), np.empty(n), np.empty(n), np.empty(p)
    for b in range(count):
        one = Data(data.z[rows[b]], data.y[rows[b]], data.valid[rows[b]])
        weigh(fitted, b, weights)
        here[:] = state[b]
        for k in range(steps):
            for c in range(len(free)):
                at[c] = here[free[c]]
            for lag in range(lags + 1):
                for i in range(m):
                    value = inputs[b, k - lag, i] if k >= lag else past[b, lag - k - 1, i]
                    at[len(free) + lag * m + i] = value
            for number in range(len(points)):
                if k == number * (steps - 1) // max(len(points) - 1, 1):
                    points[number] = at
            for i in range(n):
                after[i] = fitted.matrix[b, i, 0] + (here[i] if increments else 0.0)
                for c in range(p):
                    after[i] += fitted.matrix[b, i, 1 + c] * at[c]
            here[:] = after
        choose_one(one, fitted, b, points, weights, membership, workspace)
