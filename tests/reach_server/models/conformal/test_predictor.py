"""Calibrated sets in a stream: what is predicted, how it is scored, what must not change it."""

import math
from fractions import Fraction

import numpy as np
import pytest

from fleet_bus.errors import UsageError
from fleet_bus.messages import VehicleProfile
from reach_server.data.regressors import RegressorSpec
from reach_server.data.window import Window
from reach_server.models.conformal import Boxes, ConformalPredictor
from reach_server.models.conformal.predictor import LEAST_BEYOND, least_window, scores_beyond
from reach_server.models.conformal.score import encoded_score, rank_from_top, rank_statistic
from reach_server.numeric.slot_table import take_rows
from reach_server.numeric.types import FloatArray
from tests.reach_server.models.conformal.streams import (
    CAR,
    PLAIN,
    Stream,
    batch_of,
    drive,
    rotated,
    shorter,
    slow_center,
    slow_features,
    slow_sizes,
    stationary,
)

#: Of the states of ``CAR``, which are no positions: these have margins of their own.
OTHERS = np.array([0, 0, 1, 1])


def boxes_of(stream: Stream, plan: FloatArray | None = None) -> Boxes:
    assert stream.models.ready(stream.slots).all()
    assert stream.models.known(stream.slots).all()
    return stream.models.predict(stream.slots, plan)


@pytest.mark.parametrize("planned", [False, True])
def test_sets_are_what_the_formulas_say(planned: bool) -> None:
    stream = Stream(CAR, planned=planned)
    spec, model, record = stream.spec, stream.models._model, stream.models._record
    x, u = drive(420, 1)
    batch = batch_of(x, u, CAR)
    stream.take(batch.take(np.arange(400)))
    k = 399
    found = boxes_of(stream, u[None, k + 1 : k + spec.horizon])
    t = batch.t
    phi = slow_features(t, x, u, k, spec)
    z = np.clip((phi - model.mean[0]) / model.scale[0], -model.limit[0], model.limit[0])
    center = slow_center(x[k], (z @ model.matrix[0]).reshape(spec.horizon, spec.n), spec)
    np.testing.assert_allclose(found.center[0], center, rtol=1e-9, atol=1e-9)
    for h in range(spec.horizon):
        psi = np.minimum(slow_sizes(t, x, u, k, h, spec), record.clip[0, h])
        half = record.margin[0, OTHERS, h] * np.sqrt(psi @ record.shape[0, h])
        np.testing.assert_allclose(found.half[0, h], half, rtol=1e-6)
        turned = np.diag(half)
        turned[:2, :2] = np.column_stack([rotated(x[k, 2], column) for column in turned[:2, :2].T])
        np.testing.assert_allclose(found.generators[0, h], turned, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("margin", ["step", "tube"])
def test_margins_are_rank_statistics_of_what_turned_out(margin: str) -> None:
    """The test scores every prediction itself; after a window only such scores are on record."""
    profile = CAR.model_copy(update={"margin": margin})
    stream = Stream(profile)
    steps, confidence, size = profile.horizon, profile.confidence, stream.window.size
    x, u = drive(1000, 2)
    stream.take(batch_of(x[:300], u[:300], profile))
    made: dict[int, tuple[FloatArray, FloatArray]] = {}
    for k in range(300, 1000):
        # Nothing is fitted anew, so that what is on record stays as it was scored.
        stream.models._renewal[:] = 10**9
        stream.take(batch_of(x[k : k + 1], u[k : k + 1], profile, first=k))
        found = boxes_of(stream)
        made[k] = found.center[0], found.half[0] / stream.models._record.margin[0][OTHERS].T
    scores = np.full((2, 1000, steps), np.nan)
    for k, (center, size_of) in made.items():
        for h in range(min(steps, 999 - k)):
            error = x[k + h + 1] - center[h]
            error[:2] = rotated(-x[k, 2], error[:2])
            error[2] = shorter(error[2])
            for g in range(2):
                scores[g, k + h + 1, h] = (np.abs(error) / size_of[h])[g == OTHERS].max()
    for g in range(2):
        found_scores, ratio = scores[g, -size:], np.ones(steps)
        if margin == "tube":
            ratio = stream.models._record.ratio[0, g]
            ends = range(steps, size)
            together = [max(found_scores[j - steps + 1 + h, h] / ratio[h] for h in range(steps)) for j in ends]
            found_scores = np.repeat(np.array(together)[:, None], steps, axis=1)
        wanted = []
        for column in found_scores.T:
            # Of the scores that may lie beyond the margins a fifth is left to the other states.
            beyond = len(column) - math.ceil((len(column) + 1) * confidence - 1e-9) + 1
            part = max(beyond // 5, 1)
            wanted.append(np.sort(column)[-(part if g else beyond - part)])
        margins = stream.models._record.margin[0, g]
        np.testing.assert_allclose(margins, ratio * wanted, rtol=4e-3)


def test_the_promised_rate_is_met_out_of_sample() -> None:
    vehicles, window = 300, 200
    x, u = stationary(vehicles, window + PLAIN.horizon, seed=1)
    for planned in (False, True):
        stream = Stream(PLAIN, vehicles, planned=planned)
        stream.take(*(batch_of(x[v, :window], u[v, :window], PLAIN, slot=v) for v in range(vehicles)))
        found = boxes_of(stream, u[:, window : window + PLAIN.horizon - 1])
        inside = (np.abs(x[:, window:] - found.center) <= found.half).all(axis=-1).mean(axis=0)
        # 300 independent vehicles: a standard deviation of 0.017.
        assert (inside > 0.86).all()
        assert (inside < 0.98).all()


def test_later_inputs_that_are_known_make_sets_smaller() -> None:
    x, u = stationary(30, 203, seed=2)
    volume = []
    for planned in (False, True):
        stream = Stream(PLAIN, 30, planned=planned)
        stream.take(*(batch_of(x[v, :200], u[v, :200], PLAIN, slot=v) for v in range(30)))
        volume.append(np.median(boxes_of(stream, u[:, 200:202]).half[:, -1].prod(axis=-1)))
    assert volume[1] < 0.8 * volume[0]


@pytest.mark.slow
def test_the_rate_holds_in_a_stream_and_recovers_after_a_shift() -> None:
    profile = PLAIN.model_copy(update={"window": 150})
    x, u = stationary(40, 1100, seed=3)
    # From sample 500 on everything moves three times as far.
    scale = np.where(np.arange(1100) < 500, 1.0, 3.0)[:, None]
    x, u = x * scale, u * scale
    stream = Stream(profile, 40)
    stream.take(*(batch_of(x[v, :200], u[v, :200], profile, slot=v) for v in range(40)))
    inside = np.zeros((1099, 40), dtype=bool)
    for k in range(200, 1099):
        stream.take(*(batch_of(x[v, k : k + 1], u[v, k : k + 1], profile, slot=v, first=k) for v in range(40)))
        found = boxes_of(stream)
        inside[k] = (np.abs(x[:, k + 1] - found.center[:, 0]) <= found.half[:, 0]).all(axis=1)
    assert 0.88 < inside[200:499].mean() < 0.95
    assert inside[500:520].mean() < 0.7
    assert 0.88 < inside[700:].mean() < 0.95


def test_equal_data_gives_equal_sets_in_every_slot_and_batch() -> None:
    x, u = stationary(5, 330, seed=3)
    x[3], u[3] = x[1], u[1]

    def run(order: list[int]) -> dict[int, list[Boxes]]:
        stream = Stream(PLAIN, len(order))
        stream.take(*(batch_of(x[v, :200], u[v, :200], PLAIN, slot=s) for s, v in enumerate(order)))
        found: dict[int, list[Boxes]] = {v: [] for v in order}
        for k in range(200, 330):
            batches = [batch_of(x[v, k : k + 1], u[v, k : k + 1], PLAIN, slot=s, first=k) for s, v in enumerate(order)]
            stream.take(*batches)
            boxes = boxes_of(stream)
            for s, v in enumerate(order):
                found[v].append(take_rows(boxes, s))
        return found

    whole = run([0, 1, 2, 3, 4])
    for a, b in zip(whole[1], whole[3], strict=True):
        np.testing.assert_array_equal(a.center, b.center)
        np.testing.assert_array_equal(a.generators, b.generators)
    for order in ([3, 2, 1, 0], [1], [2, 1]):
        for a, b in zip(run(order)[1], whole[1], strict=True):
            np.testing.assert_array_equal(a.center, b.center)
            np.testing.assert_array_equal(a.half, b.half)


def test_refits_are_spread_over_the_ticks() -> None:
    vehicles = 60
    x, u = stationary(vehicles, 260, seed=4)
    stream = Stream(PLAIN, vehicles)
    stream.take(*(batch_of(x[v, :210], u[v, :210], PLAIN, slot=v) for v in range(vehicles)))
    refits = []
    for k in range(210, 240):
        before = stream.models._solved.copy()
        stream.take(*(batch_of(x[v, k : k + 1], u[v, k : k + 1], PLAIN, slot=v, first=k) for v in range(vehicles)))
        boxes_of(stream)
        refits.append(int((stream.models._solved != before).sum()))
    assert sum(refits) >= 2 * vehicles
    assert max(refits) < 0.35 * vehicles


def test_sets_of_a_car_turn_with_it() -> None:
    x, u = drive(420, 5)
    angle, shift = 2.3, np.array([10.0, -4.0])
    moved = x.copy()
    moved[:, :2] = np.array([rotated(angle, p) for p in x[:, :2]]) + shift
    moved[:, 2] = np.mod(x[:, 2] + angle + np.pi, 2 * np.pi) - np.pi
    one, other = Stream(CAR), Stream(CAR)
    one.take(batch_of(x, u, CAR))
    other.take(batch_of(moved, u, CAR))
    a, b = boxes_of(one), boxes_of(other)
    np.testing.assert_allclose(b.half, a.half, rtol=1e-6)
    np.testing.assert_allclose(b.center[0, :, :2], [rotated(angle, p) + shift for p in a.center[0, :, :2]], atol=1e-7)
    np.testing.assert_allclose(b.center[0, :, 3], a.center[0, :, 3], atol=1e-7)


def test_what_is_frozen_does_not_learn() -> None:
    x, u = drive(500, 6)
    stream = Stream(CAR)
    stream.take(batch_of(x[:400], u[:400], CAR))
    boxes_of(stream)
    stream.models.frozen = True
    matrix, margin = stream.models._model.matrix.copy(), stream.models._record.margin.copy()
    for k in range(400, 480):
        stream.take(batch_of(x[k : k + 1], u[k : k + 1], CAR, first=k))
        boxes_of(stream)
    np.testing.assert_array_equal(stream.models._model.matrix, matrix)
    np.testing.assert_array_equal(stream.models._record.margin, margin)
    stream.models.frozen = False
    stream.take(batch_of(x[480:481], u[480:481], CAR, first=480))
    assert (stream.models._model.matrix != matrix).any()


def test_missing_samples_are_counted() -> None:
    x, u = drive(400, 7)
    stream = Stream(CAR)
    models = stream.models
    told = int(models.missing(stream.slots)[0])
    assert not models.ready(stream.slots)[0]
    assert told == models.least + stream.spec.reach + stream.spec.horizon
    for k in range(told):
        assert int(models.missing(stream.slots)[0]) == told - k
        stream.take(batch_of(x[k : k + 1], u[k : k + 1], CAR, first=k))
    assert models.ready(stream.slots)[0]
    assert int(models.missing(stream.slots)[0]) == 0
    # After a break the features are incomplete, the model stays.
    stream.take(batch_of(x[told + 5 : told + 6], u[told + 5 : told + 6], CAR, first=told + 5))
    assert models.ready(stream.slots)[0]
    assert not models.known(stream.slots)[0]
    models.reset(0)
    stream.window.clear(0)
    models.reset(0)
    assert int(models.missing(stream.slots)[0]) == told


def test_a_vehicle_that_nobody_asked_for_long_is_ready_at_once() -> None:
    """Its predictions have left the record, which is filled up by out-of-fold errors."""
    x, u = drive(1200, 8)
    stream = Stream(CAR)
    stream.take(batch_of(x[:350], u[:350], CAR))
    boxes_of(stream)
    for k in range(350, 1200, 5):
        stream.take(batch_of(x[k : k + 5], u[k : k + 5], CAR, first=k))
    boxes_of(stream)


def test_late_samples_lead_to_the_sets_of_samples_in_order() -> None:
    x, u = drive(420, 9)
    whole = batch_of(x, u, CAR)
    in_order, late = Stream(CAR), Stream(CAR)
    in_order.take(whole)
    kept = np.delete(np.arange(420), [405, 406])
    late.take(whole.take(kept))
    late.take(whole.take(np.array([405, 406])))
    a, b = boxes_of(in_order), boxes_of(late)
    np.testing.assert_array_equal(a.center, b.center)
    np.testing.assert_array_equal(a.half, b.half)


def test_a_glitch_is_counted_and_kept_out() -> None:
    x, u = drive(520, 10)
    bad = x.copy()
    bad[450, :2] += 0.08
    clean, spoiled = Stream(CAR), Stream(CAR)
    for stream, states in ((clean, x), (spoiled, bad)):
        stream.take(batch_of(states[:400], u[:400], CAR))
        for k in range(400, 520):
            stream.take(batch_of(states[k : k + 1], u[k : k + 1], CAR, first=k))
            boxes_of(stream)
    assert clean.models.glitches[0] == 0
    assert spoiled.models.glitches[0] == 1
    gated = spoiled.window.arrays().gated[0]
    assert gated.sum() == 1
    assert gated[450 % spoiled.window.size]
    # Its own misses are not on record, so that the margins stay.
    np.testing.assert_allclose(spoiled.models._record.margin, clean.models._record.margin, rtol=0.25)


def test_what_the_window_cannot_resolve_is_refused() -> None:
    def models(profile: VehicleProfile) -> ConformalPredictor:
        return ConformalPredictor(profile, RegressorSpec.of(profile), Window(profile), profile.horizon)

    with pytest.raises(UsageError, match=r"leaves 1 of the 200 scores .* make the window 399 or longer"):
        models(PLAIN.model_copy(update={"confidence": 0.99}))
    for window in (300, 398):
        with pytest.raises(UsageError, match=rf"leaves 2 of the {window} scores .* make the window 399 or longer"):
            models(PLAIN.model_copy(update={"confidence": 0.99, "window": window}))
    assert models(PLAIN.model_copy(update={"confidence": 0.99, "window": 399})).resolved == 1
    assert models(PLAIN.model_copy(update={"confidence": 0.9, "window": 90})).resolved == 3
    with pytest.raises(UsageError, match=r"needs 104 data, there is room for \d+: make the window \d+ or longer"):
        models(CAR.model_copy(update={"window": 80, "confidence": 0.8, "input_lags": 9}))


@pytest.mark.parametrize("confidence", [0.5, 0.8, 0.9, 0.95, 0.97, 0.99, 0.997, 0.999, 0.9999, 1 - 1e-6])
def test_the_least_window_is_the_first_that_leaves_three_scores_beyond_the_margin(confidence: float) -> None:
    """The rank itself decides, in exact arithmetic for the decimal that was written and as the kernel counts it."""
    written = Fraction(str(confidence))
    first = least_window(confidence)
    for window in (first - 1, first):
        beyond = window - math.ceil((window + 1) * written)
        assert scores_beyond(window, confidence) == beyond == rank_from_top(window, confidence) - 1
        assert (beyond >= LEAST_BEYOND) == (window == first) == ((1 - written) * (window + 1) >= 4)


def test_of_as_many_scores_as_the_window_holds_the_stated_number_lies_beyond_the_margin() -> None:
    order = np.random.default_rng(5).permutation(399)
    codes = np.array([encoded_score(1.01 ** float(k)) for k in order], dtype=np.uint16)[:, None]
    for window, beyond in ((300, 2), (398, 2), (399, 3)):
        held = codes[:window]
        margin = rank_statistic(held, window, 0, 0.99, 0, 1)
        assert int((held > encoded_score(margin)).sum()) == beyond == scores_beyond(window, 0.99)


def test_a_model_of_later_inputs_wants_a_plan() -> None:
    stream = Stream(CAR, planned=True)
    stream.take(batch_of(*drive(400, 1), CAR))
    with pytest.raises(UsageError, match="give a plan"):
        stream.models.predict(stream.slots, None)


def test_memory_of_a_vehicle() -> None:
    profile = CAR.model_copy(update={"window": 1000, "input_lags": 4, "horizon": 10, "confidence": 0.99})
    models = ConformalPredictor(profile, RegressorSpec.of(profile), Window(profile), 10, planned=True)
    assert models.bytes_per_vehicle < 200_000
