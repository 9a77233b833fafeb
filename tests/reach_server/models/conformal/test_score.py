"""Codes of errors, and rank statistics that are kept instead of computed."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reach_server.models.conformal import least_scores
from reach_server.models.conformal import score as scores
from tests.reach_server.ugly import moderate


@given(st.floats(2.0**-40, 2.0**23))
def test_codes_are_rounded_up_a_little(magnitude: float) -> None:
    back = scores.decoded(scores.encoded(magnitude))
    assert magnitude * (1 - 1e-12) <= back <= magnitude * 1.0007


@given(st.floats(1e-18, 1e20))
def test_codes_of_scores_are_rounded_up_a_little(score: float) -> None:
    back = scores.decoded_score(scores.encoded_score(score))
    assert score * (1 - 1e-12) <= back <= score * 1.0014


@pytest.mark.parametrize(("score", "back"), [(0.0, 2.0**-60), (math.inf, math.inf), (1e300, math.inf)])
def test_codes_of_extreme_scores(score: float, back: float) -> None:
    assert scores.decoded_score(scores.encoded_score(score)) == back
    assert scores.encoded_score(math.nan) == 0
    assert math.isnan(scores.decoded_score(0))


@pytest.mark.parametrize("magnitude", [0.0, 1e-30, 1e30, math.inf, math.nan])
def test_codes_of_extremes(magnitude: float) -> None:
    code = scores.encoded(magnitude)
    assert 1 <= code <= scores.LAST_CODE
    assert (code == 1) == (magnitude < 1)


@pytest.mark.parametrize("confidence", [0.6, 0.9, 0.95, 0.99])
def test_the_rank_is_the_conformal_one(confidence: float) -> None:
    for known in range(1200):
        wanted = math.ceil((known + 1) * confidence - 1e-9)
        top = scores.rank_from_top(known, confidence)
        assert top == (known - wanted + 1 if wanted <= known else 0)
        assert (top > 0) == (known >= least_scores(confidence))


@pytest.mark.parametrize("confidence", [0.6, 0.9, 0.95, 0.99])
def test_two_groups_share_the_ranks_of_one(confidence: float) -> None:
    """Each misses with a probability of at most rank/(W + 1), so both together with that of one rank."""
    for known in range(1200):
        whole = scores.rank_from_top(known, confidence)
        positions, others = (scores.rank_of_group(known, confidence, group, 2) for group in range(2))
        assert scores.rank_of_group(known, confidence, 0, 1) == whole
        if whole >= 2:
            assert positions + others == whole
            assert others == max(whole // 5, 1)
        else:
            assert positions == others == whole


def test_where_one_score_may_lie_beyond_both_groups_have_the_greatest_of_all() -> None:
    known, limits = np.full((2, 1), 150), np.array([[3.0], [7.0]])
    margin = np.empty((2, 1))
    scores.renew_margins(known, limits, np.ones((2, 1)), margin, 0.99)
    assert margin.tolist() == [[7.0], [7.0]]
    scores.renew_margins(known + 100, limits, np.ones((2, 1)), margin, 0.99)
    assert margin.tolist() == [[3.0], [7.0]]


@moderate
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.6, 0.9, 0.97]))
@pytest.mark.slow
def test_kept_rank_statistics_are_those_of_all_scores(seed: int, confidence: float) -> None:
    rng = np.random.default_rng(seed)
    indices, kinds = 60, 2
    record = np.zeros((indices, kinds), dtype=np.uint16)
    known, limits = np.zeros(kinds, dtype=np.int64), np.full(kinds, math.inf)
    for _ in range(400):
        index, kind = int(rng.integers(indices)), int(rng.integers(kinds))
        # Few values, so that many are equal.
        score = math.nan if rng.random() < 0.1 else float(rng.integers(12))
        scores.write(record, known, limits, index, kind, score, confidence, 0, 1)
        for which in range(kinds):
            there = np.sort([scores.decoded_score(code) for code in record[:, which].tolist() if code])
            rank = math.ceil((len(there) + 1) * confidence - 1e-9)
            assert known[which] == len(there)
            assert limits[which] == (there[rank - 1] if rank <= len(there) else math.inf)


def test_scores_of_tubes_are_those_of_their_steps() -> None:
    rng = np.random.default_rng(1)
    codes = rng.integers(20_000, 40_000, (20, 4)).astype(np.uint16)
    codes[7, 1] = 0
    record = np.vectorize(scores.decoded_score)(codes.astype(int))
    ratio = np.array([1.0, 2.0, 4.0])
    for number in range(3, 50):
        steps = [record[(number - 2 + h) % 20, h] / ratio[h] for h in range(3)]
        score = scores.tube_score(codes, ratio, number)
        assert math.isnan(score) if np.isnan(steps).any() else score == pytest.approx(max(steps))
