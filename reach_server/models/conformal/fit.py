"""Compiled: the ridge model of a vehicle, fitted to all data of its window or updated with the data that enter and
leave."""

import math

import numpy as np

from reach_server.data.observed_range import LEAST_UNIT, range_of
from reach_server.data.samples import SampleArrays
from reach_server.models.conformal.features import increment, recorded, step_sizes, targets, usable
from reach_server.models.conformal.predict import error_in_frame, roll_out
from reach_server.models.conformal.ridge import BELIEVED, add, factor, first_columns, increments_of, solve, standardise
from reach_server.models.conformal.score import Codes, encoded
from reach_server.models.conformal.spec import FeatureSpec
from reach_server.models.conformal.state import Model, ScoreHistory
from reach_server.numeric.jit import kernel
from reach_server.numeric.types import BoolArray, FloatArray, IntArray

#: Contiguous parts of the data, each predicted by the model of the others: neighbours in time are alike.
FOLDS = 5
#: Ridges to choose from, ascending.
RIDGES = (1e-4, 1e-3, 1e-2, 1e-1)
#: The greatest ridge is taken whose out-of-fold errors exceed the least by no more than this part: it relies least on
#: directions in which the data say little [BFOS84].
AS_GOOD = 0.05
#: Units are renewed when the root mean square of a feature is more than this many of them: what did not vary when they
#: were taken does now, and a ridge in the units of before would hardly hold its coefficient.
OUTGROWN = 8.0
#: Places of the ring that data leave unused, so that those that leave can still be computed.
SPARE = 24


@kernel
def reach_back(count: int, indices: int, spec: FeatureSpec) -> int:
    """Number of the oldest sample that may be a datum, when ``count`` samples have come to a ring of ``indices``."""
    return int(max(0, count - indices + spec.reach + SPARE))


@kernel
def usable_numbers(samples: SampleArrays, count: int, slot: int, spec: FeatureSpec, out: IntArray) -> int:
    """Numbers ``out`` (S,) of the samples of a vehicle that are data; how many."""
    run, known, gated = samples.run[slot], samples.input_known[slot], samples.gated[slot]
    found = 0
    for number in range(reach_back(count, len(run), spec), count - spec.horizon):
        if usable(run, known, gated, number, spec):
            out[found] = number
            found += 1
    return found


@kernel
def count_usable(samples: SampleArrays, count: IntArray, slots: IntArray, spec: FeatureSpec, out: IntArray) -> None:
    """How many data vehicles (B,) have."""
    numbers = np.empty(samples.t.shape[1], dtype=np.int64)
    for b in range(len(slots)):
        out[b] = usable_numbers(samples, count[slots[b]], slots[b], spec, numbers)


@kernel
def carry_on(
    samples: SampleArrays, count: IntArray, slots: IntArray, model: Model, spec: FeatureSpec, outgrown: BoolArray
) -> None:
    """Update the sums of vehicles (B,) with the data that enter and leave, and solve again. What leaves must still be
    in the window, with all that its features look back to. ``outgrown`` (B,): whether the data spread far beyond the
    units of features."""
    lower, begins = np.empty((spec.total, spec.total)), first_columns(spec)
    z, y = np.empty(spec.total), np.empty(spec.horizon * spec.n)
    for b in range(len(slots)):
        slot = slots[b]
        t, x, u = samples.t[slot], samples.x[slot], samples.u[slot]
        run, known, gated = samples.run[slot], samples.input_known[slot], samples.gated[slot]
        mean, scale, limit = model.mean[slot], model.scale[slot], model.limit[slot]
        begin, end = reach_back(count[slot], len(t), spec), count[slot] - spec.horizon
        first, last, previous = model.oldest[slot], model.newest[slot], -2
        for k in range(max(end - last, 0) + max(begin - first, 0)):
            enters = k < end - last
            number = last + k if enters else first + k - max(end - last, 0)
            if not usable(run, known, gated, number, spec):
                continue
            recorded(t, x, u, number, spec, z)
            if enters:
                _believe(z, mean, scale, limit)
            standardise(z, mean, scale, limit, z)
            if number == previous + 1:
                # All but the last increment are those of the datum before.
                y[: -spec.n] = y[spec.n :]
                increment(t, x, (number + spec.horizon - 1) % len(t), spec, y, len(y) - spec.n)
            else:
                targets(t, x, number, spec, y)
            previous = number
            add(z, y, 1.0 if enters else -1.0, model.gram[slot], model.cross[slot])
            model.data[slot] += 1 if enters else -1
        model.newest[slot], model.oldest[slot] = max(end, last), max(begin, first)
        _solve(model, slot, begins, lower)
        _ranges(samples, count[slot], slot, model, spec)
        outgrown[b] = False
        for j in range(spec.total):
            outgrown[b] |= model.gram[slot, j, j] > OUTGROWN**2 * max(model.data[slot], 1)


@kernel
def _believe(phi: FloatArray, mean: FloatArray, scale: FloatArray, limit: FloatArray) -> None:
    """Widen the limits (F,) of features by a datum: so no datum is ever cut off, neither when it enters nor when it
    leaves."""
    for j in range(len(phi)):
        limit[j] = max(limit[j], BELIEVED * abs(phi[j] - mean[j]) / scale[j])


@kernel
def _solve(model: Model, slot: int, begins: IntArray, lower: FloatArray) -> None:
    factor(model.gram[slot], model.ridge[slot], lower)
    solve(lower, model.cross[slot], begins, model.matrix[slot])


@kernel
def fit(
    samples: SampleArrays,
    count: IntArray,
    slots: IntArray,
    fill: BoolArray,
    model: Model,
    record: ScoreHistory,
    spec: FeatureSpec,
) -> None:
    """Models of vehicles (B,) from all data of their windows. Where ``fill`` (B,) says so the ridge is chosen by
    out-of-fold errors, and these enter the record of errors where nothing better is known."""
    indices = samples.t.shape[1]
    numbers = np.empty(indices, dtype=np.int64)
    phi, targeted = np.empty((indices, spec.total)), np.empty((indices, spec.horizon * spec.n))
    change = np.empty(spec.n)
    lower, begins = np.empty((spec.total, spec.total)), first_columns(spec)
    for b in range(len(slots)):
        slot = slots[b]
        t, x, u = samples.t[slot], samples.x[slot], samples.u[slot]
        rows = usable_numbers(samples, count[slot], slot, spec, numbers)
        z, y = phi[:rows], targeted[:rows]
        for k in range(rows):
            recorded(t, x, u, numbers[k], spec, z[k])
            targets(t, x, numbers[k], spec, y[k])
        record.fastest[slot] = 0.0
        for number in range(max(1, count[slot] - indices + 1), count[slot]):
            step_sizes(samples, slot, number, spec, change, record.fastest[slot])
        mean, scale, limit = model.mean[slot], model.scale[slot], model.limit[slot]
        _units_of(z, mean, scale, limit)
        model.gram[slot], model.cross[slot] = 0.0, 0.0
        for k in range(rows):
            standardise(z[k], mean, scale, limit, z[k])
            add(z[k], y[k], 1.0, model.gram[slot], model.cross[slot])
        model.data[slot] = rows
        model.oldest[slot], model.newest[slot] = reach_back(count[slot], indices, spec), count[slot] - spec.horizon
        _ranges(samples, count[slot], slot, model, spec)
        if fill[b]:
            errors = _out_of_fold(x, numbers[:rows], z, y, model.gram[slot], model.cross[slot], spec)
            choice = _best(errors)
            model.ridge[slot] = RIDGES[choice]
            _complete(record.codes[slot], numbers[:rows], errors[choice], spec)
        _solve(model, slot, begins, lower)


@kernel
def _ranges(samples: SampleArrays, count: int, slot: int, model: Model, spec: FeatureSpec) -> None:
    """The ranges of the states and inputs of a vehicle, of what enters the model: samples that N others follow."""
    x, u, gated = samples.x[slot], samples.u[slot], samples.gated[slot]
    indices = len(x)
    used = np.zeros(indices, dtype=np.bool_)
    begin, end = max(0, count - indices), count - spec.horizon
    for number in range(begin, end):
        used[number % indices] = not gated[number % indices]
    for i in range(spec.n):
        model.low[slot, i], model.high[slot, i] = range_of(x[:, i], used)
    for number in range(begin, end):
        used[number % indices] = samples.input_known[slot, number % indices]
    for i in range(spec.m):
        model.low[slot, spec.n + i], model.high[slot, spec.n + i] = range_of(u[:, i], used)


@kernel
def _units_of(phi: FloatArray, mean: FloatArray, scale: FloatArray, limit: FloatArray) -> None:
    """Mean, unit and limit (F,) of features (rows, F). The unit is the spread, at least half the one before (``scale``,
    0 where there was none): what has varied may do so again. The first feature, the constant, stays as it is."""
    rows = len(phi)
    mean[0], scale[0], limit[0] = 0.0, 1.0, 1.0
    for j in range(1, phi.shape[1]):
        total = square = far = 0.0
        for k in range(rows):
            total += phi[k, j]
        mean[j] = total / rows
        for k in range(rows):
            deviation = phi[k, j] - mean[j]
            square += deviation * deviation
            far = max(far, abs(deviation))
        scale[j] = max(math.sqrt(square / rows), 0.5 * scale[j], LEAST_UNIT * (1.0 + abs(mean[j])))
        limit[j] = BELIEVED * far / scale[j]


@kernel
def _out_of_fold(
    x: FloatArray,
    numbers: IntArray,
    z: FloatArray,
    y: FloatArray,
    whole: FloatArray,
    right: FloatArray,
    spec: FeatureSpec,
) -> FloatArray:
    """Errors (choices, rows, N n) of every datum by the model of the other folds, for every ridge; ``whole`` and
    ``right`` are the sums over all data."""
    rows, columns = y.shape
    errors = np.empty((len(RIDGES), rows, columns))
    lower, matrix, begins = np.empty_like(whole), np.empty_like(right), first_columns(spec)
    d, center, error = np.empty(columns), np.empty((spec.horizon, spec.n)), np.empty(spec.n)
    for fold in range(FOLDS):
        begin, end = fold * rows // FOLDS, (fold + 1) * rows // FOLDS
        gram, cross = whole.copy(), right.copy()
        for k in range(begin, end):
            add(z[k], y[k], -1.0, gram, cross)
        for choice in range(len(RIDGES)):
            factor(gram, RIDGES[choice], lower)
            solve(lower, cross, begins, matrix)
            for k in range(begin, end):
                number = numbers[k]
                here = number % len(x)
                increments_of(z[k], matrix, begins, d)
                roll_out(x[here], d, spec, center)
                angle = x[here, spec.heading] if spec.heading >= 0 else 0.0
                c, s = math.cos(angle), math.sin(angle)
                for h in range(spec.horizon):
                    error_in_frame(x, (number + h + 1) % len(x), center, h, c, s, spec, error)
                    for i in range(spec.n):
                        errors[choice, k, h * spec.n + i] = error[i]
    return errors


@kernel
def _complete(codes: Codes, numbers: IntArray, errors: FloatArray, spec: FeatureSpec) -> None:
    """Record errors (rows, N n) where none is known."""
    for k in range(len(numbers)):
        for h in range(spec.horizon):
            index = (numbers[k] + h + 1) % len(codes)
            if codes[index, h, 0] == 0:
                for i in range(spec.n):
                    codes[index, h, i] = encoded(abs(errors[k, h * spec.n + i]))


@kernel
def _best(errors: FloatArray) -> int:
    """Which ridge (choices, rows, columns) is taken, by the geometric mean over columns of the mean error."""
    choices, rows, columns = errors.shape
    mean = np.zeros(choices)
    for choice in range(choices):
        for c in range(columns):
            total = 0.0
            for k in range(rows):
                total += abs(errors[choice, k, c])
            mean[choice] += math.log(max(total / rows, 1e-300)) / columns
    chosen = 0
    for choice in range(choices):
        if mean[choice] <= mean.min() + math.log1p(AS_GOOD):
            chosen = choice
    return chosen
