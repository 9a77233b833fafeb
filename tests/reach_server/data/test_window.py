"""Windows against a twin that sorts a list, whatever order the samples come in."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleet_bus.messages import StateFlag, StateSample
from reach_server.data.window import AppendReport, SampleBatch, Window
from tests.examples import examples
from tests.reach_server.drives import START, World

PROFILE = World().profile
STEP = PROFILE.sample_time_ns
SIZE = 8


def stamp(epoch: int, seq: int) -> int:
    return START + (1000 * epoch + seq) * STEP


def batch_of(keys: list[tuple[int, int, int]], flags: dict[tuple[int, int], StateFlag] | None = None) -> SampleBatch:
    """Samples (slot, epoch, seq) whose every number says which sample it is."""
    flags = flags or {}
    return SampleBatch(
        np.array([k[0] for k in keys], dtype=np.intp),
        np.array([k[1] for k in keys], dtype=np.uint64),
        np.array([k[2] for k in keys], dtype=np.uint64),
        np.array([stamp(k[1], k[2]) for k in keys], dtype=np.int64),
        np.array([int(flags.get(k[1:], 0)) for k in keys], dtype=np.uint32),
        np.array([[k[0], 100 * k[1] + k[2]] for k in keys], dtype=np.float64).reshape(-1, 2),
        np.array([[1000 * k[0] + 100 * k[1] + k[2]] for k in keys], dtype=np.float64).reshape(-1, 1),
    )


def window(vehicles: int = 3) -> Window:
    made = Window(PROFILE, SIZE)
    made.grow(vehicles)
    return made


_KEYS = st.tuples(st.integers(0, 2), st.integers(1, 2), st.integers(0, 30))


@settings(max_examples=examples(150))
@given(st.lists(st.lists(_KEYS, max_size=25), max_size=8))
@pytest.mark.slow
def test_the_newest_distinct_samples_are_held_in_order(batches: list[list[tuple[int, int, int]]]) -> None:
    held: dict[int, list[tuple[int, int]]] = {slot: [] for slot in range(3)}
    w = window()
    for keys in batches:
        result = w.append(batch_of(keys))
        assert result.backwards == 0
        assert result.stored + result.repeated + result.too_old == len(keys)
        for slot in held:
            came = {k[1:] for k in keys if k[0] == slot}
            held[slot] = sorted({*held[slot], *came})[-SIZE:]
    slots = np.arange(3)
    np.testing.assert_array_equal(w.filled(slots), [len(held[s]) for s in range(3)])
    block = w.block(slots)
    for slot, keys_held in held.items():
        assert w.keys(slot) == keys_held
        count = len(keys_held)
        expected = batch_of([(slot, *key) for key in keys_held])
        rows = slice(SIZE - count, SIZE)
        np.testing.assert_array_equal(block.valid[slot], np.arange(SIZE) >= SIZE - count)
        np.testing.assert_array_equal(block.x[slot, rows], expected.x)
        np.testing.assert_array_equal(block.u[slot, rows], expected.u)
        np.testing.assert_array_equal(block.t[slot, rows], expected.t)
        linked = [
            i > 0 and keys_held[i] == (keys_held[i - 1][0], keys_held[i - 1][1] + 1) for i in range(count)
        ]  # fmt: skip
        np.testing.assert_array_equal(block.linked[slot, rows], linked)
        assert not block.linked[slot, : SIZE - count].any()
        if keys_held:
            epoch, seq, t, _ = w.newest(slots)
            assert (int(epoch[slot]), int(seq[slot])) == keys_held[-1]
            assert t[slot] == stamp(*keys_held[-1])


def test_samples_too_old_for_a_full_window_do_not_enter_it() -> None:
    w = window()
    w.append(batch_of([(0, 1, k) for k in range(10, 20)]))
    before = w.keys(0)
    w.append(batch_of([(0, 1, 3)]))
    assert w.keys(0) == before


def test_repeated_samples_keep_the_values_that_came_first() -> None:
    w = window()
    w.append(batch_of([(0, 1, 1), (0, 1, 2)]))
    again = replace(batch_of([(0, 1, 2)]), x=np.full((1, 2), -1.0))
    assert w.append(again) == AppendReport(0, 1, 0)
    np.testing.assert_array_equal(w.block(np.array([0])).x[0, -1], [0.0, 102.0])


def test_a_stamp_that_does_not_advance_is_refused() -> None:
    w = window()
    w.append(batch_of([(0, 1, 1), (0, 1, 2)]))
    for t, expected in ((stamp(1, 2), AppendReport(stopped=1)), (stamp(1, 1) - 1, AppendReport(backwards=1))):
        assert w.append(replace(batch_of([(0, 1, 3)]), t=np.array([t]))) == expected
    assert w.append(batch_of([(0, 1, 4)])) == AppendReport(1, 0, 0)
    assert w.keys(0) == [(1, 1), (1, 2), (1, 4)]


def test_another_epoch_begins_after_the_one_before() -> None:
    w = window()
    w.append(batch_of([(0, 1, 5)]))
    later = replace(batch_of([(0, 2, 0)]), t=np.array([stamp(1, 6)]))
    assert w.append(later) == AppendReport(1, 0, 0)
    assert w.keys(0) == [(1, 5), (2, 0)]
    assert not w.block(np.array([0])).linked.any()


def test_another_epoch_at_an_earlier_time_is_believed_after_a_few_samples() -> None:
    w = window()
    w.append(batch_of([(0, 1, 50)]))
    earlier = replace(batch_of([(0, 2, k) for k in range(6)]), t=START + np.arange(6) * STEP)
    assert w.append(earlier) == AppendReport(3, leaped=3, resynced=1)
    assert w.keys(0) == [(1, 50), (2, 3), (2, 4), (2, 5)]


@pytest.mark.parametrize(
    ("second", "third"),
    [(1.0, True), (1.29, True), (0.71, True), (1.31, False), (0.69, False), (2.0, False)],
)
def test_a_link_needs_the_sample_interval(second: float, third: bool) -> None:
    w = window()
    batch = batch_of([(0, 1, 0), (0, 1, 1)])
    w.append(replace(batch, t=START + np.array([0, round(second * STEP)])))
    assert bool(w.block(np.array([0])).linked[0, -1]) is third


def test_a_link_needs_the_next_number_whatever_the_stamps_say() -> None:
    w = window()
    w.append(replace(batch_of([(0, 1, 0), (0, 1, 2)]), t=START + np.array([0, STEP])))
    assert not w.block(np.array([0])).linked.any()


def test_gaps_new_trajectories_and_missing_inputs_are_marked() -> None:
    w = window()
    flags = {(1, 2): StateFlag.NEW_TRAJECTORY, (1, 3): StateFlag.INPUT_MISSING}
    w.append(batch_of([(0, 1, 0), (0, 1, 1), (0, 1, 2), (0, 1, 3), (0, 1, 5), (0, 1, 6)], flags))
    block = w.block(np.array([0]), 6)
    np.testing.assert_array_equal(block.linked[0], [False, True, False, True, False, True])
    np.testing.assert_array_equal(block.input_known[0], [True, True, True, False, True, True])
    np.testing.assert_array_equal(w.newest(np.array([0]))[3], [0])


def test_growing_and_clearing_touch_no_other_vehicle() -> None:
    w = window(1)
    w.append(batch_of([(0, 1, k) for k in range(20)]))
    w.grow(2)
    w.append(batch_of([(1, 1, 0)]))
    w.clear(0)
    np.testing.assert_array_equal(w.filled(np.arange(2)), [0, 1])
    assert w.keys(0) == []
    assert w.keys(1) == [(1, 0)]
    assert not w.block(np.array([0])).valid.any()
    w.append(batch_of([(0, 1, 3)]))
    assert w.keys(0) == [(1, 3)]


def test_a_window_holds_what_its_profile_needs() -> None:
    made = Window(PROFILE)
    assert made.size >= PROFILE.window + PROFILE.input_lags + PROFILE.horizon


def test_samples_of_messages_become_a_batch() -> None:
    samples = [StateSample(7, k, START + k, np.array([1.0, 2.0]), np.array([3.0]), StateFlag.HISTORY) for k in range(2)]
    batch = SampleBatch.of(4, samples)
    np.testing.assert_array_equal(batch.vehicle, [4, 4])
    np.testing.assert_array_equal(batch.seq, [0, 1])
    np.testing.assert_array_equal(batch.flags, [int(StateFlag.HISTORY)] * 2)
    joined = SampleBatch.join([batch, batch])
    assert joined.x.shape == (4, 2)
    assert window().append(SampleBatch.join([batch.take(np.zeros(0, dtype=np.intp))])) == AppendReport(0, 0, 0)


def test_one_stamp_in_the_far_future_does_not_silence_a_vehicle() -> None:
    w = window()
    w.append(batch_of([(0, 1, 0), (0, 1, 1)]))
    assert w.append(replace(batch_of([(0, 1, 2)]), t=np.array([stamp(1, 2) + 10**15]))) == AppendReport(leaped=1)
    assert w.append(batch_of([(0, 1, k) for k in range(3, 10)])) == AppendReport(7)
    assert w.keys(0) == [(1, k) for k in (1, 3, 4, 5, 6, 7, 8, 9)]


def test_a_stopped_clock_is_never_believed() -> None:
    w = window()
    stuck = batch_of([(0, 1, k) for k in range(12)])
    result = w.append(replace(stuck, t=np.full(12, stamp(1, 0))))
    assert (result.stored, result.stopped) == (1, 11)
