"""Compiled: predictions from the newest samples, and their scores once later samples have come."""

import math

import numpy as np

from reach_server.data.observed_range import ENOUGH, FAR, outside
from reach_server.data.samples import SampleArrays
from reach_server.models.conformal.features import (
    ahead,
    clean,
    complete,
    present,
    range_regressors,
    size_regressors,
    step_sizes,
    turned,
)
from reach_server.models.conformal.limited import Bounds, bounds_of, hold, hold_center
from reach_server.models.conformal.ridge import first_columns, increments_of, standardise
from reach_server.models.conformal.scale import LEAST_SIZE
from reach_server.models.conformal.score import encoded, renew_margins, score_of, tube_score, write
from reach_server.models.conformal.spec import FeatureSpec
from reach_server.models.conformal.state import Model, PendingPredictions, ScoreHistory
from reach_server.numeric.jit import ONE, ZERO, kernel
from reach_server.numeric.types import BoolArray, FloatArray, IntArray

#: An error this many times beyond its box, followed by a miss the opposite way, comes from the sample between them.
GLITCH = 4.0


@kernel
def roll_out(x: FloatArray, d: FloatArray, spec: FeatureSpec, center: FloatArray) -> None:
    """Predicted states ``center`` (N, n) from state ``x`` (n) and increments ``d`` (N n,), each in the frame that the
    ones before lead to."""
    n = spec.n
    for h in range(spec.horizon):
        before = x if h == 0 else center[h - 1]
        for i in range(n):
            center[h, i] = before[i] + d[h * n + i]
        if spec.heading >= 0:
            c, s = math.cos(before[spec.heading]), math.sin(before[spec.heading])
            first, second = d[h * n + spec.first], d[h * n + spec.second]
            center[h, spec.first] = before[spec.first] + c * first - s * second
            center[h, spec.second] = before[spec.second] + s * first + c * second


@kernel
def error_in_frame(
    x: FloatArray,
    index: int,
    center: FloatArray,
    h: int,
    cosine: float,
    sine: float,
    spec: FeatureSpec,
    error: FloatArray,
) -> None:
    """Measured state at an index minus predicted state (N, n) of step ``h``, ``error`` (n): angles by the shorter way,
    positions in the frame whose heading has this cosine and sine."""
    for i in range(spec.n):
        error[i] = x[index, i] - center[h, i]
        if spec.angles >> i & 1:
            error[i] = turned(error[i])
    if spec.heading >= 0:
        first, second = error[spec.first], error[spec.second]
        error[spec.first] = cosine * first + sine * second
        error[spec.second] = cosine * second - sine * first


@kernel
def sizes_at(
    phi: FloatArray, shape: FloatArray, clip: FloatArray, spec: FeatureSpec, psi: FloatArray, size: FloatArray
) -> None:
    """Sizes ``a_ih = sqrt(B_ih ψ_h)`` of errors, ``size`` (N, n); the regressors ψ at most ``clip``."""
    for h in range(spec.horizon):
        if h == 0:
            size_regressors(phi, h, spec, psi)
        elif spec.planned:
            range_regressors(phi, h, spec, psi)
        for i in range(spec.n):
            size[h, i] = 0.0
        for q in range(spec.sizes):
            value = min(psi[q], clip[h, q])
            for i in range(spec.n):
                size[h, i] += value * shape[h, q, i]
        for i in range(spec.n):
            size[h, i] = math.sqrt(size[h, i])


@kernel
def known_now(samples: SampleArrays, count: IntArray, slots: IntArray, spec: FeatureSpec, out: BoolArray) -> None:
    """Which vehicles (B,) have all that the features of their newest sample look back to."""
    for b in range(len(slots)):
        slot = slots[b]
        out[b] = count[slot] > 0 and complete(samples.run[slot], samples.input_known[slot], count[slot] - 1, spec)


@kernel
def forecast(
    samples: SampleArrays,
    count: IntArray,
    slots: IntArray,
    plan: FloatArray,
    model: Model,
    record: ScoreHistory,
    pending: PendingPredictions,
    spec: FeatureSpec,
    remember: bool,
    bounds: Bounds,
    owner: IntArray,
    center: FloatArray,
    half: FloatArray,
    generators: FloatArray,
    unseen: BoolArray,
    held: BoolArray,
) -> None:
    """Boxes of vehicles (B,): ``center`` (B, N, n), ``half`` (B, N, n) along the frame of the newest sample, and
    ``generators`` (B, N, n, n), zero before, within ``bounds``.

    ``unseen`` (B, n + m) becomes true of the states and inputs of which a feature lies where the window has too few
    data; ``owner`` (total,) names the state (from 0) or input (from n) of each feature, -1 for none. ``held`` (B, 2):
    whether a box was cut by stated bounds, and by observed ones.
    """
    phi, z = np.empty(spec.total), np.empty(spec.total)
    low, high = np.empty((spec.horizon, spec.n)), np.empty((spec.horizon, spec.n))
    stated = np.empty(spec.n, dtype=np.bool_)
    d, psi, begin = np.empty(spec.horizon * spec.n), np.empty(spec.sizes), first_columns(spec)
    for b in range(len(slots)):
        slot = slots[b]
        number, x = count[slot] - 1, samples.x[slot]
        here = number % len(x)
        present(samples.t[slot], x, samples.u[slot], number, spec, phi)
        if spec.planned:
            ahead(x, number, plan[b], spec, phi)
        outside_data(phi, model, slot, owner, spec, unseen[b])
        standardise(phi, model.mean[slot], model.scale[slot], model.limit[slot], z)
        increments_of(z, model.matrix[slot], begin, d)
        roll_out(x[here], d, spec, center[b])
        sizes_at(phi, record.shape[slot], record.clip[slot], spec, psi, half[b])
        angle = x[here, spec.heading] if spec.heading >= 0 else 0.0
        bounds_of(bounds, b, x[here], record.fastest[slot], spec, low, high, stated)
        hold_center(x[here], angle, low, high, spec, center[b])
        if remember:
            row = number % spec.horizon
            pending.number[slot, row] = number
            pending.angle[slot, row] = angle
            pending.center[slot, row] = center[b]
            pending.size[slot, row] = half[b]
        for h in range(spec.horizon):
            for i in range(spec.n):
                half[b, h, i] *= record.margin[slot, _group_of(i, spec), h]
        hold(x[here], angle, low, high, stated, spec, center[b], half[b], held[b])
        _turn(angle, spec, half[b], generators[b])


@kernel
def _group_of(state: int, spec: FeatureSpec) -> int:
    """The group that a state belongs to."""
    return 0 if spec.groups == 1 or spec.planar >> state & 1 else 1


@kernel
def outside_data(
    phi: FloatArray, model: Model, slot: int, owner: IntArray, spec: FeatureSpec, unseen: BoolArray
) -> None:
    """Mark the states and inputs ``unseen`` (n + m,) of which what enters the model lies outside the data.

    Of states and inputs themselves, lagged and later ones included, their ranges say so (``observed_range``). Rates and
    products, which may have long tails, are outside if they are more than ``FAR`` units from the mean of the data and
    their square is more than that of all data together allows for: as if fewer than ``ENOUGH`` of them lay that far
    out."""
    mean, scale, gram, low, high = (
        model.mean[slot],
        model.scale[slot],
        model.gram[slot],
        model.low[slot],
        model.high[slot],
    )
    for j in range(1, len(phi)):
        of = owner[j]
        z = abs(phi[j] - mean[j]) / scale[j]
        # Written so that what is no number is unseen, too.
        if not z <= FAR and not ENOUGH * z * z <= gram[j, j]:
            unseen[of] = True
        plain = j < spec.at_increments or spec.at_inputs <= j < spec.at_products
        if j >= spec.base:
            plain = (j - spec.base) % spec.later < spec.m
        if plain and not spec.angles >> of & 1 and outside(phi[j], low[of], high[of]):
            unseen[of] = True


@kernel
def _turn(angle: float, spec: FeatureSpec, half: FloatArray, generators: FloatArray) -> None:
    """Turn boxes of half-widths ``half`` (N, n) to the world, ``generators`` (N, n, n)."""
    c, s = math.cos(angle), math.sin(angle)
    for h in range(spec.horizon):
        for i in range(spec.n):
            generators[h, i, i] = half[h, i]
        if spec.heading >= 0:
            first, second = spec.first, spec.second
            generators[h, first, first] = c * half[h, first]
            generators[h, second, first] = s * half[h, first]
            generators[h, first, second] = -s * half[h, second]
            generators[h, second, second] = c * half[h, second]


@kernel
def observe(
    samples: SampleArrays,
    count: IntArray,
    slots: IntArray,
    record: ScoreHistory,
    pending: PendingPredictions,
    spec: FeatureSpec,
    confidence: float,
    gate: IntArray,
) -> None:
    """Score the pending predictions of vehicles (B,) by their new samples; ``gate`` (B,) becomes the index of a sample
    found to be a glitch, else -1."""
    indices = samples.t.shape[1]
    error = np.empty(spec.n)
    for b in range(len(slots)):
        slot = slots[b]
        gate[b] = -1
        if pending.fitted[slot]:
            for number in range(max(pending.seen[slot], count[slot] - indices), count[slot]):
                _forget(record, slot, number % indices, confidence)
                step_sizes(samples, slot, number, spec, error, record.fastest[slot])
                if _reveals_glitch(samples, slot, number, record, pending, spec, error):
                    gate[b] = (number - 1) % indices
                    _forget(record, slot, (number - 1) % indices, confidence)
                    pending.number[slot, (number - 1) % spec.horizon] = -1
                    pending.glitches[slot] += 1
                _update_scores(samples, slot, number, record, pending, spec, confidence, error)
            renew_margins(record.known[slot], record.limits[slot], record.ratio[slot], record.margin[slot], confidence)
        pending.seen[slot] = count[slot]


@kernel
def _forget(record: ScoreHistory, slot: int, index: int, confidence: float) -> None:
    """Remove the errors that the sample at an index showed."""
    _, groups, _, kinds = record.scores.shape
    for g in range(groups):
        scores, known, limits = record.scores[slot, g], record.known[slot, g], record.limits[slot, g]
        for kind in range(kinds):
            write(scores, known, limits, index, kind, math.nan, confidence, g, groups)
    record.codes[slot, index] = 0


@kernel
def _update_scores(
    samples: SampleArrays,
    slot: int,
    number: int,
    record: ScoreHistory,
    pending: PendingPredictions,
    spec: FeatureSpec,
    confidence: float,
    error: FloatArray,
) -> None:
    """Score the predictions of a sample."""
    x, gated = samples.x[slot], samples.gated[slot]
    index = number % len(x)
    codes, (_, groups, _, kinds) = record.codes[slot], record.scores.shape
    made, angle = pending.number[slot], pending.angle[slot]
    steps = 0 if gated[index] else min(spec.horizon, samples.run[slot, index])
    for h in range(steps):
        row = (number - h - 1) % spec.horizon
        if made[row] != number - h - 1 or not clean(gated, number - h - 1, ZERO, spec):
            continue
        center, size = pending.center[slot, row], pending.size[slot, row]
        error_in_frame(x, index, center, h, math.cos(angle[row]), math.sin(angle[row]), spec, error)
        for i in range(spec.n):
            codes[index, h, i] = encoded(abs(error[i]))
        for g in range(groups):
            score = score_of(error, size[h], spec.planar, g, groups)
            scores, known, limits = record.scores[slot, g], record.known[slot, g], record.limits[slot, g]
            write(scores, known, limits, index, h, score, confidence, g, groups)
    if kinds > spec.horizon:
        for g in range(groups):
            scores, known, limits = record.scores[slot, g], record.known[slot, g], record.limits[slot, g]
            score = tube_score(scores, record.ratio[slot, g], number)
            write(scores, known, limits, index, spec.horizon, score, confidence, g, groups)


@kernel
def _reveals_glitch(
    samples: SampleArrays,
    slot: int,
    number: int,
    record: ScoreHistory,
    pending: PendingPredictions,
    spec: FeatureSpec,
    error: FloatArray,
) -> bool:
    """Whether the one-step error of a sample is a miss opposite to that of the one before, which was far outside; keeps
    it, in units of its box, for the next."""
    x, gated = samples.x[slot], samples.gated[slot]
    index, row = number % len(x), (number - 1) % spec.horizon
    made = pending.number[slot, row] == number - 1 and samples.run[slot, index] > 0
    if not made or not clean(gated, number - 1, ONE, spec):
        return False
    angle, last, far = pending.angle[slot, row], pending.last[slot], 0
    error_in_frame(x, index, pending.center[slot, row], ZERO, math.cos(angle), math.sin(angle), spec, error)
    for i in range(spec.n):
        if abs(last[i]) > abs(last[far]):
            far = i
    before = last[far] if pending.last_number[slot] == number - 1 else 0.0
    for i in range(spec.n):
        # The boxes of a vehicle that stands still may be points.
        margin = record.margin[slot, _group_of(i, spec), 0]
        last[i] = error[i] / max(margin * pending.size[slot, row, 0, i], LEAST_SIZE)
    found = abs(before) > GLITCH and abs(last[far]) > 1.0 and last[far] * before < 0.0
    pending.last_number[slot] = -1 if found else number
    return bool(found)
