"""Compiled: the record of errors and scores of one vehicle, and the rank statistics of scores.

The margin of a step is the r-th smallest of its W known scores, ``r = ceil((W + 1) confidence)`` [VGS05, chapter 2],
so the ``W - r + 1``-th largest: it changes only with a score that is not below it, or when W does. Where positions and
other states have scores of their own, the ``W - r + 1`` are divided between them.
"""

import math

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.jit import kernel
from reach_server.numeric.types import FloatArray, IntArray

Codes = NDArray[np.uint16]
Scores = NDArray[np.uint16]

#: Codes per factor of two, and the exponent of the least magnitude told from zero: 64 octaves in 16 bits.
PER_OCTAVE, LEAST_EXPONENT, LAST_CODE = 1023, -40, 65535
#: Codes of scores: 128 octaves, for a size may be nearly nothing.
SCORES_PER_OCTAVE, LEAST_SCORE = 511, -60
#: Of the scores that may lie beyond the margins, one in so many is left to the states that are no positions.
OTHERS_PART = 5
#: Sizes of whole tubes are at least this, or a score could not be measured in them.
LEAST_RATIO = 1e-12


@kernel
def encoded(magnitude: float) -> int:
    """Code of the magnitude of an error, from 1 on, rounded up by less than 0.07 %."""
    if not magnitude < math.inf:
        return LAST_CODE
    if magnitude <= 2.0**LEAST_EXPONENT:
        return 1
    return min(math.ceil(PER_OCTAVE * (math.log2(magnitude) - LEAST_EXPONENT)) + 1, LAST_CODE)


@kernel
def decoded(code: int) -> float:
    """Magnitude of a code."""
    return float(2.0 ** ((code - 1) / PER_OCTAVE + LEAST_EXPONENT))


@kernel
def encoded_score(score: float) -> int:
    """Code of a score, from 1 on, rounded up by less than 0.14 %; 0 for NaN, which stands for none."""
    if math.isnan(score):
        return 0
    if not score < math.inf:
        return LAST_CODE
    if score <= 2.0**LEAST_SCORE:
        return 1
    return min(math.ceil(SCORES_PER_OCTAVE * (math.log2(score) - LEAST_SCORE)) + 1, LAST_CODE)


@kernel
def decoded_score(code: int) -> float:
    """Score of a code; NaN for none."""
    if code == 0:
        return math.nan
    return float(2.0 ** ((code - 1) / SCORES_PER_OCTAVE + LEAST_SCORE)) if code < LAST_CODE else math.inf


@kernel
def rank_from_top(known: int, confidence: float) -> int:
    """Which largest of ``known`` scores the margin is, 1 for the greatest of all; 0 where there are too few."""
    return max(known - math.ceil((known + 1) * confidence - 1e-9) + 1, 0)


@kernel
def rank_of_group(known: int, confidence: float, group: int, groups: int) -> int:
    """Which largest of ``known`` scores the margin of a group is; the ranks of two groups add up to that of all, of
    which the others (group 1) get a fifth, at least one. 0 where there are too few; 1 and 1 stand for one rank that
    both share (``renew_margins``)."""
    rank = rank_from_top(known, confidence)
    if groups == 1 or rank < 2:
        return rank
    others = max(rank // OTHERS_PART, 1)
    return others if group == 1 else rank - others


@kernel
def kth_largest(values: FloatArray, column: int, k: int) -> float:
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


@kernel
def rank_statistic(scores: Scores, known: int, kind: int, confidence: float, group: int, groups: int) -> float:
    """Margin by the ``known`` scores (S, K) of a kind; infinite where there are too few."""
    wanted = rank_of_group(known, confidence, group, groups)
    if wanted == 0:
        return math.inf
    top = np.zeros(wanted, dtype=np.uint16)  # ascending
    for row in range(len(scores)):
        code = scores[row, kind]
        if code > top[0]:
            i = 1
            while i < wanted and top[i] < code:
                top[i - 1] = top[i]
                i += 1
            top[i - 1] = code
    return decoded_score(top[0])


@kernel
def write(
    scores: Scores, known: IntArray, limits: FloatArray, index: int, kind: int, score: float, confidence: float,
    group: int, groups: int,
) -> None:  # fmt: skip
    """Put a score (NaN: none) of a group in the place of another, and correct the rank statistic."""
    before, after = scores[index, kind], encoded_score(score)
    had, has = before > 0, after > 0
    if not had and not has:
        return
    scores[index, kind] = after
    rank = rank_of_group(known[kind], confidence, group, groups)
    known[kind] += int(has) - int(had)
    limit = limits[kind]
    touched = (had and decoded_score(before) >= limit) or (has and decoded_score(after) >= limit)
    if touched or rank != rank_of_group(known[kind], confidence, group, groups):
        limits[kind] = rank_statistic(scores, known[kind], kind, confidence, group, groups)


@kernel
def renew_margins(
    known: IntArray, limits: FloatArray, ratio: FloatArray, margin: FloatArray, confidence: float
) -> None:
    """Margins (G, N) of all steps by the rank statistics ``limits`` (G, K) of the ``known`` (G, K) scores: each its
    own, or those of whole tubes. Where one score only may lie beyond the margins it is one of either group, so both
    margins are the greater one: the greatest score of all."""
    groups, steps = margin.shape
    for g in range(groups):
        for h in range(steps):
            kind = h if limits.shape[1] == steps else steps
            limit = limits[g, kind]
            if groups == 2 and rank_from_top(known[g, kind], confidence) == 1:
                limit = max(limits[0, kind], limits[1, kind])
            margin[g, h] = limit if kind == h else ratio[g, h] * limit


@kernel
def tube_score(scores: Scores, ratio: FloatArray, number: int) -> float:
    """Greatest score, relative to the ratio (N,) of its step, of the tube that ends with a sample; NaN if one is
    unknown."""
    steps = len(ratio)
    greatest = 0.0
    for h in range(steps):
        score = decoded_score(scores[(number - steps + 1 + h) % len(scores), h])
        if math.isnan(score):
            return math.nan
        greatest = max(greatest, score / ratio[h])
    return greatest


@kernel
def score_of(error: FloatArray, size: FloatArray, planar: int, group: int, groups: int) -> float:
    """Greatest error (n) of a group in units of its size; infinite where one is no number. The bits of ``planar`` are
    the states of group 0."""
    greatest = 0.0
    for i in range(len(error)):
        if groups == 2 and (planar >> i & 1) == group:
            continue
        ratio = abs(error[i]) / size[i]
        if not ratio < math.inf:
            return math.inf
        greatest = max(greatest, ratio)
    return greatest
