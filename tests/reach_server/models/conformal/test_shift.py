"""When the coming errors are no longer like those on record: the rate drops, that is told, and the margins follow."""

import numpy as np
import pytest
from scipy.stats import binom

from fleet_bus.messages import EventKind, Label, parse_profile
from reach_server.audit.prediction_check import FEW
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import Engine

TRAINED, SHIFTED = 900, 1500
PROFILE = parse_profile(
    {
        "class": "drifter",
        "state": {"x": "m", "y": "m"},
        "inputs": {"push": "m"},
        "sample_time": 0.1,
        "input_lags": 1,
        "window": 400,
        "horizon": 3,
        "future_inputs": "learned",
    }
)


@pytest.mark.slow
def test_a_shift_lowers_the_rate_is_told_at_once_and_is_adapted_to() -> None:
    rng = np.random.default_rng(3)
    total = TRAINED + SHIFTED
    u = rng.uniform(-1, 1, (total, 1))
    noise = rng.normal(0, 0.01, (total, 2)) * np.where(np.arange(total) < TRAINED, 1.0, 1.8)[:, None]
    x = np.zeros((total, 2))
    for k in range(total - 1):
        x[k + 1] = 0.9 * x[k] + 0.1 * u[k] + noise[k]
    engine = Engine(PROFILE)
    engine.add("car")
    rows = np.arange(total)
    whole = SampleBatch(
        np.zeros(total, dtype=np.intp), np.ones(total, dtype=np.uint64), rows.astype(np.uint64),
        10**18 + rows * PROFILE.sample_time_ns, np.zeros(total, dtype=np.uint32), x, u,
    )  # fmt: skip
    engine.append(whole.take(rows[:500]))
    told, held, labels = [], [], []
    before = engine.audit_of("car")
    for k in range(500, total):
        tubes = engine.step(whole.take(rows[k : k + 1]))
        after = engine.audit_of("car")
        if after.checked > before.checked:
            held.append(after.inside > before.inside)
        before = after
        told += [(k, event) for event in tubes.events if event.kind is EventKind.COVERAGE]
        labels.append(tubes.labels[0])
    rate = np.array(held[TRAINED - 501 :])
    assert np.mean(held[: TRAINED - 501]) >= 0.98
    assert rate[:150].mean() < 0.97
    assert rate[-600:].mean() >= 0.98
    # The first event comes with the very check whose miss the confidence does not explain.
    misses = np.cumsum(~np.array(held))
    counts = np.minimum(np.arange(1, len(held) + 1), 1000)
    recent = misses - np.concatenate([np.zeros(1000, dtype=np.int64), misses])[: len(misses)]
    beyond = recent > binom.ppf(np.where(counts < FEW, 0.9999, 0.99), counts, 0.01)
    first = int(np.argmax(beyond))
    assert first > TRAINED - 501
    assert told[0][0] == 501 + first
    assert told[0][1].details["missed"] == recent[first]
    assert labels[first] is Label.CALIBRATED
    assert labels[first + 1] is Label.CONTRADICTED
