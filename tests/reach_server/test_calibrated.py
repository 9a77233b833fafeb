"""Calibrated sets: the rank statistic is the one stated, and the rate that it promises is met."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet_bus.messages import parse_profile
from reach_server import calibrated
from reach_server.regression import Layout
from reach_server.rows import take
from reach_server.windows import Block, Floats, SampleBatch, Window
from tests.reach_server.drives import PROFILE, START, SVEA, history, samples_of
from tests.reach_server.ugly import moderate


@moderate
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.6, 0.9, 0.95]))
def test_boxes_are_scaled_by_the_order_statistic(seed: int, confidence: float) -> None:
    rng = np.random.default_rng(seed)
    size, horizon, n = 80, 3, 2
    errors = rng.standard_t(3, size=(2, size, horizon, n)) * [1.0, 1e-3]
    usable = rng.random((2, size)) < 0.8
    half, count = calibrated._boxes(errors, usable, confidence)
    np.testing.assert_array_equal(count, usable.sum(axis=1))
    for v in range(2):
        known = np.abs(errors[v][usable[v]])
        total = len(known)
        rank = math.ceil((total + 1) * confidence - 1e-9)
        for h in range(horizon):
            shape = half[v, h] / half[v, h].max()
            scores = np.sort((known[:, h] / shape).max(axis=1))
            # The box is the least one of its shape that holds ``rank`` of the errors.
            assert half[v, h].max() == pytest.approx(scores[rank - 1])
            assert (known[:, h] <= half[v, h] * (1 + 1e-12)).all(axis=1).sum() >= rank


@pytest.mark.parametrize("confidence", [0.9, 0.95, 0.99])
def test_too_few_scores_give_no_box(confidence: float) -> None:
    least = calibrated.least_scores(confidence)
    errors = np.random.default_rng(0).normal(size=(1, least + 5, 1, 2))
    for count, finite in ((least, True), (least - 1, False)):
        half, _ = calibrated._boxes(errors, (np.arange(least + 5) < count)[None], confidence)
        assert bool(np.isfinite(half).all()) is finite


def test_folds_are_contiguous_and_balanced() -> None:
    usable = np.random.default_rng(0).random((1, 103)) < 0.7
    fold = calibrated._folds(usable)[0]
    np.testing.assert_array_equal(fold >= 0, usable[0])
    numbers = fold[usable[0]]
    assert (np.diff(numbers) >= 0).all()
    counts = np.bincount(numbers, minlength=calibrated.FOLDS)
    assert counts.max() - counts.min() <= 1


AR = parse_profile(
    {
        "class": "ar", "state": {"a": "m", "b": "m"}, "inputs": {"u": "m"}, "sample_time": 0.1, "input_lags": 1,
        "window": 140, "future_inputs": "learned", "confidence": 0.9, "horizon": 3,
    }
)  # fmt: skip


def stationary(vehicles: int, samples: int, seed: int) -> tuple[Floats, Floats]:
    """States (V, T, 2) of a stationary process with heavy tails and inputs that matter."""
    rng = np.random.default_rng(seed)
    x, u = np.zeros((vehicles, samples, 2)), rng.normal(size=(vehicles, samples, 1))
    w = 0.1 * rng.standard_t(4, size=x.shape)
    for k in range(1, samples):
        x[:, k] = x[:, k - 1] @ np.array([[0.8, 0.1], [-0.2, 0.7]]).T + 0.3 * u[:, k - 1] + w[:, k]
    return x, u


def whole_block(x: Floats, u: Floats) -> Block:
    vehicles, samples = x.shape[:2]
    yes = np.ones((vehicles, samples), dtype=bool)
    t = np.broadcast_to(START + AR.sample_time_ns * np.arange(samples), yes.shape)
    linked = np.broadcast_to(np.arange(samples) > 0, yes.shape)
    return Block(t, x, u, yes, yes, linked)


def test_the_promised_rate_is_met_out_of_sample() -> None:
    vehicles, window, horizon = 400, 140, 3
    x, u = stationary(vehicles, window + horizon, seed=1)
    layout = Layout.of(AR)
    block = whole_block(x[:, :window], u[:, :window])
    fitted = calibrated.fit(block, AR, layout, horizon, planned=False)
    center, generators, known = calibrated.predict(fitted, block, AR, layout, None)
    assert known.all()
    half = np.abs(generators).sum(axis=-1)
    inside = (np.abs(x[:, window:] - center) <= half).all(axis=-1).mean(axis=0)
    # 400 independent vehicles: a standard deviation of 0.015.
    assert (inside > 0.86).all()
    assert (inside < 0.97).all()


def test_later_inputs_that_are_known_make_sets_smaller_and_keep_the_rate() -> None:
    vehicles, window, horizon = 300, 140, 3
    x, u = stationary(vehicles, window + horizon, seed=2)
    layout = Layout.of(AR)
    block = whole_block(x[:, :window], u[:, :window])
    sizes = []
    for planned in (False, True):
        fitted = calibrated.fit(block, AR, layout, horizon, planned=planned)
        plan = u[:, window : window + horizon - 1] if planned else None
        center, generators, _ = calibrated.predict(fitted, block, AR, layout, plan)
        half = np.abs(generators).sum(axis=-1)
        inside = (np.abs(x[:, window:] - center) <= half).all(axis=-1).mean(axis=0)
        assert (inside > 0.85).all()
        sizes.append(np.median(half[:, -1].prod(axis=-1)))
    assert sizes[1] < 0.7 * sizes[0]


def test_equal_data_gives_equal_sets_whatever_else_is_in_the_batch() -> None:
    x, u = stationary(4, 140, seed=3)
    x[3], u[3] = x[1], u[1]
    layout = Layout.of(AR)

    def sets(order: list[int]) -> tuple[Floats, Floats]:
        block = whole_block(x[order], u[order])
        fitted = calibrated.fit(block, AR, layout, 3, planned=False)
        center, generators, _ = calibrated.predict(fitted, block, AR, layout, None)
        return center, generators

    center, generators = sets([0, 1, 2, 3])
    np.testing.assert_array_equal(center[1], center[3])
    np.testing.assert_array_equal(generators[1], generators[3])
    for order in ([3, 2, 1, 0], [1], [2, 1]):
        other_center, other_generators = sets(order)
        row = order.index(1)
        np.testing.assert_allclose(other_center[row], center[1], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(other_generators[row], generators[1], rtol=1e-9, atol=1e-12)


def test_padding_and_gaps_do_not_count() -> None:
    x, u = stationary(1, 160, seed=4)
    short = whole_block(x[:, 20:], u[:, 20:])
    long = whole_block(x, u)
    rows = np.arange(160) >= 20
    junk = np.where(rows[:, None], 0.0, 1e3)
    padded = Block(
        long.t, long.x + junk, long.u + junk[:, :1], long.valid & rows, long.input_known & rows,
        long.linked & (np.arange(160) > 20),
    )  # fmt: skip
    layout = Layout.of(AR)
    one, other = (calibrated.fit(b, AR, layout, 3, planned=False) for b in (short, padded))
    np.testing.assert_array_equal(one.scores, other.scores)
    np.testing.assert_allclose(one.half, other.half, rtol=1e-9)
    np.testing.assert_allclose(one.matrix, other.matrix, rtol=1e-6, atol=1e-9)


def test_sets_of_a_car_turn_with_it() -> None:
    """The same drive, turned and moved, gives the same sets, turned and moved."""
    profile = PROFILE.model_copy(update={"window": 300, "confidence": 0.95})
    layout = Layout.of(profile)
    drive = history(5)
    batch = samples_of(drive, 0, 400)
    angle, shift = 2.3, np.array([10.0, -4.0])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = batch.x.copy()
    moved[:, :2] = batch.x[:, :2] @ turn.T + shift
    moved[:, 2] = np.mod(batch.x[:, 2] + angle + np.pi, 2 * np.pi) - np.pi
    results = []
    for x in (batch.x, moved):
        window = Window(profile)
        window.grow(1)
        window.append(SampleBatch(batch.vehicle, batch.epoch, batch.seq, batch.t, batch.flags, x, batch.u))
        block = window.block(np.array([0]))
        fitted = calibrated.fit(block, profile, layout, 5, planned=False)
        results.append(calibrated.predict(fitted, block, profile, layout, None))
    (center, generators, _), (moved_center, moved_generators, _) = results
    np.testing.assert_allclose(moved_center[..., :2], center[..., :2] @ turn.T + shift, atol=1e-6)
    np.testing.assert_allclose(moved_center[..., 3], center[..., 3], atol=1e-6)
    for h in range(5):
        G = generators[0, h].copy()
        G[:2] = turn @ G[:2]
        np.testing.assert_allclose(moved_generators[0, h], G, atol=1e-6)


def test_the_newest_sample_after_a_break_is_not_known() -> None:
    x, u = stationary(1, 140, seed=5)
    layout = Layout.of(AR)
    block = whole_block(x, u)
    fitted = calibrated.fit(block, AR, layout, 3, planned=False)
    broken = block.linked.copy()
    broken[:, -1] = False
    known = calibrated.predict(
        fitted, Block(block.t, block.x, block.u, block.valid, block.input_known, broken), AR, layout, None
    )[2]
    assert not known.any()
    assert take(fitted, np.array([0])).half.shape == (1, 3, 2)


def test_increments_of_uneven_intervals_are_brought_to_the_nominal_one() -> None:
    block = whole_block(*stationary(1, 10, seed=6))
    t = block.t.copy()
    t[0, 5:] += AR.sample_time_ns // 10
    rate = calibrated._rate(Block(t, block.x, block.u, block.valid, block.input_known, block.linked), AR)
    np.testing.assert_allclose(rate[0], [1.0] * 4 + [1 / 1.1] + [1.0] * 5)
    assert SVEA.dt > 0
