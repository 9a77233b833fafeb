"""Transitions of vehicles and their moments, updated with every sample, compiled.

The datum at index j of a window is the transition from the sample at j to the next one: regressors ``z`` (states of the
model, the input in force from then on, earlier inputs by lag) and target ``y`` (the next state; with ``increments`` the
change, positions in the vehicle's own frame). It counts if the two samples are linked, the lagged inputs are known and
belong to the same trajectory, and no sample is gated; it leaves when a sample that it was made of leaves the window.
Angles are continued along each trajectory, from their first value in [-π, π) on.

Moments ``Σ [1; z - c] [1; z - c; y - c]ᵀ`` are updated by the entering and the leaving datum, about a center c in the
middle of the data; they are recomputed now and then, and where so little is left of them that rounding would show.
"""

from typing import NamedTuple

import numpy as np

from reach_server.data.samples import SampleArrays
from reach_server.numeric.jit import kernel
from reach_server.numeric.types import BoolArray, FloatArray, IntArray

#: Moments are recomputed where less than this part of the greatest they were is left,
LEAST_REMAINING = 1e-6
#: or the mean is more than this many standard deviations away from the center.
OFF_CENTER = 1e3
#: unless it is within this, relative to one and the center.
CENTERED = 1e-12
TURN = 2 * np.pi


class KernelSpec(NamedTuple):
    """How samples become data: ``free`` and ``angles``, indices of states among the regressors and of those that wrap;
    ``pose`` as in ``step_kernel.StepSpec``; ``lags``; ``exact`` (p + n,), which magnitudes are kept exactly."""

    free: IntArray
    angles: IntArray
    pose: tuple[int, int, int]
    lags: int
    exact: BoolArray


class StreamingMoments(NamedTuple):
    """Data of V vehicles, by slot, at S indices of the window (and R more, of older data): ``z`` (V, p, S + R), ``y``
    (V, n, S + R), ``valid`` (V, S + R).

    ``newest`` (V, n): the newest state, its angles continued. ``processed`` (V,): samples processed; ``data`` (V,):
    data of the window; ``since_fit`` (V,): samples since the last fit. ``center`` (V, p + n), ``moments`` (V, 1 + p,
    1 + p + n), ``peak`` (V, p) greatest second moments since they were recomputed, ``age`` (V,) data since then. Of the
    model in use: ``low``, ``high`` (V, n), the hull of the residuals of all data, and bounds ``largest`` (V, p + n) of
    the magnitudes of regressors and targets.
    """

    z: FloatArray
    y: FloatArray
    valid: BoolArray
    newest: FloatArray
    processed: IntArray
    data: IntArray
    since_fit: IntArray
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
def forget(stream: StreamingMoments, slot: int, processed: int) -> None:
    """Forget the data in the window of one vehicle; go on after ``processed`` samples."""
    stream.valid[slot] = False
    stream.moments[slot] = 0.0
    stream.peak[slot] = 0.0
    stream.data[slot] = 0
    stream.processed[slot] = processed


@kernel
def _weigh(stream: StreamingMoments, slot: int, index: int, sign: float) -> None:
    """Add a datum to the moments (``sign`` 1), or remove it (-1)."""
    p, n = stream.z.shape[1], stream.y.shape[1]
    center, moments = stream.center[slot], stream.moments[slot]
    for a in range(1 + p):
        left = sign * (1.0 if a == 0 else stream.z[slot, a - 1, index] - center[a - 1])
        moments[a, 0] += left
        for b in range(p):
            moments[a, 1 + b] += left * (stream.z[slot, b, index] - center[b])
        for b in range(n):
            moments[a, 1 + p + b] += left * (stream.y[slot, b, index] - center[p + b])
    for c in range(p):
        stream.peak[slot, c] = max(stream.peak[slot, c], moments[1 + c, 1 + c])


@kernel
def sum_anew(stream: StreamingMoments, slot: int, size: int, workspace: FloatArray) -> None:
    """Recompute the moments from the data at the first ``size`` indices, about their mean; ``workspace`` (1 + p + n,
    size)."""
    p = stream.z.shape[1]
    valid = stream.valid[slot]
    for j in range(size):
        workspace[0, j] = 1.0 if valid[j] else 0.0
    count = max(workspace[0].sum(), 1.0)
    for c in range(len(workspace) - 1):
        row = stream.z[slot, c] if c < p else stream.y[slot, c - p]
        total = 0.0
        for j in range(size):
            if valid[j]:
                total += row[j]
        stream.center[slot, c] = total / count
        for j in range(size):
            workspace[1 + c, j] = row[j] - stream.center[slot, c] if valid[j] else 0.0
    stream.moments[slot] = np.dot(workspace[: 1 + p], workspace.T)
    for c in range(p):
        stream.peak[slot, c] = stream.moments[slot, 1 + c, 1 + c]
    stream.age[slot] = 0


@kernel
def _complete(samples: SampleArrays, slot: int, number: int, oldest: int, spec: KernelSpec) -> bool:
    """Whether the transition from sample ``number - 1`` to ``number`` counts, both in the window."""
    size = samples.run.shape[1]
    index, before = number % size, (number - 1) % size
    if number - 1 - spec.lags < oldest or samples.run[slot, index] < 1 + spec.lags:
        return False
    if samples.gated[slot, index] or samples.gated[slot, before]:
        return False
    known = True
    for lag in range(spec.lags + 1):
        known = known and samples.input_known[slot, (number - 1 - lag) % size]
    return known


@kernel
def _enter(
    samples: SampleArrays, slot: int, number: int, state: FloatArray, spec: KernelSpec, stream: StreamingMoments
) -> None:
    """Write the datum of the transition to sample ``number``, with ``state`` (n,) the continued one there."""
    size, m, free = samples.run.shape[1], samples.u.shape[2], len(spec.free)
    index, old = (number - 1) % size, stream.newest[slot]
    for c in range(free):
        stream.z[slot, c, index] = old[spec.free[c]]
    for lag in range(spec.lags + 1):
        for i in range(m):
            stream.z[slot, free + lag * m + i, index] = samples.u[slot, (number - 1 - lag) % size, i]
    body = spec.pose[0] >= 0
    for i in range(len(state)):
        stream.y[slot, i, index] = state[i] - old[i] if body else state[i]
    if body:
        first, second, heading = spec.pose
        cos, sin = np.cos(old[heading]), np.sin(old[heading])
        x, y = stream.y[slot, first, index], stream.y[slot, second, index]
        stream.y[slot, first, index] = cos * x + sin * y
        stream.y[slot, second, index] = cos * y - sin * x
    stream.valid[slot, index] = True


@kernel
def _extend(stream: StreamingMoments, slot: int, index: int, matrix: FloatArray, spec: KernelSpec) -> bool:
    """Extend hull and magnitudes of a model by a datum; whether magnitudes grew."""
    p, n = stream.z.shape[1], stream.y.shape[1]
    grew = False
    for c in range(p + n):
        size = abs(stream.z[slot, c, index] if c < p else stream.y[slot, c - p, index])
        if size > stream.largest[slot, c]:
            # Those that only bound rounding are taken twice as large, so that they do not grow all the time.
            stream.largest[slot, c] = size if spec.exact[c] else 2.0 * size
            grew = True
    for i in range(n):
        residual = stream.y[slot, i, index] - matrix[i, 0]
        for c in range(p):
            residual -= matrix[i, 1 + c] * stream.z[slot, c, index]
        stream.low[slot, i] = min(stream.low[slot, i], residual)
        stream.high[slot, i] = max(stream.high[slot, i], residual)
    return grew


@kernel
def update(
    slots: IntArray,
    samples: SampleArrays,
    appended: IntArray,
    spec: KernelSpec,
    stream: StreamingMoments,
    matrix: FloatArray,
    grew: BoolArray,
    evicted_data: FloatArray,
) -> int:
    """Update the data of some vehicles (B,) with their new samples; the number of data written to ``evicted_data``.

    ``appended`` (V,): samples so far, by slot.

    ``evicted_data`` (K, 1 + p + n): the data that leaves the window, slot first, as much as there is room for. ``grew``
    (B,) is set where magnitudes grew.

    ``matrix`` (V, n, 1 + p) of the models in use: their hulls and magnitudes are extended by the entering data, and so
    stay those of all data.
    """
    size, n, p = samples.run.shape[1], samples.x.shape[2], stream.z.shape[1]
    state, evicted_count = np.empty(n), 0
    for b in range(len(slots)):
        slot = slots[b]
        count = appended[slot]
        oldest = max(count - size, 0)
        if stream.processed[slot] < oldest or stream.processed[slot] > count:
            forget(stream, slot, oldest)
        for number in range(stream.processed[slot], count):
            index, before = number % size, (number - 1) % size
            linked = number > oldest and samples.run[slot, index] > 0
            state[:] = samples.x[slot, index]
            for i in spec.angles:
                if linked:
                    turn = _wrapped(samples.x[slot, index, i] - samples.x[slot, before, i])
                    state[i] = stream.newest[slot, i] + turn
                else:
                    state[i] = _wrapped(state[i])
            # The datum that the sample overwritten by this one was part of.
            evicted = number - size + spec.lags
            if evicted >= 0 and stream.valid[slot, evicted % size]:
                _weigh(stream, slot, evicted % size, -1.0)
                stream.valid[slot, evicted % size] = False
                stream.data[slot] -= 1
                if evicted_count < len(evicted_data):
                    evicted_data[evicted_count, 0] = slot
                    for c in range(p):
                        evicted_data[evicted_count, 1 + c] = stream.z[slot, c, evicted % size]
                    for i in range(n):
                        evicted_data[evicted_count, 1 + p + i] = stream.y[slot, i, evicted % size]
                    evicted_count += 1
            if linked and _complete(samples, slot, number, oldest, spec):
                _enter(samples, slot, number, state, spec, stream)
                _weigh(stream, slot, before, 1.0)
                grew[b] = _extend(stream, slot, before, matrix[slot], spec) or grew[b]
                stream.data[slot] += 1
                stream.age[slot] += 1
            stream.newest[slot] = state
            stream.since_fit[slot] += 1
        stream.processed[slot] = count
    return evicted_count


@kernel
def covariances(
    slots: IntArray, stream: StreamingMoments, size: int, covariance: FloatArray, cross: FloatArray, means: FloatArray
) -> None:
    """Covariances of the regressors (B, p, p) and of these with the targets (B, p, n), and means (B, p + n)."""
    p, n = stream.z.shape[1], stream.y.shape[1]
    workspace = np.empty((1 + p + n, size))
    for b in range(len(slots)):
        slot = slots[b]
        moments = stream.moments[slot]
        outdated = stream.age[slot] >= size
        for c in range(p):
            mean = moments[0, 1 + c] / moments[0, 0]
            variance = moments[1 + c, 1 + c] / moments[0, 0] - mean * mean
            level = 1.0 + abs(stream.center[slot, c])
            outdated = outdated or not mean * mean <= OFF_CENTER**2 * variance + (CENTERED * level) ** 2
            outdated = outdated or not variance * moments[0, 0] >= LEAST_REMAINING * stream.peak[slot, c]
        if outdated:
            sum_anew(stream, slot, size, workspace)
        for c in range(p + n):
            means[b, c] = moments[0, 1 + c] / moments[0, 0]
        for a in range(p):
            for c in range(p):
                covariance[b, a, c] = moments[1 + a, 1 + c] / moments[0, 0] - means[b, a] * means[b, c]
            for i in range(n):
                cross[b, a, i] = moments[1 + a, 1 + p + i] / moments[0, 0] - means[b, a] * means[b, p + i]
        for c in range(p + n):
            means[b, c] += stream.center[slot, c]


@kernel
def bound_many(slots: IntArray, stream: StreamingMoments, matrix: FloatArray, spec: KernelSpec) -> None:
    """Hull of the residuals of all data under M (B, n, 1 + p), and magnitudes, of some vehicles, from scratch."""
    p, n, size = stream.z.shape[1], stream.y.shape[1], stream.valid.shape[1]
    residual = np.empty(size)
    for b in range(len(slots)):
        slot = slots[b]
        valid = stream.valid[slot]
        for i in range(n):
            residual[:] = stream.y[slot, i]
            for c in range(p):
                row, slope = stream.z[slot, c], matrix[b, i, 1 + c]
                for j in range(size):
                    residual[j] -= slope * row[j]
            low, high = np.inf, -np.inf
            for j in range(size):
                # Comparisons that are seldom true; min() and max() mind NaN, one by one.
                if (residual[j] < low or residual[j] > high) and valid[j]:
                    low, high = min(low, residual[j]), max(high, residual[j])
            stream.low[slot, i], stream.high[slot, i] = low - matrix[b, i, 0], high - matrix[b, i, 0]
        for c in range(p + n):
            row = stream.z[slot, c] if c < p else stream.y[slot, c - p]
            largest = 0.0
            for j in range(size):
                if abs(row[j]) > largest and valid[j]:
                    largest = abs(row[j])
            stream.largest[slot, c] = largest if spec.exact[c] else 2.0 * largest
        stream.since_fit[slot] = 0
