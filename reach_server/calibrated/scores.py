"""Compiled: the record of errors and scores of one vehicle, and the rank statistics of scores.

The margin of a step is the r-th smallest of its W known scores, ``r = ceil((W + 1) confidence)`` [VGS05, chapter 2],
so the ``W - r + 1``-th largest: it changes only with a score that is not below it, or when W does.
"""

import math

import numpy as np
from numpy.typing import NDArray

from reach_server.sets.arrays import Array
from reach_server.sets.compiled import compiled
from reach_server.windows import Ints

Codes = NDArray[np.uint16]
Scores = NDArray[np.float32]

#: Codes per factor of two, and the exponent of the least magnitude told from zero: 64 octaves in 16 bits.
PER_OCTAVE, LEAST_EXPONENT, LAST_CODE = 1023, -40, 65535


@compiled
def encoded(magnitude: float) -> int:
    """Code of the magnitude of an error, from 1 on, rounded up by less than 0.07 %."""
    if not magnitude < math.inf:
        return LAST_CODE
    if magnitude <= 2.0**LEAST_EXPONENT:
        return 1
    return min(math.ceil(PER_OCTAVE * (math.log2(magnitude) - LEAST_EXPONENT)) + 1, LAST_CODE)


@compiled
def decoded(code: int) -> float:
    """Magnitude of a code."""
    return float(2.0 ** ((code - 1) / PER_OCTAVE + LEAST_EXPONENT))


@compiled
def rank_from_top(known: int, confidence: float) -> int:
    """Which largest of ``known`` scores the margin is, 1 for the greatest of all; 0 where there are too few."""
    return max(known - math.ceil((known + 1) * confidence - 1e-9) + 1, 0)


@compiled
def kth_largest(values: Array | Scores, column: int, k: int) -> float:
    """The k-th largest (k >= 1) number of a column of ``values`` (S, K); those that are NaN are none."""
    top = np.full(k, -math.inf)  # ascending
    for row in range(len(values)):
        value = values[row, column]
        # NaN is not above anything.
        if value > top[0]:
            i = 1
            while i < k and top[i] < value:
                top[i - 1] = top[i]
                i += 1
            top[i - 1] = value
    return float(top[0])


@compiled
def rank_statistic(scores: Scores, known: int, kind: int, confidence: float) -> float:
    """Margin by the ``known`` scores (S, K) of a kind; infinite where there are too few."""
    wanted = rank_from_top(known, confidence)
    return kth_largest(scores, kind, wanted) if wanted > 0 else math.inf


@compiled
def write(scores: Scores, known: Ints, limits: Array, place: int, kind: int, score: float, confidence: float) -> None:
    """Put a score (NaN: none) in the place of another, and correct the rank statistic."""
    before, after = scores[place, kind], np.float32(score)
    had, has = not math.isnan(before), not math.isnan(after)
    if not had and not has:
        return
    scores[place, kind] = after
    rank = rank_from_top(known[kind], confidence)
    known[kind] += int(has) - int(had)
    touched = (had and before >= limits[kind]) or (has and after >= limits[kind])
    if touched or rank != rank_from_top(known[kind], confidence):
        limits[kind] = rank_statistic(scores, known[kind], kind, confidence)


@compiled
def renew_margins(limits: Array, ratio: Array, margin: Array) -> None:
    """Margins (N,) of all steps by the rank statistics ``limits`` (K,): each its own, or those of whole tubes."""
    steps = len(margin)
    for h in range(steps):
        margin[h] = limits[h] if len(limits) == steps else ratio[h] * limits[steps]


@compiled
def tube_score(scores: Scores, ratio: Array, number: int) -> float:
    """Greatest score, relative to the ratio (N,) of its step, of the tube that ends with a sample; NaN if one is
    unknown."""
    steps = len(ratio)
    greatest = 0.0
    for h in range(steps):
        score = scores[(number - steps + 1 + h) % len(scores), h]
        if math.isnan(score):
            return math.nan
        greatest = max(greatest, score / ratio[h])
    return greatest


@compiled
def score_of(error: Array, size: Array) -> float:
    """Greatest error (n) in units of its size; infinite where one is no number."""
    greatest = 0.0
    for i in range(len(error)):
        ratio = abs(error[i]) / size[i]
        if not ratio < math.inf:
            return math.inf
        greatest = max(greatest, ratio)
    return greatest
