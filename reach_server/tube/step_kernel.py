"""One step of one set by a model with bounded residuals, compiled.

A set is a zonotope over the state and the lagged inputs together, z = n + lags m coordinates, so that an input inside
the horizon and the steps that it acts on later share their factors: ``center`` (z,), ``generators`` (z + r, G) of which
the first ``used`` columns count; r further rows are those of constraints on the factors, which stay what they are. Rows
from ``live`` on are zero: inputs that are points need no generators.

The regressors q are the states of the model, the input of the step and the lagged ones; their set S is that of the same
factors. With the model M and the set E(S) of the residual function (``set_membership``), the next state, or the
increment, lies in ``M (1 × S) ⊕ E(S) ⊕ Z_w``: exactly the paper's recursion, with bounds for S in place of one for all
sets.

In the body frame the increment is turned by the heading (``rotation_kernel``); at last generators are reduced
(``sets.kernels.girard``).

Rounding. Every number is a sum of at most p + G + 8 products; ``(p + G + 16) EPS`` times the sizes of the terms, of
state and increment, is added to the box of each step.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from reach_server.models.set_membership import Fitted, HullWorkspace, hull_workspace, residual_one
from reach_server.numeric.jit import ZERO, kernel, leaf_kernel
from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import FloatArray, IntArray
from reach_server.sets.kernels.order_reduction import reduce_one
from reach_server.tube.rotation_kernel import turn_one


class StepSpec(NamedTuple):
    """One step of the sets of a class: ``free`` (f,), the states among the regressors; ``pose``, where increments are
    in the vehicle's own frame: indices of two positions and the heading, else -1; ``plane`` in which areas count, or
    -1; numbers of inputs ``m`` and ``lags``; process noise, ``axis`` half-widths (n,) and further generators
    ``process`` (n, g); whether set membership is used; ``order``, how many generators a set keeps for each of its live
    rows."""

    free: IntArray
    pose: tuple[int, int, int]
    plane: tuple[int, int]
    m: int
    lags: int
    axis: FloatArray
    process: FloatArray
    membership: bool
    order: int


class StepWorkspace(NamedTuple):
    """Arrays of one step: regressors ``q`` and their ``half`` (p,), ``moved`` (n, G) and its center ``shift`` (n,),
    what is added to the box ``extra`` (n,), the ``rest`` of a turn (4,), ``score`` (2, G), ``width`` (z + r,) and
    ``order`` (G,) of a reduction, and ``hull``, that of the residual set."""

    q: FloatArray
    half: FloatArray
    moved: FloatArray
    shift: FloatArray
    extra: FloatArray
    rest: FloatArray
    score: FloatArray
    width: FloatArray
    order: IntArray
    hull: HullWorkspace


@kernel
def step_workspace(fitted: Fitted, columns: int, rows: int) -> StepWorkspace:
    """Workspace for sets of ``rows`` rows and up to ``columns`` columns."""
    n, p = fitted.slope.shape[1:]
    return StepWorkspace(
        np.empty(p), np.empty(p), np.empty((n, columns)), np.empty(n), np.empty(n), np.empty(4),
        np.empty((2, columns)), np.empty(rows), np.empty(columns, np.int64), hull_workspace(fitted),
    )  # fmt: skip


@kernel
def columns_added(fitted: Fitted, rules: StepSpec) -> int:
    """Columns that one step adds at most, before it is reduced."""
    n, directions = fitted.low.shape[1], fitted.directions.shape[1]
    return int(rules.m + fitted.noise.shape[2] + n + 2 * (n + directions) + rules.process.shape[1] + n + 2)


@leaf_kernel
def _regressors(
    center: FloatArray,
    generators: FloatArray,
    used: int,
    live: int,
    u: FloatArray,
    u_half: FloatArray,
    rules: StepSpec,
    workspace: StepWorkspace,
) -> None:
    """Center and half-widths of the regressors."""
    free, n, m = len(rules.free), len(workspace.shift), rules.m
    for c in range(len(workspace.q)):
        if free <= c < free + m:
            workspace.q[c], workspace.half[c] = u[c - free], u_half[c - free]
        else:
            row = rules.free[c] if c < free else n + c - free - m
            reach = 0.0
            for k in range(used if row < live else 0):
                reach += abs(generators[row, k])
            workspace.q[c], workspace.half[c] = center[row], reach * (1.0 + used * EPS)


@leaf_kernel
def _through_model(
    generators: FloatArray,
    used: int,
    fitted: Fitted,
    v: int,
    u_half: FloatArray,
    rules: StepSpec,
    workspace: StepWorkspace,
) -> int:
    """The image of the regressors under the model: to ``shift`` and ``moved``, the sizes of its terms to ``extra``; the
    columns then used."""
    free, n, m = len(rules.free), len(workspace.shift), rules.m
    for i in range(n):
        total = fitted.matrix[v, i, 0]
        size = abs(total)
        for c in range(len(workspace.q)):
            slope = fitted.matrix[v, i, 1 + c]
            total += slope * workspace.q[c]
            size += abs(slope) * (abs(workspace.q[c]) + workspace.half[c])
        workspace.shift[i], workspace.extra[i] = total, size
        for k in range(used):
            workspace.moved[i, k] = 0.0
        for c in range(len(workspace.q)):
            slope = fitted.matrix[v, i, 1 + c]
            if (c < free or c >= free + m) and workspace.half[c] > 0.0 and slope != 0.0:
                row = rules.free[c] if c < free else n + c - free - m
                for k in range(used):
                    workspace.moved[i, k] += slope * generators[row, k]
    count = used
    for a in range(m):
        if u_half[a] > 0.0:
            for i in range(n):
                workspace.moved[i, count] = fitted.matrix[v, i, 1 + free + a] * u_half[a]
            count += 1
    return count


@leaf_kernel
def _append(columns: FloatArray, width: int, count: int, workspace: StepWorkspace) -> int:
    for k in range(width):
        some = False
        for i in range(len(workspace.shift)):
            some = some or columns[i, k] != 0.0
        if some:
            for i in range(len(workspace.shift)):
                workspace.moved[i, count] = columns[i, k]
            count += 1
    return count


@leaf_kernel
def _shift_lags(
    center: FloatArray,
    generators: FloatArray,
    used: int,
    live: int,
    u: FloatArray,
    u_half: FloatArray,
    n: int,
    rules: StepSpec,
) -> None:
    """The newest lag is the input of this step, whose columns come after those used; the others move back by one."""
    m = rules.m
    for row in range(n + rules.lags * m - 1, n - 1, -1):
        center[row] = center[row - m] if row >= n + m else u[row - n]
    # Without lags the rows that are live beside the states are those of constraints, which stay what they are.
    if live == n or rules.lags == 0:
        return
    for row in range(n + rules.lags * m - 1, n + m - 1, -1):
        for k in range(used):
            generators[row, k] = generators[row - m, k]
    count = used
    for a in range(m):
        for k in range(used):
            generators[n + a, k] = 0.0
        if u_half[a] > 0.0:
            generators[n + a, count] = u_half[a]
            count += 1


@leaf_kernel
def advance_one(
    center: FloatArray,
    generators: FloatArray,
    used: int,
    live: int,
    fitted: Fitted,
    v: int,
    u: FloatArray,
    u_half: FloatArray,
    rules: StepSpec,
    workspace: StepWorkspace,
) -> tuple[int, int, bool]:
    """Move a set on by one step in place, under inputs ``u ± u_half`` (m,) and the model of row v: columns used, rows
    live, and whether the data contradicts the stated bounds. An outer bound; there must be room for ``columns_added``
    more, and the rows that are not live must be zero."""
    n, body = len(workspace.shift), rules.pose[0] >= 0
    if rules.lags > 0 and live == n:
        for a in range(rules.m):
            if u_half[a] > 0.0:
                live = len(generators)
    _regressors(center, generators, used, live, u, u_half, rules, workspace)
    count = _through_model(generators, used, fitted, v, u_half, rules, workspace)
    lost = (len(workspace.q) + used + 16) * EPS
    for i in range(n):
        # What positions of the body frame lose belongs to the turn.
        own = 0.0 if body and i in (rules.pose[0], rules.pose[1]) else abs(center[i])
        workspace.extra[i] = rules.axis[i] + lost * (workspace.extra[i] + own)
    width, contradicted = residual_one(
        fitted,
        v,
        workspace.q,
        workspace.half,
        workspace.extra,
        rules.membership,
        rules.plane[0],
        rules.plane[1],
        workspace.hull,
    )
    for i in range(n):
        workspace.shift[i] += workspace.hull.center[i]
    count = _append(workspace.hull.generators, width, count, workspace)
    count = _append(rules.process, rules.process.shape[1], count, workspace)
    if body:
        turn_one(center, generators, used, workspace.shift, workspace.moved, count, rules.pose, workspace.rest)
    columns = count + 2 if body else count
    for row in range(live):
        for k in range(used, columns):
            generators[row, k] = 0.0
    _shift_lags(center, generators, used, live, u, u_half, n, rules)
    for i in range(n):
        if body:
            center[i] += workspace.shift[i]
            for k in range(used):
                generators[i, k] += workspace.moved[i, k]
        else:
            center[i] = workspace.shift[i]
            for k in range(used):
                generators[i, k] = workspace.moved[i, k]
        for k in range(used, count):
            generators[i, k] = workspace.moved[i, k]
    if body:
        first, second = rules.pose[0], rules.pose[1]
        generators[first, count], generators[second, count] = workspace.rest[0], workspace.rest[1]
        generators[first, count + 1], generators[second, count + 1] = workspace.rest[2], workspace.rest[3]
    used = reduce_one(
        generators, columns, live, (rules.order - 1) * live, workspace.score, workspace.width, workspace.order
    )
    return used, live, contradicted


@leaf_kernel
def alive(generators: FloatArray, used: int, rows: int, n: int) -> int:
    """Rows that are live: the n states if no other of the first ``rows`` has a generator, else all."""
    for row in range(n, rows):
        for k in range(used):
            if generators[row, k] != 0.0:
                return rows
    return n


@kernel
def advance_many(
    centers: FloatArray,
    generators: FloatArray,
    vehicle: IntArray,
    fitted: Fitted,
    inputs: FloatArray,
    halves: FloatArray,
    rules: StepSpec,
    new_centers: FloatArray,
    new_generators: FloatArray,
) -> tuple[int, NDArray[np.bool_]]:
    """``advance_one`` for sets (R, z) and (R, z + r, G) of the vehicles (R,), under inputs (V, m): most columns used,
    and contradicted (R,). Columns of zeros do not count, so that the result of a set does not depend on the sets beside
    it."""
    rows, columns = generators.shape[1:]
    wrong = np.empty(len(centers), np.bool_)
    workspace = step_workspace(fitted, new_generators.shape[2], rows)
    most = 0
    for number in range(len(centers)):
        center, after = new_centers[number], new_generators[number]
        center[:] = centers[number]
        used = ZERO
        for k in range(columns):
            some = False
            for row in range(rows):
                after[row, used] = generators[number, row, k]
                some = some or after[row, used] != 0.0
            used += some
        v = vehicle[number]
        live = alive(after, used, rows, fitted.low.shape[1])
        used, live, wrong[number] = advance_one(
            center, after, used, live, fitted, v, inputs[v], halves[v], rules, workspace
        )
        for row in range(rows):
            for k in range(used if row < live else 0, len(after[row])):
                after[row, k] = 0.0
        most = max(most, used)
    return most, wrong
