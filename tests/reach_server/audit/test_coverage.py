"""The rolling record of each vehicle against a twin that keeps a list."""

from collections import deque

import numpy as np
import pytest

from fleet_bus.messages import Audit
from reach_server.audit.coverage import BEYOND_BOUNDS, FORGIVEN, CoverageRecord, Miss
from reach_server.audit.prediction_check import RECENT, binomial_band
from reach_server.data.window import SampleBatch
from reach_server.sets.raw import RawSets

NONE = np.zeros((1, 0))


def made(vehicles: int, alpha: float = 0.01) -> CoverageRecord:
    record = CoverageRecord(alpha)
    record.grow(vehicles)
    return record


def check(record: CoverageRecord, slots: list[int], k: int, x: list[float]) -> tuple[list[Miss], list[int], list[int]]:
    """One prediction [-1, 1] for each slot, and the sample that it was made for."""
    count = len(slots)
    keys = np.ones(count, dtype=np.uint64), np.full(count, k, dtype=np.uint64), np.full(count, 100 * (k + 1))
    sets = RawSets.zonotope(np.zeros((count, 1)), np.ones((count, 1, 1)))
    record.predictions.keep(np.array(slots, dtype=np.intp), *keys, sets, sets)
    batch = SampleBatch(
        np.array(slots, dtype=np.intp), keys[0], keys[1] + np.uint64(1), keys[2], np.zeros(count, dtype=np.uint32),
        np.array(x)[:, None], np.zeros((count, 0)),
    )  # fmt: skip
    found = record.check(batch, 1.0, NONE, (), np.zeros(count, dtype=bool))
    return found.misses, found.left.tolist(), found.returned.tolist()


@pytest.mark.slow
def test_each_record_is_that_of_its_newest_checks() -> None:
    rng = np.random.default_rng(3)
    record = made(3, 0.05)
    rates = np.array([0.05, 0.02, 0.05])
    lists: list[deque[bool]] = [deque(maxlen=RECENT) for _ in rates]
    totals = np.zeros((3, 2), dtype=int)
    outside = np.zeros(3, dtype=bool)
    for k in range(2600):
        rates[2] = 0.12 if 1200 <= k < 1500 else 0.05
        slots = np.flatnonzero(rng.random(3) < 0.9)
        missed = rng.random(len(slots)) < rates[slots]
        misses, left, returned = check(record, slots.tolist(), k, np.where(missed, 1.5, 0.5).tolist())
        assert misses == [Miss(int(s), 100 * (k + 1), 0.5, False) for s in slots[missed]]
        totals[slots] += np.column_stack([np.ones(len(slots), dtype=int), ~missed])
        for slot, miss in zip(slots.tolist(), missed.tolist(), strict=True):
            lists[slot].append(miss)
            count = sum(lists[slot])
            recent = len(lists[slot])
            if recent >= 50:
                leaves = not outside[slot] and count > binomial_band(recent, 0.05)
                returns = outside[slot] and count <= binomial_band(recent, 0.05, 0.5)
                assert (slot in left, slot in returned) == (leaves, returns)
                outside[slot] ^= leaves or returns
        np.testing.assert_array_equal(record.outside[:3], outside)
    assert totals[:, 0].min() > 2000
    for slot, newest in enumerate(lists):
        misses_now = sum(newest)
        band = binomial_band(RECENT, 0.05)
        checks, held = totals[slot].tolist()
        assert record.audit(slot) == Audit(checks, held, 0.5, RECENT, RECENT - misses_now, band)


def test_a_shift_is_told_once_and_its_end_once() -> None:
    record = made(1)
    told = []
    for k in range(3000):
        misses = k % 100 == 0 or (1000 <= k < 1100 and k % 4 == 0)
        _, left, returned = check(record, [0], k, [9.0 if misses else 0.0])
        told += [("left", k)] * len(left) + [("returned", k)] * len(returned)
    assert [what for what, _ in told] == ["left", "returned"]
    # 10 of 1000 are usual; of the misses after them the ninth is one too many.
    assert told[0][1] == 1000 + 4 * 9
    assert 2000 <= told[1][1] < 2100
    assert not record.outside[0]


def test_misses_at_the_start_are_no_verdict_unless_they_are_many() -> None:
    for misses, verdict in (([0, 12, 25, 39], False), ([0, 1, 2], True), ([10, 12, 14, 16, 18], True)):
        record = made(1)
        left = [check(record, [0], k, [9.0 if k in misses else 0.0])[1] for k in range(40)]
        assert any(left) is verdict


def test_a_reset_forgets_the_vehicle_and_no_other() -> None:
    record = made(2)
    for k in range(20):
        check(record, [0, 1], k, [9.0, 0.0])
    record.unexplained[0] = 5
    record.refuted[0] = True
    assert record.outside[:2].tolist() == [True, False]
    record.reset(0)
    assert record.audit(0) == Audit()
    assert record.audit(1) == Audit(20, 20, 0.0, 20, 20, binomial_band(20, 0.01, 0.9999))
    assert not record.outside.any()
    assert not record.refuted.any()
    assert not record.unexplained
    check(record, [0], 20, [0.0])
    assert record.audit(0) == Audit(1, 1, 0.0, 1, 1, 1)


def judge(record: CoverageRecord, k: int, x: float, *, jumped: bool) -> tuple[list[Miss], list[int]]:
    """One prediction [-1, 1], and the sample that it was made for."""
    keys = np.ones(1, dtype=np.uint64), np.array([k], dtype=np.uint64), np.array([100 * (k + 1)])
    sets = RawSets.zonotope(np.zeros((1, 1)), np.ones((1, 1, 1)))
    record.predictions.keep(np.zeros(1, dtype=np.intp), *keys, sets, sets)
    batch = SampleBatch(
        np.zeros(1, dtype=np.intp), keys[0], keys[1] + np.uint64(1), keys[2], np.zeros(1, dtype=np.uint32),
        np.array([[x]]), np.zeros((1, 0)),
    )  # fmt: skip
    found = record.check(batch, 1.0, NONE, (), np.array([jumped]))
    for miss in found.misses if record.alpha == 0.0 else ():
        record.refute(miss.slot)
    return found.misses, found.restored.tolist()


def test_only_a_jump_beyond_all_bounds_is_no_check() -> None:
    for x, jumped, alpha, checked in (
        (BEYOND_BOUNDS * 1.01, True, 0.0, 0), (BEYOND_BOUNDS * 0.99, True, 0.0, 1), (BEYOND_BOUNDS * 9, False, 0.0, 1),
        (BEYOND_BOUNDS * 9, True, 0.01, 1), (0.5, True, 0.0, 1),
    ):  # fmt: skip
        record = made(1, alpha)
        misses, _ = judge(record, 0, x, jumped=jumped)
        assert record.audit(0).checked == checked, x
        assert bool(misses) is (checked == 1 and abs(x) > 1), x
        assert record.refuted[0] == (bool(misses) and alpha == 0.0)
        rows, _ = record.predictions.prior(np.array([0]), *(np.ones((2, 1), dtype=np.uint64)))
        assert len(rows) == checked, "what was no check cuts no received state either"


def test_a_refuted_bound_is_believed_after_a_span_that_doubles() -> None:
    record, span, k = CoverageRecord(0.0, 30), 30, 0
    record.grow(1)
    for wanted in (span, 2 * span, 4 * span):
        judge(record, k, 9.0, jumped=False)
        judge(record, k + 1, 0.0, jumped=False)
        # A miss meanwhile begins the count anew, and costs no more than that.
        judge(record, k + 2, 9.0, jumped=False)
        k += 3
        back = [judge(record, k + i, 0.0, jumped=False)[1] for i in range(wanted)]
        assert back == [[]] * (wanted - 1) + [[0]]
        assert not record.refuted[0]
        k += wanted


def test_jumps_count_among_the_newest_checks() -> None:
    record, slots = made(1, 0.0), np.zeros(1, dtype=np.intp)
    assert [record.jumped(0) for _ in range(FORGIVEN + 1)] == [False] * FORGIVEN + [True]
    for k in range(RECENT - 1):
        judge(record, k, 0.0, jumped=False)
        assert record.restless(slots)[0]
    judge(record, RECENT, 0.0, jumped=False)
    assert not record.restless(slots)[0]
    calibrated = made(1, 0.01)
    assert not any(calibrated.jumped(0) for _ in range(9)), "a rate counts them as misses"
    record.jumped(0)
    record.reset(0)
    assert not any(record.jumped(0) for _ in range(FORGIVEN))


def test_what_was_counted_of_all_vehicles_never_falls() -> None:
    record = CoverageRecord(0.0)
    record.grow(1)
    for k, x in enumerate((0.0, 3.0, 0.5)):
        judge(record, k, x, jumped=False)
    assert (record.checked_so_far, record.inside_so_far) == (3, 2)
    record.reset(0)
    assert record.audit(0).checked == 0
    judge(record, 3, 0.0, jumped=False)
    assert (record.checked_so_far, record.inside_so_far) == (4, 3)
