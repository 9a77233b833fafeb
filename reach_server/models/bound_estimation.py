"""Noise and Lipschitz bounds that recorded data agrees with: a hypothesis where nobody knows them, no guarantee.

The model of residual functions (``residual_model``): measured regressors ``z_j``, residuals ``r_j`` of a matrix M, and
a function e with ``|e_i(ξ) - e_i(ξ')| <= Σ_c L_ic |ξ_c - ξ'_c|`` and ``|e_i(ξ_j) - r_ji| <= |N|_i = w_i + k_i``, w the
half-widths of the process noise and k what the measurement noise adds to N. With ``ζ`` the half-widths of the errors of
the regressors, two data differ by at most

    |r_ji - r_ki|  <=  2 (w_i + k_i) + Σ_c L_ic ( |z_j - z_k|_c + 2 ζ_c )          for all pairs (j, k).      (1)

Conversely, where (1) holds the bounds of set membership never cross, whatever set of regressors is asked about: for its
distances D from two data, ``D_jc + D_kc >= |z_j - z_k|_c + 2 ζ_c``. Data and bounds do not contradict each other then;
with ζ = 0 there is such an e [MN04]. All of this by component: where N is no box, residuals are bounded in
slanted directions, too, of which (1) says nothing; a margin on w does.

Of all pairs (w, L) that satisfy (1) the one of least expected width is taken,

    minimise  w_i + Σ_c L_ic E[D_c]      subject to (1), w >= 0, L >= 0,

a linear program for each component; E[D_c] is how far the nearest datum is from another on average, with ζ for the
datum and ζ for the set that is asked about. Of the T² constraints those that are violated are added round by round
(cutting planes [Kel60]). Against data that is wrong a gate comes first: residuals beyond ``GATE`` times the 99 %
quantile of their distance from the median are left out of everything. Windows that hold such data contradict the
bounds, which the engine tells.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from fleet_bus.errors import UsageError
from reach_server.data.regressors import RegressorSpec, Transitions
from reach_server.models.residual_model import NoiseBounds, apply, noise_set
from reach_server.numeric.jit import kernel
from reach_server.numeric.types import FloatArray

#: Residuals farther from their median than this many times the 99 % quantile of that distance are gated.
GATE: Final = 4.0
#: Rounds of cutting planes, and constraints that a round adds at most.
ROUNDS, ADDED = 60, 150
#: Violations below this part of the range of the residuals end the rounds; what is left of them goes to w.
VIOLATION: Final = 1e-3
#: Data whose nearest neighbours are looked for, of each vehicle.
ASKED: Final = 1000


@dataclass(frozen=True, slots=True, eq=False)
class ConsistentBounds:
    """Bounds that the data satisfies, pair by pair: half-widths ``w`` (n,) of the process noise, in the frame of the
    model, and slopes ``slope`` (n, p) of the residual function; ``retained`` (V, T) the data that passed the gate."""

    w: FloatArray
    slope: FloatArray
    retained: NDArray[np.bool_]

    def derivatives(self, matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds (n, p) of the derivatives of the dynamics that follow, for the ``matrix`` (V, n, 1 +
        p) that the bounds were taken with. In this form they outlast a refit: slopes of the residual function belong to
        one matrix."""
        slopes = matrix[..., 1:]
        return (slopes - self.slope).min(axis=0), (slopes + self.slope).max(axis=0)


def consistent_bounds(
    data: Transitions, layout: RegressorSpec, matrix: FloatArray, z_v: FloatArray
) -> ConsistentBounds:
    """Bounds of least expected width that agree with all pairs of transitions of each of V vehicles: a hypothesis, no
    guarantee (mathematics, 2.9) [MN04, Kel60].

    ``matrix`` (V, n, 1 + p) are the models of the vehicles, ``z_v`` (n,) half-widths of the measurement noise. Raises
    ``UsageError`` where a vehicle has less than two usable transitions.
    """
    if data.usable.sum(axis=1).min(initial=2) < 2:
        raise UsageError("noise and Lipschitz bounds need at least two transitions")
    residual = data.target - apply(matrix, data.z)
    retained = data.usable & _passes(residual, data.usable)
    gated = Transitions(data.z, data.target, retained, data.newest)
    added = noise_added(gated, layout, matrix, z_v)
    z_noise = np.concatenate([z_v[list(layout.free)], np.zeros(layout.regressors - len(layout.free))])
    indices = [np.flatnonzero(row) for row in retained]
    z = [np.ascontiguousarray(data.z[v, rows]) for v, rows in enumerate(indices)]
    n, p = matrix.shape[1], layout.regressors
    widths = np.mean([_nearest(one, np.ptp(one, axis=0)) for one in z], axis=0) + 2.0 * z_noise
    w, slope = np.zeros(n), np.zeros((n, p))
    for i in range(n):
        r = [np.ascontiguousarray(residual[v, rows, i]) for v, rows in enumerate(indices)]
        w[i], slope[i] = _least(z, r, added[:, i], z_noise, widths)
    return ConsistentBounds(w, slope, retained)


def noise_added(data: Transitions, layout: RegressorSpec, matrix: FloatArray, z_v: FloatArray) -> FloatArray:
    """Half-widths (V, n) of what measurement noise with half-widths ``z_v`` (n,) adds to N; outer."""
    seen = np.where(data.usable[..., None], np.abs(np.concatenate([data.z, data.target], axis=2)), 0.0).max(axis=1)
    bounds = NoiseBounds(np.zeros((layout.n, 0)), np.diag(z_v))
    return np.asarray(np.abs(noise_set(matrix, seen, layout, bounds)).sum(axis=-1))


def _passes(residual: FloatArray, usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which data (V, T) pass the gate, of each vehicle by its own residuals (V, T, n)."""
    held = np.where(usable[..., None], residual, np.nan)
    off = np.abs(held - np.nanmedian(held, axis=1, keepdims=True))
    return np.asarray((off <= GATE * np.nanquantile(off, 0.99, axis=1, keepdims=True)).all(axis=2))


def _nearest(z: FloatArray, scale: FloatArray) -> FloatArray:
    """Mean distance (p,) of the data (T, p) from their nearest neighbours, distances measured by ``scale`` (p,)."""
    asked = np.linspace(0, len(z) - 1, min(len(z), ASKED)).astype(np.intp)
    found = nearest(z, 1.0 / np.where(scale > 0, scale, 1.0), asked)
    # A direction in which neighbours agree must cost something, or its slope would be anything.
    return np.asarray(np.maximum(np.abs(z[asked] - z[found]).mean(axis=0), 1e-4 * scale))


def _least(
    z: list[FloatArray], r: list[FloatArray], added: FloatArray, z_noise: FloatArray, widths: FloatArray
) -> tuple[float, FloatArray]:
    """w and L (p,) of one component: the linear program over the pairs that were found violated so far."""
    p = len(z_noise)
    span = max(float(np.ptp(one)) for one in r)
    scale = np.max([np.ptp(one, axis=0) for one in z], axis=0)
    varies = scale > 1e-12 * np.max([np.abs(one).max(axis=0) for one in z], axis=0)
    if span <= 0.0:
        return 0.0, np.zeros(p)
    # In units of the span and of the ranges of the regressors.
    unit = np.where(varies, scale, 1.0)
    costs = np.append(1.0, np.where(varies, widths / unit, 0.0))
    rows, right = np.zeros((0, 1 + p)), np.zeros(0)
    bounds = [(0.0, None), *((0.0, None if v else 0.0) for v in varies)]
    best = np.zeros(1 + p)
    for _ in range(ROUNDS):
        slope = span * best[1:] / unit
        found = []
        for one, values, noise in zip(z, r, added, strict=True):
            slack = 2.0 * (span * best[0] + noise + float(slope @ z_noise))
            excess, other = violations(one, values, np.argsort(values), slope, slack)
            j = np.flatnonzero(excess > VIOLATION * span)
            pair = np.abs(one[j] - one[other[j]]) + 2.0 * z_noise
            difference = np.abs(values[j] - values[other[j]]) - 2.0 * noise
            found.append((excess[j], np.column_stack([np.full(len(j), 2.0), pair / unit]), difference / span))
        excess, new, needed = (np.concatenate(part) for part in zip(*found, strict=True))
        if not len(excess):
            break
        most = np.argsort(-excess, kind="stable")[:ADDED]
        rows, right = np.concatenate([rows, new[most]]), np.concatenate([right, needed[most]])
        solved = linprog(costs, A_ub=-rows, b_ub=-right, bounds=bounds, method="highs")
        if solved.status != 0 or solved.x is None:
            break
        best = np.maximum(solved.x, 0.0)
    return _settled(z, r, added, z_noise, span * best[0], span * best[1:] / unit)


def _settled(
    z: list[FloatArray], r: list[FloatArray], added: FloatArray, z_noise: FloatArray, w: float, slope: FloatArray
) -> tuple[float, FloatArray]:
    """The bounds with w raised by the remaining violations, so that no pair contradicts them."""
    left = 0.0
    for one, values, noise in zip(z, r, added, strict=True):
        slack = 2.0 * (w + noise + float(slope @ z_noise))
        left = max(left, float(violations(one, values, np.argsort(values), slope, slack)[0].max(initial=0.0)))
    # Sums of p terms each way: what they lose is far below this.
    return (w + left / 2.0) * (1.0 + 1e-12), slope


@kernel
def violations(
    z: FloatArray, values: FloatArray, order: NDArray[np.intp], slope: FloatArray, slack: float
) -> tuple[FloatArray, NDArray[np.intp]]:
    """For each datum j the greatest ``values_j - values_k - slack - Σ_c slope_c |z_j - z_k|_c`` over all k, where it is
    positive (0 else), and that k; ``order`` (T,) sorts the values."""
    count, p = z.shape
    excess, other = np.zeros(count), np.zeros(count, dtype=np.intp)
    for j in range(count):
        for place in range(count):
            k = order[place]
            # What is left shrinks along the order and with every coordinate.
            left = values[j] - values[k] - slack
            if left <= excess[j]:
                break
            for c in range(p):
                left -= slope[c] * abs(z[j, c] - z[k, c])
                if left <= excess[j]:
                    break
            if left > excess[j]:
                excess[j], other[j] = left, k
    return excess, other


@kernel
def nearest(z: FloatArray, weight: FloatArray, asked: NDArray[np.intp]) -> NDArray[np.intp]:
    """For each datum of ``asked`` the other one (row of ``z`` (T, p)) of least ``Σ_c weight_c |difference|_c``."""
    count, p = z.shape
    found = np.zeros(len(asked), dtype=np.intp)
    for number in range(len(asked)):
        j = asked[number]
        least = np.inf
        for k in range(count):
            if k == j:
                continue
            size = 0.0
            for c in range(p):
                size += weight[c] * abs(z[j, c] - z[k, c])
                if size >= least:
                    break
            if size < least:
                least, found[number] = size, k
    return found
