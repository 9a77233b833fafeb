"""Whatever a vehicle has sent, samples that agree with each other win it back; one bad sample costs a few."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleet_bus.messages import StateFlag
from reach_server.data.stream_order import LATE_BATCHES, LATEST, RESYNC
from reach_server.data.window import SampleBatch, Window
from tests.reach_server.data.circles import ALL, START, STEP, circle, run_of, window

#: Batches of samples that agree with each other, after which the newest of them is the newest one held.
ENOUGH = LATE_BATCHES + RESYNC + 1
EPOCH, FIRST = START - 3600 * 10**9, 500


@dataclass(frozen=True)
class Header:
    """What a sample says of itself."""

    epoch: int
    seq: int
    t: int
    flags: int = 0


def good(k: int) -> Header:
    """Sample k of the stream that counts."""
    return Header(EPOCH, FIRST + k, START + k * STEP)


def batch_of(headers: list[Header]) -> SampleBatch:
    """Samples with these headers of a car that stands."""
    return replace(
        circle(len(headers)),
        x=np.zeros((len(headers), 4)),
        epoch=np.array([one.epoch for one in headers], dtype=np.uint64),
        seq=np.array([one.seq for one in headers], dtype=np.uint64),
        t=np.array([one.t for one in headers], dtype=np.int64),
        flags=np.array([one.flags for one in headers], dtype=np.uint32),
    )


def newest(w: Window) -> tuple[int, int, int]:
    epoch, seq, t, _ = w.newest(ALL)
    return int(epoch[0]), int(seq[0]), int(t[0])


_near = st.integers(-200, 200)
_epochs = st.sampled_from([0, 1, EPOCH - 1, EPOCH, EPOCH + 1, START, START + 2**40, 2**63, 2**64 - 1])
_seqs = st.one_of(_near.map(lambda k: FIRST + k), st.sampled_from([0, 2**31, 2**63, 2**64 - 2, 2**64 - 1]))
_stamps = st.one_of(
    _near.map(lambda k: START + k * STEP), _near.map(lambda k: START + k * STEP + 7_000_000),
    st.sampled_from([1, START - 3600 * 10**9, START + 3600 * 10**9, LATEST, LATEST + 1, 2**63 - 1]),
)  # fmt: skip
_flags = st.sampled_from([0, 0, 0, int(StateFlag.NEW_TRAJECTORY), int(StateFlag.HISTORY)])
_garbage = st.builds(Header, _epochs, _seqs, _stamps, _flags)
#: Streams of bad samples that agree with each other, among them the good stream's own numbers and stamps.
_streams = st.tuples(_garbage, st.integers(1, 200), st.sampled_from([0, 1, STEP, 2 * STEP])).map(
    lambda given: [
        replace(given[0], seq=min(given[0].seq + i, 2**64 - 1), t=min(given[0].t + i * given[2], 2**63 - 1))
        for i in range(given[1])
    ]
)
_prefix = st.lists(st.one_of(st.lists(_garbage, min_size=1, max_size=6), _streams), max_size=8)


@settings(max_examples=300, deadline=None)
@given(_prefix, st.booleans(), st.data())
@pytest.mark.slow
def test_from_any_state_samples_that_agree_win_the_vehicle_back(
    prefix: list[list[Header]], one_by_one: bool, data: st.DataObject
) -> None:
    w = window()
    for headers in prefix:
        for part in [[one] for one in headers] if one_by_one else [headers]:
            w.append(batch_of(part))
    k = 0
    for _ in range(ENOUGH):
        count = data.draw(st.integers(1, 3))
        w.append(batch_of([good(k + i) for i in range(count)]))
        k += count + data.draw(st.sampled_from([0, 0, 0, 1, 5]))
        last = k
    w.append(batch_of([good(last)]))
    w.append(batch_of([good(last + 1)]))
    assert newest(w) == (EPOCH, FIRST + last + 1, START + (last + 1) * STEP)
    assert w.followed(ALL)[0]
    held = w.keys(0)
    assert held == sorted(set(held))


@settings(max_examples=300, deadline=None)
@given(st.integers(1, 150), _garbage, st.booleans())
@pytest.mark.slow
def test_one_bad_sample_costs_a_few_and_bears_no_tube(before: int, bad: Header, instead: bool) -> None:
    w = window()
    w.append(batch_of([good(k) for k in range(before)]))
    expected = good(before)
    if (bad.epoch, bad.seq, bad.t) == (expected.epoch, expected.seq, expected.t):
        return
    w.append(batch_of([bad]))
    if newest(w) == (bad.epoch, bad.seq, bad.t):
        linked = bad.epoch == EPOCH and bad.seq == expected.seq and abs(bad.t - expected.t) <= 0.25 * STEP
        assert before == 0 or bool(w.followed(ALL)[0]) is (linked and not bad.flags & int(StateFlag.NEW_TRAJECTORY))
    lost = 0
    for k in range(before + instead, before + instead + 60):
        w.append(batch_of([good(k)]))
        lost += newest(w)[:2] != (EPOCH, FIRST + k)
    assert lost <= ENOUGH - 1
    assert run_of(w)[-1] > 0
    assert {key for key in w.keys(0) if key[0] != EPOCH} <= {(bad.epoch, bad.seq)}


@pytest.mark.parametrize(
    "bad",
    [
        replace(good(80), seq=2**64 - 1), replace(good(80), seq=FIRST + 10**6), replace(good(80), epoch=2**64 - 1),
        replace(good(80), t=2**63 - 1), replace(good(80), t=START + 3600 * 10**9),
    ],
)  # fmt: skip
def test_a_leap_is_refused_and_costs_nothing_but_itself(bad: Header) -> None:
    w = window()
    w.append(batch_of([good(k) for k in range(80)]))
    assert w.append(batch_of([bad])).leaped == 1
    assert w.append(batch_of([good(80)])).stored == 1
    assert run_of(w) == list(range(81))


@pytest.mark.parametrize(
    "bad",
    [Header(EPOCH, 2**64 - 1, START), Header(2**64 - 1, 0, START), Header(EPOCH, FIRST, LATEST),
     Header(START, 3, START + 10**15)],
)  # fmt: skip
def test_the_first_sample_of_a_vehicle_may_be_the_bad_one(bad: Header) -> None:
    w = window()
    assert w.append(batch_of([bad])).stored == 1
    resynced = 0
    for k in range(1, ENOUGH + 1):
        resynced += w.append(batch_of([good(k)])).resynced
    assert resynced == 1
    assert newest(w) == (EPOCH, FIRST + ENOUGH, START + ENOUGH * STEP)
    assert run_of(w)[-1] > 0


def test_what_goes_on_is_not_replaced_by_what_comes_now_and_then() -> None:
    w = window()
    w.append(batch_of([good(k) for k in range(50)]))
    for k in range(50, 250):
        w.append(batch_of([good(k)]))
        if k % 2:
            away = Header(2**63, k, START + k * STEP)
            assert w.append(batch_of([away])).leaped == 1
        assert newest(w) == (EPOCH, FIRST + k, START + k * STEP)
    assert run_of(w)[-1] >= 100


@settings(max_examples=60, deadline=None)
@given(_prefix, st.integers(0, 2**32 - 1))
@pytest.mark.slow
def test_what_one_vehicle_sends_changes_nothing_of_another(prefix: list[list[Header]], seed: int) -> None:
    rng = np.random.default_rng(seed)
    alone, together = window(), window(vehicles=2)
    k = 0
    for headers in prefix:
        count = int(rng.integers(1, 9))
        mine = batch_of([good(k + i) for i in range(count)])
        mine = replace(mine, x=rng.normal(scale=1e-3, size=mine.x.shape))
        k += count + int(rng.integers(0, 2))
        theirs = replace(batch_of(headers), vehicle=np.ones(len(headers), dtype=np.intp))
        both = SampleBatch.join([mine, theirs])
        alone.append(mine)
        together.append(both.take(rng.permutation(len(both.t))))
    for name in ("t", "x", "u", "run", "input_known", "gated"):
        np.testing.assert_array_equal(getattr(alone.arrays(), name)[0], getattr(together.arrays(), name)[0])
    assert alone.keys(0) == together.keys(0)
    assert int(alone.count[0]) == int(together.count[0])
    assert int(alone.revision[0]) == int(together.revision[0])
