"""The transitions of vehicles and their moments, kept from sample to sample, compiled.

The datum of place j of a window is the transition from the sample at j to the next one: regressors ``z`` (states of the
model, the input in force from then on, earlier inputs by lag) and target ``y`` (the next state; with ``increments`` the
change, positions in the vehicle's own frame). It counts if the two samples are linked, the lagged inputs are known and
belong to the same trajectory, and no sample is gated; it leaves when a sample that it was made of leaves the window.
Angles are continued along each trajectory, from their first value in [-π, π) on.

Moments ``Σ [1; z - c] [1; z - c; y - c]ᵀ`` are updated by the entering and the leaving datum, about a center c in the
middle of the data; they are summed anew now and then, and where so little is left of them that rounding would show.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.jit import kernel
from reach_server.numeric.types import BoolArray, FloatArray, IntArray

#: Moments are summed anew where less than this part of the greatest they were is left,
LEFT = 1e-6
#: or the mean is more than this many standard deviations away from the center.
OFF_CENTER = 1e3
#: unless it is within this, relative to one and the center.
CENTERED = 1e-12
#: Pivots of a correlation matrix below this leave the rank to be judged by its eigenvalues.
PIVOT = 1e-8
TURN = 2 * np.pi


class Samples(NamedTuple):
    """Ring buffers (V, S, ·) as in ``windows.Columns``, and ``appended`` (V,) how many there have ever been."""

    x: FloatArray
    u: FloatArray
    run: NDArray[np.int32]
    input_known: BoolArray
    gated: BoolArray
    appended: IntArray


class KernelSpec(NamedTuple):
    """How samples become data: ``free`` and ``angles``, indices of states among the regressors and of those that wrap;
    ``pose`` as in ``advance.Rules``; ``lags``; ``exact`` (p + n,) of which magnitudes are kept exactly."""

    free: IntArray
    angles: IntArray
    pose: tuple[int, int, int]
    lags: int
    exact: BoolArray


class StreamingMoments(NamedTuple):
    """Data of V vehicles, by slot, at S places of the window (and R more, of older data): ``z`` (V, p, S + R), ``y``
    (V, n, S + R), ``valid`` (V, S + R).

    ``newest`` (V, n): the newest state, its angles continued. ``taken`` (V,): samples taken in; ``data`` (V,): those at
    places of the window that count; ``since`` (V,): samples since the last fit. ``center`` (V, p + n), ``moments`` (V,
    1 + p, 1 + p + n), ``peak`` (V, p) greatest second moments since they were summed, ``age`` (V,) data since then. Of
    the model in use: ``low``, ``high`` (V, n), the hull of the residuals of all data, and bounds ``largest`` (V, p + n)
    of the magnitudes of regressors and targets.
    """

    z: FloatArray
    y: FloatArray
    valid: BoolArray
    newest: FloatArray
    taken: IntArray
    data: IntArray
    since: IntArray
    center: FloatArray
    moments: FloatArray
    peak: FloatArray
    age: IntArray
    low: FloatArray
    high: FloatArray
    largest: FloatArray


@kernel
def _wrapped(angle: float) -> float:
    return (angle + np.pi) % TURN - np.pi


@kernel
def forget(memory: StreamingMoments, slot: int, taken: int) -> None:
    """Forget the data in the window of one vehicle; go on after ``taken`` samples."""
    memory.valid[slot] = False
    memory.moments[slot] = 0.0
    memory.peak[slot] = 0.0
    memory.data[slot] = 0
    memory.taken[slot] = taken


@kernel
def _weigh(memory: StreamingMoments, slot: int, place: int, sign: float) -> None:
    """Add a datum to the moments, or take it away."""
    p, n = memory.z.shape[1], memory.y.shape[1]
    center, moments = memory.center[slot], memory.moments[slot]
    for a in range(1 + p):
        left = sign * (1.0 if a == 0 else memory.z[slot, a - 1, place] - center[a - 1])
        moments[a, 0] += left
        for b in range(p):
            moments[a, 1 + b] += left * (memory.z[slot, b, place] - center[b])
        for b in range(n):
            moments[a, 1 + p + b] += left * (memory.y[slot, b, place] - center[p + b])
    for c in range(p):
        memory.peak[slot, c] = max(memory.peak[slot, c], moments[1 + c, 1 + c])


@kernel
def sum_anew(memory: StreamingMoments, slot: int, size: int, room: FloatArray) -> None:
    """Moments from the data at the first ``size`` places, about their mean; ``room`` (1 + p + n, size)."""
    p = memory.z.shape[1]
    valid = memory.valid[slot]
    for j in range(size):
        room[0, j] = 1.0 if valid[j] else 0.0
    count = max(room[0].sum(), 1.0)
    for c in range(len(room) - 1):
        row = memory.z[slot, c] if c < p else memory.y[slot, c - p]
        total = 0.0
        for j in range(size):
            if valid[j]:
                total += row[j]
        memory.center[slot, c] = total / count
        for j in range(size):
            room[1 + c, j] = row[j] - memory.center[slot, c] if valid[j] else 0.0
    memory.moments[slot] = np.dot(room[: 1 + p], room.T)
    for c in range(p):
        memory.peak[slot, c] = memory.moments[slot, 1 + c, 1 + c]
    memory.age[slot] = 0


@kernel
def _complete(samples: Samples, slot: int, number: int, oldest: int, kind: KernelSpec) -> bool:
    """Whether the transition from sample ``number - 1`` to ``number`` counts, both in the window."""
    size = samples.run.shape[1]
    place, before = number % size, (number - 1) % size
    if number - 1 - kind.lags < oldest or samples.run[slot, place] < 1 + kind.lags:
        return False
    if samples.gated[slot, place] or samples.gated[slot, before]:
        return False
    known = True
    for lag in range(kind.lags + 1):
        known = known and samples.input_known[slot, (number - 1 - lag) % size]
    return known


@kernel
def _enter(
    samples: Samples, slot: int, number: int, state: FloatArray, kind: KernelSpec, memory: StreamingMoments
) -> None:
    """Write the datum of the transition to sample ``number``, with ``state`` (n,) the continued one there."""
    size, m, free = samples.run.shape[1], samples.u.shape[2], len(kind.free)
    place, old = (number - 1) % size, memory.newest[slot]
    for c in range(free):
        memory.z[slot, c, place] = old[kind.free[c]]
    for lag in range(kind.lags + 1):
        for i in range(m):
            memory.z[slot, free + lag * m + i, place] = samples.u[slot, (number - 1 - lag) % size, i]
    body = kind.pose[0] >= 0
    for i in range(len(state)):
        memory.y[slot, i, place] = state[i] - old[i] if body else state[i]
    if body:
        first, second, heading = kind.pose
        cos, sin = np.cos(old[heading]), np.sin(old[heading])
        x, y = memory.y[slot, first, place], memory.y[slot, second, place]
        memory.y[slot, first, place] = cos * x + sin * y
        memory.y[slot, second, place] = cos * y - sin * x
    memory.valid[slot, place] = True


@kernel
def _extend(memory: StreamingMoments, slot: int, place: int, matrix: FloatArray, kind: KernelSpec) -> bool:
    """Extend hull and magnitudes of a model by a datum; whether magnitudes grew."""
    p, n = memory.z.shape[1], memory.y.shape[1]
    grew = False
    for c in range(p + n):
        size = abs(memory.z[slot, c, place] if c < p else memory.y[slot, c - p, place])
        if size > memory.largest[slot, c]:
            # Those that only bound rounding are taken twice as large, so that they do not grow all the time.
            memory.largest[slot, c] = size if kind.exact[c] else 2.0 * size
            grew = True
    for i in range(n):
        residual = memory.y[slot, i, place] - matrix[i, 0]
        for c in range(p):
            residual -= matrix[i, 1 + c] * memory.z[slot, c, place]
        memory.low[slot, i] = min(memory.low[slot, i], residual)
        memory.high[slot, i] = max(memory.high[slot, i], residual)
    return grew


@kernel
def take_in(
    slots: IntArray,
    samples: Samples,
    kind: KernelSpec,
    memory: StreamingMoments,
    matrix: FloatArray,
    grew: BoolArray,
    left: FloatArray,
) -> int:
    """Take in what has come of some vehicles since the last time; ``grew`` (B,): magnitudes did. Data that leaves goes
    to ``left`` (K, 1 + p + n), slot first, as much as there is room for; how much is returned.

    ``matrix`` (V, n, 1 + p) of the models in use: their hulls and magnitudes are extended by the entering data, and so
    stay those of all data.
    """
    size, n, p = samples.run.shape[1], samples.x.shape[2], memory.z.shape[1]
    state, gone_data = np.empty(n), 0
    for b in range(len(slots)):
        slot = slots[b]
        count = samples.appended[slot]
        oldest = max(count - size, 0)
        if memory.taken[slot] < oldest or memory.taken[slot] > count:
            forget(memory, slot, oldest)
        for number in range(memory.taken[slot], count):
            place, before = number % size, (number - 1) % size
            linked = number > oldest and samples.run[slot, place] > 0
            state[:] = samples.x[slot, place]
            for i in kind.angles:
                if linked:
                    turn = _wrapped(samples.x[slot, place, i] - samples.x[slot, before, i])
                    state[i] = memory.newest[slot, i] + turn
                else:
                    state[i] = _wrapped(state[i])
            # What was made of the sample whose place this one takes.
            gone = number - size + kind.lags
            if gone >= 0 and memory.valid[slot, gone % size]:
                _weigh(memory, slot, gone % size, -1.0)
                memory.valid[slot, gone % size] = False
                memory.data[slot] -= 1
                if gone_data < len(left):
                    left[gone_data, 0] = slot
                    for c in range(p):
                        left[gone_data, 1 + c] = memory.z[slot, c, gone % size]
                    for i in range(n):
                        left[gone_data, 1 + p + i] = memory.y[slot, i, gone % size]
                    gone_data += 1
            if linked and _complete(samples, slot, number, oldest, kind):
                _enter(samples, slot, number, state, kind, memory)
                _weigh(memory, slot, before, 1.0)
                grew[b] = _extend(memory, slot, before, matrix[slot], kind) or grew[b]
                memory.data[slot] += 1
                memory.age[slot] += 1
            memory.newest[slot] = state
            memory.since[slot] += 1
        memory.taken[slot] = count
    return gone_data


@kernel
def covariances(
    slots: IntArray, memory: StreamingMoments, size: int, covariance: FloatArray, cross: FloatArray, means: FloatArray
) -> None:
    """Covariances of the regressors (B, p, p) and of these with the targets (B, p, n), and means (B, p + n)."""
    p, n = memory.z.shape[1], memory.y.shape[1]
    room = np.empty((1 + p + n, size))
    for b in range(len(slots)):
        slot = slots[b]
        moments = memory.moments[slot]
        stale = memory.age[slot] >= size
        for c in range(p):
            mean = moments[0, 1 + c] / moments[0, 0]
            variance = moments[1 + c, 1 + c] / moments[0, 0] - mean * mean
            level = 1.0 + abs(memory.center[slot, c])
            stale = stale or not mean * mean <= OFF_CENTER**2 * variance + (CENTERED * level) ** 2
            stale = stale or not variance * moments[0, 0] >= LEFT * memory.peak[slot, c]
        if stale:
            sum_anew(memory, slot, size, room)
        for c in range(p + n):
            means[b, c] = moments[0, 1 + c] / moments[0, 0]
        for a in range(p):
            for c in range(p):
                covariance[b, a, c] = moments[1 + a, 1 + c] / moments[0, 0] - means[b, a] * means[b, c]
            for i in range(n):
                cross[b, a, i] = moments[1 + a, 1 + p + i] / moments[0, 0] - means[b, a] * means[b, p + i]
        for c in range(p + n):
            means[b, c] += memory.center[slot, c]


@kernel
def solve_many(covariance: FloatArray, cross: FloatArray, means: FloatArray, matrix: FloatArray) -> BoolArray:
    """M (B, n, 1 + p) of least squares by Cholesky factors of the correlations; False (B,) where a pivot is so small
    that the rank is in doubt, there M is not written."""
    count, p, n = cross.shape
    factor, scale, right = np.empty((p, p)), np.empty(p), np.empty(p)
    certain = np.ones(count, np.bool_)
    for b in range(count):
        for c in range(p):
            scale[c] = np.sqrt(max(covariance[b, c, c], 0.0))
            if not scale[c] > 1e-12 * (1.0 + abs(means[b, c])):
                certain[b] = False
        for a in range(p if certain[b] else 0):
            for c in range(a + 1):
                value = covariance[b, a, c] / (scale[a] * scale[c])
                for k in range(c):
                    value -= factor[a, k] * factor[c, k]
                if c < a:
                    factor[a, c] = value / factor[c, c]
                elif value > PIVOT:
                    factor[a, a] = np.sqrt(value)
                else:
                    certain[b] = False
            if not certain[b]:
                break
        if not certain[b]:
            continue
        for i in range(n):
            for a in range(p):
                right[a] = cross[b, a, i] / scale[a]
                for k in range(a):
                    right[a] -= factor[a, k] * right[k]
                right[a] /= factor[a, a]
            for a in range(p - 1, -1, -1):
                for k in range(a + 1, p):
                    right[a] -= factor[k, a] * right[k]
                right[a] /= factor[a, a]
            constant = means[b, p + i]
            for c in range(p):
                matrix[b, i, 1 + c] = right[c] / scale[c]
                constant -= matrix[b, i, 1 + c] * means[b, c]
            matrix[b, i, 0] = constant
    return certain


@kernel
def bound_many(slots: IntArray, memory: StreamingMoments, matrix: FloatArray, kind: KernelSpec) -> None:
    """Hull of the residuals of all data under M (B, n, 1 + p), and magnitudes, of some vehicles anew."""
    p, n, size = memory.z.shape[1], memory.y.shape[1], memory.valid.shape[1]
    residual = np.empty(size)
    for b in range(len(slots)):
        slot = slots[b]
        valid = memory.valid[slot]
        for i in range(n):
            residual[:] = memory.y[slot, i]
            for c in range(p):
                row, slope = memory.z[slot, c], matrix[b, i, 1 + c]
                for j in range(size):
                    residual[j] -= slope * row[j]
            low, high = np.inf, -np.inf
            for j in range(size):
                # Comparisons that are seldom true; min() and max() mind NaN, one by one.
                if (residual[j] < low or residual[j] > high) and valid[j]:
                    low, high = min(low, residual[j]), max(high, residual[j])
            memory.low[slot, i], memory.high[slot, i] = low - matrix[b, i, 0], high - matrix[b, i, 0]
        for c in range(p + n):
            row = memory.z[slot, c] if c < p else memory.y[slot, c - p]
            largest = 0.0
            for j in range(size):
                if abs(row[j]) > largest and valid[j]:
                    largest = abs(row[j])
            memory.largest[slot, c] = largest if kind.exact[c] else 2.0 * largest
        memory.since[slot] = 0
