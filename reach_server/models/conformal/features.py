"""Compiled: features of the horizon model, the increments that it predicts, and the regressors of the size of errors.

All functions work on the ring buffers of one vehicle. A sample is named by its number in the stream, counted from 0;
its index is that number modulo the size of the ring.
"""

import math

import numpy as np
from numpy.typing import NDArray

from reach_server.data.samples import SampleArrays
from reach_server.models.conformal.spec import FeatureSpec
from reach_server.numeric.jit import ONE, ZERO, kernel
from reach_server.numeric.types import BoolArray, FloatArray, IntArray

Runs = NDArray[np.int32]


@kernel
def turned(angle: float) -> float:
    """The angle wrapped to [-pi, pi)."""
    if -math.pi <= angle < math.pi:
        return angle
    return float((angle + math.pi) % (2 * math.pi) - math.pi)


@kernel
def increment(t: IntArray, x: FloatArray, before: int, spec: FeatureSpec, out: FloatArray, at: int) -> None:
    """Change from the sample at index ``before`` to the one after it, scaled to the nominal interval; positions in the
    frame of the earlier sample. Goes to ``out`` from ``at`` on."""
    after = before + 1 if before + 1 < len(t) else 0
    elapsed = t[after] - t[before]
    rate = spec.interval / elapsed if elapsed > 0 else 1.0
    for i in range(spec.n):
        change = x[after, i] - x[before, i]
        out[at + i] = rate * (turned(change) if spec.angles >> i & 1 else change)
    if spec.heading >= 0:
        c, s = math.cos(x[before, spec.heading]), math.sin(x[before, spec.heading])
        ahead, left = out[at + spec.first], out[at + spec.second]
        out[at + spec.first] = c * ahead + s * left
        out[at + spec.second] = c * left - s * ahead


@kernel
def present(t: IntArray, x: FloatArray, u: FloatArray, number: int, spec: FeatureSpec, out: FloatArray) -> None:
    """The columns of ``out`` (total,) that are known at a sample."""
    size = len(t)
    here = number % size
    out[0] = 1.0
    column = ONE
    for i in range(spec.n):
        if spec.free >> i & 1:
            if spec.angles >> i & 1:
                out[column] = math.cos(x[here, i])
                column += 1
                out[column] = math.sin(x[here, i])
            else:
                out[column] = x[here, i]
            column += 1
    per_second = 1e9 / spec.interval
    for lag in range(1, spec.increments + 1):
        increment(t, x, (number - lag) % size, spec, out, column)
        for i in range(column, column + spec.n):
            out[i] *= per_second
        column += spec.n
    for lag in range(spec.lags + 1):
        index = (number - lag) % size
        for i in range(spec.m):
            out[column] = u[index, i]
            column += 1
    if spec.speed < 0:
        return
    v = x[here, spec.speed]
    if spec.heading >= 0:
        r = out[spec.at_increments + spec.heading]
        out[column], out[column + 1] = v * r, v * v
        out[column + 2], out[column + 3] = v * v * r, v * r * r
        column += 4
    if spec.steering >= 0:
        for lag in range(spec.lags + 1):
            out[column] = v * out[spec.at_inputs + lag * spec.m + spec.steering]
            column += 1


@kernel
def ahead(x: FloatArray, number: int, plan: FloatArray, spec: FeatureSpec, out: FloatArray) -> None:
    """The columns of ``out`` (total,) that the later inputs ``plan`` (N - 1, m) fill."""
    column = spec.base
    for j in range(spec.horizon - 1):
        for i in range(spec.m):
            out[column] = plan[j, i]
            column += 1
        if spec.steering >= 0:
            out[column] = x[number % len(x), spec.speed] * plan[j, spec.steering]
            column += 1


@kernel
def recorded(t: IntArray, x: FloatArray, u: FloatArray, number: int, spec: FeatureSpec, out: FloatArray) -> None:
    """All columns ``out`` (total,) of a sample, the later inputs as they came."""
    present(t, x, u, number, spec, out)
    if not spec.planned:
        return
    column = spec.base
    for j in range(1, spec.horizon):
        index = (number + j) % len(t)
        for i in range(spec.m):
            out[column] = u[index, i]
            column += 1
        if spec.steering >= 0:
            out[column] = x[number % len(t), spec.speed] * u[index, spec.steering]
            column += 1


@kernel
def targets(t: IntArray, x: FloatArray, number: int, spec: FeatureSpec, out: FloatArray) -> None:
    """The N increments ``out`` (N n,) that follow a sample."""
    for h in range(spec.horizon):
        increment(t, x, (number + h) % len(t), spec, out, h * spec.n)


@kernel
def step_sizes(
    samples: SampleArrays, slot: int, number: int, spec: FeatureSpec, change: FloatArray, fastest: FloatArray
) -> None:
    """Raise ``fastest`` (n,) to the magnitudes of the change that led to a sample, if it follows one and neither is a
    glitch; for the positions of a pose the distance counts. ``change`` (n,) is a workspace."""
    t, x, gated = samples.t[slot], samples.x[slot], samples.gated[slot]
    index, before = number % len(t), (number - 1) % len(t)
    if number < 1 or samples.run[slot, index] < 1 or gated[index] or gated[before]:
        return
    increment(t, x, before, spec, change, ZERO)
    if spec.heading >= 0:
        change[spec.first] = change[spec.second] = math.hypot(change[spec.first], change[spec.second])
    for i in range(spec.n):
        fastest[i] = max(fastest[i], abs(change[i]))


@kernel
def complete(run: Runs, known: BoolArray, number: int, spec: FeatureSpec) -> bool:
    """Whether a sample has all that its features look back to."""
    size = len(run)
    if run[number % size] < spec.reach:
        return False
    for lag in range(spec.lags + 1):  # noqa: SIM110 - generators do not compile
        if not known[(number - lag) % size]:
            return False
    return True


@kernel
def usable(run: Runs, known: BoolArray, gated: BoolArray, number: int, spec: FeatureSpec) -> bool:
    """Whether a sample is a datum of the model: features complete, N samples follow it (with their inputs, if these
    enter), and no glitch is among those that the pose is taken from."""
    size, steps = len(run), spec.horizon
    if run[(number + steps) % size] < spec.reach + steps or not complete(run, known, number, spec):
        return False
    if spec.planned:
        for j in range(1, steps):
            if not known[(number + j) % size]:
                return False
    return clean(gated, number, steps, spec)


@kernel
def clean(gated: BoolArray, number: int, steps: int, spec: FeatureSpec) -> bool:
    """Whether no glitch is among the poses that the features of a sample look at and the ``steps`` after it."""
    for j in range(-spec.increments, steps + 1):  # noqa: SIM110 - generators do not compile
        if gated[(number + j) % len(gated)]:
            return False
    return True


@kernel
def size_regressors(phi: FloatArray, h: int, spec: FeatureSpec, out: FloatArray) -> None:
    """What the size of an error at step ``h`` (from 0) depends on, ``out`` (sizes,), all nonnegative:

    1, |v|, |r|, |v r|, range of each input over its lags (and over the later ones that are known), |v| range(steering),
    last change per second of each state of the model, and how much the increments of each state vary over the lags.
    """
    out[0] = 1.0
    column = ONE
    if spec.speed >= 0:
        out[1] = abs(_speed(phi, spec))
        column = 2
        if spec.heading >= 0:
            out[2] = abs(phi[spec.at_increments + spec.heading])
            out[3] = out[1] * out[2]
            column = 4
    range_regressors(phi, h, spec, out)
    column += spec.m + int(spec.steering >= 0)
    for i in range(spec.n):
        if spec.free >> i & 1:
            out[column] = abs(phi[spec.at_increments + i])
            column += 1
    for i in range(spec.n):
        varied = 0.0
        for lag in range(spec.increments - 1):
            at = spec.at_increments + lag * spec.n + i
            varied += abs(phi[at] - phi[at + spec.n])
        out[column + i] = varied


@kernel
def _speed(phi: FloatArray, spec: FeatureSpec) -> float:
    column = ONE
    for i in range(spec.speed):
        if spec.free >> i & 1:
            column += 1 + (spec.angles >> i & 1)
    return float(phi[column])


@kernel
def range_regressors(phi: FloatArray, h: int, spec: FeatureSpec, out: FloatArray) -> None:
    """The size regressors that grow from step to step: how far inputs vary from their oldest lags to the last that are
    known for step ``h``."""
    column = 1 + int(spec.speed >= 0) + 2 * int(spec.speed >= 0 and spec.heading >= 0)
    for i in range(spec.m):
        low = high = phi[spec.at_inputs + i]
        for lag in range(1, spec.lags + 1):
            u = phi[spec.at_inputs + lag * spec.m + i]
            low, high = min(low, u), max(high, u)
        if spec.planned:
            for j in range(h):
                u = phi[spec.base + j * spec.later + i]
                low, high = min(low, u), max(high, u)
        out[column + i] = high - low
    if spec.steering >= 0:
        out[column + spec.m] = out[1] * out[column + spec.steering]
