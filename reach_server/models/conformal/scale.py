"""Compiled: how large errors are expected to be, from the errors that are known.

    a_ih = q_ih sqrt(σ_ih B_ih ψ) ,  σ = mean |E| ,  B >= 0 by nonnegative least squares of |E| on ψ, constant >= 0.2 σ

with ψ at most its 99 % quantile. The square root lies half-way between sizes that are constant and sizes that follow
ψ: what few data say about ψ is half believed. The factor q balances the states: it makes the a_ih quantiles of |E_ih|,
for positions at the confidence itself, for the others at one where they miss a quarter as often: published areas are
those of positions, and rare large errors of a speed should not enlarge them.

Any B >= 0 gives sets that are calibrated for errors to come: their margin is a rank statistic of scores. The errors on
record are scored by sizes fitted to other parts of the record, for those fitted to themselves would be too small.
"""

import math

import numpy as np

from reach_server.data.samples import SampleArrays
from reach_server.models.conformal.features import clean, complete, recorded, size_regressors
from reach_server.models.conformal.score import (
    LEAST_RATIO,
    Scores,
    decoded,
    encoded_score,
    kth_largest,
    rank_statistic,
    renew_margins,
    score_of,
    tube_score,
)
from reach_server.models.conformal.spec import FeatureSpec
from reach_server.models.conformal.state import ScoreHistory
from reach_server.numeric.jit import ZERO, kernel
from reach_server.numeric.types import BoolArray, FloatArray, IntArray

#: Least part of the mean error that the constant term explains.
CONSTANT_PART = 0.2
#: Quantile at which regressors of size are cut off.
CLIPPED = 0.99
#: States that are no positions miss this part as often as these.
OTHERS_MISS = 0.25
#: A part of the errors counts as no smaller than this part of all of them: of a vehicle that stood still for most of
#: the record, a state that a sensor says exactly would have no size in which to measure what came later.
FOLD_PART = 0.1
#: Least factor that balances states; it is about 1 or more unless nearly all errors are far below their mean.
LEAST_BALANCE = 0.5
#: Sizes below this are none.
LEAST_SIZE = 1e-12
#: Contiguous parts of the errors, each scored by sizes that were fitted to the others.
FOLDS = 3
#: Sweeps of the descent, and the relative change at which it ends early.
SWEEPS, SETTLED = 200, 1e-6


@kernel
def nonnegative(gram: FloatArray, right: FloatArray, lower: FloatArray, solution: FloatArray) -> None:
    """Least squares with ``solution >= lower`` from ``gram`` = ΨᵀΨ (Q, Q) and ``right`` = Ψᵀy by coordinate descent,
    which decreases the sum of squares with every step [LT92]. The first column must not be zero: it says what counts as
    a change."""
    size = len(right)
    slope = right.copy()
    for q in range(size):
        solution[q] = lower[q]
        for p in range(size):
            slope[p] -= gram[p, q] * solution[q]
    least = SETTLED * abs(right[0]) / math.sqrt(gram[0, 0])
    for _ in range(SWEEPS):
        moved = 0.0
        for q in range(size):
            if gram[q, q] <= 0.0:
                continue
            change = max(slope[q] / gram[q, q], lower[q] - solution[q])
            if change != 0.0:
                solution[q] += change
                moved = max(moved, abs(change) * math.sqrt(gram[q, q]))
                for p in range(size):
                    slope[p] -= gram[q, p] * change
        if moved <= least:
            return


@kernel
def _quantile(values: FloatArray, column: int, part: float) -> float:
    """The ``ceil(part rows)``-th smallest of a column of ``values`` (rows, K)."""
    rows = len(values)
    return kth_largest(values, column, rows - min(max(math.ceil(part * rows - 1e-9), 1), rows) + 1)


@kernel
def resize(
    samples: SampleArrays,
    count: IntArray,
    slots: IntArray,
    record: ScoreHistory,
    spec: FeatureSpec,
    plane: BoolArray,
    confidence: float,
) -> None:
    """Fit the sizes of vehicles (B,) to the errors on record, and score these anew; ``plane`` (n,) marks positions."""
    indices, n = samples.t.shape[1], spec.n
    origin, row = np.empty(indices, dtype=np.int64), np.empty(indices, dtype=np.int64)
    phi, psi = np.empty((indices, spec.total)), np.empty((indices, spec.sizes))
    magnitude, score = np.empty((indices, n)), np.empty((indices, spec.groups))
    scored = np.empty((spec.groups, indices, spec.horizon))
    for slot in slots:
        rows = _origins(samples, count[slot], slot, spec, origin, phi)
        scored[:] = np.nan
        for h in range(spec.horizon):
            known = 0
            for k in range(rows):
                codes = record.codes[slot, (origin[k] + h + 1) % indices, h]
                if origin[k] + h + 1 < count[slot] and codes[0] > 0:
                    size_regressors(phi[k], h, spec, psi[known])
                    for i in range(n):
                        magnitude[known, i] = decoded(codes[i])
                    row[known] = k
                    known += 1
            if known < FOLDS:
                record.clip[slot, h], record.shape[slot, h] = math.inf, LEAST_SIZE**2
                continue
            _clip(psi[:known], record.clip[slot, h])
            _fit_step(
                psi[:known], magnitude[:known], plane, spec.planar, confidence, record.shape[slot, h], score[:known]
            )
            for k in range(known):
                for g in range(spec.groups):
                    scored[g, (origin[row[k]] + h + 1) % indices, h] = score[k, g]
        for g in range(spec.groups):
            _record(
                scored[g], count[slot], record.scores[slot, g], record.known[slot, g], record.limits[slot, g],
                record.ratio[slot, g], confidence, g, spec.groups,
            )  # fmt: skip
        renew_margins(record.known[slot], record.limits[slot], record.ratio[slot], record.margin[slot], confidence)


@kernel
def _origins(samples: SampleArrays, count: int, slot: int, spec: FeatureSpec, origin: IntArray, phi: FloatArray) -> int:
    """Numbers ``origin`` (S,) and features ``phi`` (S, total) of the samples whose features can still be computed; how
    many."""
    t, x, u = samples.t[slot], samples.x[slot], samples.u[slot]
    run, known, gated = samples.run[slot], samples.input_known[slot], samples.gated[slot]
    found = 0
    for number in range(max(0, count - len(t) + spec.reach), count - 1):
        if complete(run, known, number, spec) and clean(gated, number, ZERO, spec):
            recorded(t, x, u, number, spec, phi[found])
            origin[found] = number
            found += 1
    return found


@kernel
def _clip(psi: FloatArray, clip: FloatArray) -> None:
    """Cut regressors (rows, Q) off at a quantile of theirs, ``clip`` (Q,)."""
    for q in range(len(clip)):
        clip[q] = _quantile(psi, q, CLIPPED)
        for k in range(len(psi)):
            psi[k, q] = min(psi[k, q], clip[q])


@kernel
def _fit_step(
    psi: FloatArray,
    magnitude: FloatArray,
    plane: BoolArray,
    planar: int,
    confidence: float,
    shape: FloatArray,
    score: FloatArray,
) -> None:
    """Coefficients ``shape`` (Q, n) of the squared sizes at one step from all its errors (rows, n), and the ``score``
    (rows, G) of each group by the coefficients from the other folds."""
    rows, sizes, n = len(psi), psi.shape[1], magnitude.shape[1]
    least = np.empty(n)
    for i in range(n):
        total = 0.0
        for k in range(rows):
            total += magnitude[k, i]
        least[i] = max(FOLD_PART * total / rows, LEAST_SIZE)
    gram, right, size = np.empty((sizes, sizes)), np.empty((n, sizes)), np.empty(n)
    # Once without each fold, at last with all.
    for fold in range(FOLDS + 1):
        begin = min(fold * rows // FOLDS, rows)
        end = min((fold + 1) * rows // FOLDS, rows)
        gram[:] = 0.0
        right[:] = 0.0
        _add(psi, magnitude, ZERO, begin, gram, right)
        _add(psi, magnitude, end, rows, gram, right)
        _shape(psi, magnitude, begin, end, gram, right, least, plane, confidence, shape)
        for k in range(begin, end):
            for i in range(n):
                total = 0.0
                for q in range(sizes):
                    total += psi[k, q] * shape[q, i]
                size[i] = math.sqrt(total)
            for g in range(score.shape[1]):
                score[k, g] = score_of(magnitude[k], size, planar, g, score.shape[1])


@kernel
def _add(psi: FloatArray, magnitude: FloatArray, begin: int, end: int, gram: FloatArray, right: FloatArray) -> None:
    """Add rows to ΨᵀΨ (Q, Q) and to the sums (n, Q) of errors times regressors."""
    sizes = psi.shape[1]
    for k in range(begin, end):
        for q in range(sizes):
            a = psi[k, q]
            for p in range(sizes):
                gram[q, p] += a * psi[k, p]
        for i in range(len(right)):
            a = magnitude[k, i]
            for q in range(sizes):
                right[i, q] += a * psi[k, q]


@kernel
def _shape(
    psi: FloatArray,
    magnitude: FloatArray,
    begin: int,
    end: int,
    gram: FloatArray,
    right: FloatArray,
    least: FloatArray,
    plane: BoolArray,
    confidence: float,
    shape: FloatArray,
) -> None:
    """Coefficients ``shape`` (Q, n) from the rows outside ``begin`` to ``end``, whose sums are ``gram`` (Q, Q) and
    ``right`` (n, Q); mean errors count as ``least`` (n,) at least."""
    rows, sizes = psi.shape
    kept = rows - (end - begin)
    lower, solution, ratio = np.zeros(sizes), np.empty(sizes), np.empty((kept, 1))
    for i in range(magnitude.shape[1]):
        # The first regressor is 1: its sums are the number of rows and the sum of errors.
        mean = max(right[i, 0] / kept, least[i])
        lower[0] = CONSTANT_PART * mean
        nonnegative(gram, right[i], lower, solution)
        for j in range(kept):
            k = j if j < begin else j + end - begin
            size = 0.0
            for q in range(sizes):
                size += solution[q] * psi[k, q]
            ratio[j, 0] = magnitude[k, i] / math.sqrt(mean * size)
        missing = (1.0 - confidence) * (1.0 if plane[i] else OTHERS_MISS)
        balance = max(_quantile(ratio, ZERO, 1.0 - missing), LEAST_BALANCE)
        for q in range(sizes):
            shape[q, i] = balance**2 * mean * solution[q]


@kernel
def _record(
    scored: FloatArray,
    count: int,
    scores: Scores,
    known: IntArray,
    limits: FloatArray,
    ratio: FloatArray,
    confidence: float,
    group: int,
    groups: int,
) -> None:
    """Put scores (S, N), NaN where not known, in the place of all others, with the limits that follow from them."""
    indices, steps = scored.shape
    known[:] = 0
    for index in range(indices):
        for h in range(steps):
            scores[index, h] = encoded_score(scored[index, h])
            known[h] += int(not math.isnan(scored[index, h]))
    for h in range(steps):
        limits[h] = rank_statistic(scores, known[h], h, confidence, group, groups)
        ratio[h] = max(limits[h], LEAST_RATIO) if limits[h] < math.inf else 1.0
    if len(limits) > steps:
        scores[:, steps] = 0
        for number in range(max(steps, count - indices + steps), count):
            score = tube_score(scores, ratio, number)
            scores[number % indices, steps] = encoded_score(score)
            known[steps] += int(not math.isnan(score))
        limits[steps] = rank_statistic(scores, int(known[steps]), steps, confidence, group, groups)
