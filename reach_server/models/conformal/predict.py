"""Compiled: predictions from the newest samples, and what later samples say about them."""

import math

import numpy as np

from reach_server.data.observed_range import ENOUGH, FAR, outside
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
from reach_server.models.conformal.held import Bounds, bounds_of, hold, hold_center
from reach_server.models.conformal.ridge import first_columns, increments_of, standardise
from reach_server.models.conformal.scale import LEAST_SIZE
from reach_server.models.conformal.score import encoded, renew_margins, score_of, tube_score, write
from reach_server.models.conformal.spec import FeatureSpec, Samples
from reach_server.models.conformal.state import Model, PendingPredictions, ScoreHistory
from reach_server.numeric.jit import kernel
from reach_server.numeric.types import BoolArray, FloatArray, IntArray

#: An error this many times beyond its box, followed by a miss the opposite way, comes from the sample between them.
GLITCH = 4.0


@kernel
def roll_out(x: FloatArray, d: FloatArray, terms: FeatureSpec, center: FloatArray) -> None:
    """Predicted states ``center`` (N, n) from state ``x`` (n) and increments ``d`` (N n,), each in the frame that the
    ones before lead to."""
    n = terms.n
    for h in range(terms.horizon):
        before = x if h == 0 else center[h - 1]
        for i in range(n):
            center[h, i] = before[i] + d[h * n + i]
        if terms.heading >= 0:
            c, s = math.cos(before[terms.heading]), math.sin(before[terms.heading])
            first, second = d[h * n + terms.first], d[h * n + terms.second]
            center[h, terms.first] = before[terms.first] + c * first - s * second
            center[h, terms.second] = before[terms.second] + s * first + c * second


@kernel
def error_in_frame(
    x: FloatArray,
    place: int,
    center: FloatArray,
    h: int,
    cosine: float,
    sine: float,
    terms: FeatureSpec,
    error: FloatArray,
) -> None:
    """Measured state at a place minus predicted state (N, n) of step ``h``, ``error`` (n): angles by the shorter way,
    positions in the frame whose heading has this cosine and sine."""
    for i in range(terms.n):
        error[i] = x[place, i] - center[h, i]
        if terms.angles >> i & 1:
            error[i] = turned(error[i])
    if terms.heading >= 0:
        first, second = error[terms.first], error[terms.second]
        error[terms.first] = cosine * first + sine * second
        error[terms.second] = cosine * second - sine * first


@kernel
def sizes_at(
    phi: FloatArray, shape: FloatArray, clip: FloatArray, terms: FeatureSpec, psi: FloatArray, size: FloatArray
) -> None:
    """Sizes ``a_ih = sqrt(B_ih ψ_h)`` of errors, ``size`` (N, n); the regressors ψ at most ``clip``."""
    for h in range(terms.horizon):
        if h == 0:
            size_regressors(phi, h, terms, psi)
        elif terms.planned:
            range_regressors(phi, h, terms, psi)
        for i in range(terms.n):
            size[h, i] = 0.0
        for q in range(terms.sizes):
            value = min(psi[q], clip[h, q])
            for i in range(terms.n):
                size[h, i] += value * shape[h, q, i]
        for i in range(terms.n):
            size[h, i] = math.sqrt(size[h, i])


@kernel
def known_now(samples: Samples, count: IntArray, slots: IntArray, terms: FeatureSpec, out: BoolArray) -> None:
    """Which vehicles (B,) have all that the features of their newest sample look back to."""
    for b in range(len(slots)):
        slot = slots[b]
        out[b] = count[slot] > 0 and complete(samples.run[slot], samples.known[slot], count[slot] - 1, terms)


@kernel
def forecast(
    samples: Samples,
    count: IntArray,
    slots: IntArray,
    plan: FloatArray,
    model: Model,
    record: ScoreHistory,
    waiting: PendingPredictions,
    terms: FeatureSpec,
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
    phi, z = np.empty(terms.total), np.empty(terms.total)
    low, high = np.empty((terms.horizon, terms.n)), np.empty((terms.horizon, terms.n))
    stated = np.empty(terms.n, dtype=np.bool_)
    d, psi, begin = np.empty(terms.horizon * terms.n), np.empty(terms.sizes), first_columns(terms)
    for b in range(len(slots)):
        slot = slots[b]
        number, x = count[slot] - 1, samples.x[slot]
        here = number % len(x)
        present(samples.t[slot], x, samples.u[slot], number, terms, phi)
        if terms.planned:
            ahead(x, number, plan[b], terms, phi)
        outside_data(phi, model, slot, owner, terms, unseen[b])
        standardise(phi, model.mean[slot], model.scale[slot], model.limit[slot], z)
        increments_of(z, model.matrix[slot], begin, d)
        roll_out(x[here], d, terms, center[b])
        sizes_at(phi, record.shape[slot], record.clip[slot], terms, psi, half[b])
        angle = x[here, terms.heading] if terms.heading >= 0 else 0.0
        bounds_of(bounds, b, x[here], record.fastest[slot], terms, low, high, stated)
        hold_center(x[here], angle, low, high, terms, center[b])
        if remember:
            row = number % terms.horizon
            waiting.number[slot, row] = number
            waiting.angle[slot, row] = angle
            waiting.center[slot, row] = center[b]
            waiting.size[slot, row] = half[b]
        for h in range(terms.horizon):
            for i in range(terms.n):
                half[b, h, i] *= record.margin[slot, _group_of(i, terms), h]
        hold(x[here], angle, low, high, stated, terms, center[b], half[b], held[b])
        _turn(angle, terms, half[b], generators[b])


@kernel
def _group_of(state: int, terms: FeatureSpec) -> int:
    """The group that a state belongs to."""
    return 0 if terms.groups == 1 or terms.planar >> state & 1 else 1


@kernel
def outside_data(
    phi: FloatArray, model: Model, slot: int, owner: IntArray, terms: FeatureSpec, unseen: BoolArray
) -> None:
    """Mark the states and inputs ``unseen`` (n + m,) of which what enters the model lies outside the data.

    Of states and inputs themselves, lagged and later ones included, their ranges say so (``seen``). Rates and products,
    which may have long tails, are outside if they are more than ``FAR`` units from the mean of the data and their
    square is more than that of all data together allows for: as if fewer than ``ENOUGH`` of them lay that far out."""
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
        plain = j < terms.at_increments or terms.at_inputs <= j < terms.at_products
        if j >= terms.base:
            plain = (j - terms.base) % terms.later < terms.m
        if plain and not terms.angles >> of & 1 and outside(phi[j], low[of], high[of]):
            unseen[of] = True


@kernel
def _turn(angle: float, terms: FeatureSpec, half: FloatArray, generators: FloatArray) -> None:
    """Turn boxes of half-widths ``half`` (N, n) to the world, ``generators`` (N, n, n)."""
    c, s = math.cos(angle), math.sin(angle)
    for h in range(terms.horizon):
        for i in range(terms.n):
            generators[h, i, i] = half[h, i]
        if terms.heading >= 0:
            first, second = terms.first, terms.second
            generators[h, first, first] = c * half[h, first]
            generators[h, second, first] = s * half[h, first]
            generators[h, first, second] = -s * half[h, second]
            generators[h, second, second] = c * half[h, second]


@kernel
def observe(
    samples: Samples,
    count: IntArray,
    slots: IntArray,
    record: ScoreHistory,
    waiting: PendingPredictions,
    terms: FeatureSpec,
    confidence: float,
    gate: IntArray,
) -> None:
    """Hold the new samples of vehicles (B,) against the predictions that wait for them; ``gate`` (B,) becomes the place
    of a sample found to be a glitch, else -1."""
    places = samples.t.shape[1]
    error = np.empty(terms.n)
    for b in range(len(slots)):
        slot = slots[b]
        gate[b] = -1
        if waiting.fitted[slot]:
            for number in range(max(waiting.seen[slot], count[slot] - places), count[slot]):
                _forget(record, slot, number % places, confidence)
                step_sizes(samples, slot, number, terms, error, record.fastest[slot])
                if _reveals_glitch(samples, slot, number, record, waiting, terms, error):
                    gate[b] = (number - 1) % places
                    _forget(record, slot, (number - 1) % places, confidence)
                    waiting.number[slot, (number - 1) % terms.horizon] = -1
                    waiting.glitches[slot] += 1
                _take_in(samples, slot, number, record, waiting, terms, confidence, error)
            renew_margins(record.known[slot], record.limits[slot], record.ratio[slot], record.margin[slot], confidence)
        waiting.seen[slot] = count[slot]


@kernel
def _forget(record: ScoreHistory, slot: int, place: int, confidence: float) -> None:
    """Remove the errors that the sample at a place showed."""
    _, groups, _, kinds = record.scores.shape
    for g in range(groups):
        scores, known, limits = record.scores[slot, g], record.known[slot, g], record.limits[slot, g]
        for kind in range(kinds):
            write(scores, known, limits, place, kind, math.nan, confidence, g, groups)
    record.codes[slot, place] = 0


@kernel
def _take_in(
    samples: Samples,
    slot: int,
    number: int,
    record: ScoreHistory,
    waiting: PendingPredictions,
    terms: FeatureSpec,
    confidence: float,
    error: FloatArray,
) -> None:
    """Score the predictions of a sample."""
    x, gated = samples.x[slot], samples.gated[slot]
    place = number % len(x)
    codes, (_, groups, _, kinds) = record.codes[slot], record.scores.shape
    made, angle = waiting.number[slot], waiting.angle[slot]
    steps = 0 if gated[place] else min(terms.horizon, samples.run[slot, place])
    for h in range(steps):
        row = (number - h - 1) % terms.horizon
        if made[row] != number - h - 1 or not clean(gated, number - h - 1, 0, terms):
            continue
        center, size = waiting.center[slot, row], waiting.size[slot, row]
        error_in_frame(x, place, center, h, math.cos(angle[row]), math.sin(angle[row]), terms, error)
        for i in range(terms.n):
            codes[place, h, i] = encoded(abs(error[i]))
        for g in range(groups):
            score = score_of(error, size[h], terms.planar, g, groups)
            scores, known, limits = record.scores[slot, g], record.known[slot, g], record.limits[slot, g]
            write(scores, known, limits, place, h, score, confidence, g, groups)
    if kinds > terms.horizon:
        for g in range(groups):
            scores, known, limits = record.scores[slot, g], record.known[slot, g], record.limits[slot, g]
            score = tube_score(scores, record.ratio[slot, g], number)
            write(scores, known, limits, place, terms.horizon, score, confidence, g, groups)


@kernel
def _reveals_glitch(
    samples: Samples,
    slot: int,
    number: int,
    record: ScoreHistory,
    waiting: PendingPredictions,
    terms: FeatureSpec,
    error: FloatArray,
) -> bool:
    """Whether the one-step error of a sample is a miss opposite to that of the one before, which was far outside; keeps
    it, in units of its box, for the next."""
    x, gated = samples.x[slot], samples.gated[slot]
    place, row = number % len(x), (number - 1) % terms.horizon
    made = waiting.number[slot, row] == number - 1 and samples.run[slot, place] > 0
    if not made or not clean(gated, number - 1, 1, terms):
        return False
    angle, last, far = waiting.angle[slot, row], waiting.last[slot], 0
    error_in_frame(x, place, waiting.center[slot, row], 0, math.cos(angle), math.sin(angle), terms, error)
    for i in range(terms.n):
        if abs(last[i]) > abs(last[far]):
            far = i
    before = last[far] if waiting.last_number[slot] == number - 1 else 0.0
    for i in range(terms.n):
        # The boxes of a vehicle that stands still may be points.
        margin = record.margin[slot, _group_of(i, terms), 0]
        last[i] = error[i] / max(margin * waiting.size[slot, row, 0, i], LEAST_SIZE)
    found = abs(before) > GLITCH and abs(last[far]) > 1.0 and last[far] * before < 0.0
    waiting.last_number[slot] = -1 if found else number
    return bool(found)
