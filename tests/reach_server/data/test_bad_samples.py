"""What no honest sensor sends: each case has a rule and a count, and none of them spoils what is already there."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleet_bus.messages import StateFlag
from reach_server.data.regressors import runs
from reach_server.data.stream_order import LATE_BATCHES, PACE, RESYNC, SPARE
from reach_server.data.window import AppendReport, SampleBatch
from tests.examples import examples
from tests.reach_server.data.circles import ALL, SIZE, START, STEP, circle, moved, run_of, window


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e31])
def test_a_state_that_is_no_number_is_refused_and_leaves_a_gap(value: float) -> None:
    w = window()
    batch = circle(6)
    assert w.append(moved(batch, 3, np.array([0.0, value, 0.0, 1.0]))) == AppendReport(5, not_finite=1)
    assert [seq for _, seq in w.keys(0)] == [0, 1, 2, 4, 5]
    assert run_of(w) == [0, 1, 2, 0, 1]
    assert np.isfinite(w.arrays().x).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e31])
def test_an_input_that_is_no_number_is_a_missing_one(value: float) -> None:
    w = window()
    u = 0.1 * np.ones((6, 1))
    u[2] = value
    assert w.append(replace(circle(6), u=u)) == AppendReport(6, no_input=1)
    block = w.block(ALL, 6)
    np.testing.assert_array_equal(block.input_known[0], [True, True, False, True, True, True])
    np.testing.assert_array_equal(block.linked[0], [False, True, True, True, True, True])
    assert block.u[0, 2, 0] == 0.0
    flags = np.zeros(1, dtype=np.uint32) + np.uint32(StateFlag.INPUT_MISSING)
    again = replace(circle(1, 6), flags=flags, u=np.full((1, 1), value))
    assert w.append(again) == AppendReport(1)
    np.testing.assert_array_equal(w.newest(ALL)[3], flags)


def test_a_late_sample_is_judged_like_one_in_time() -> None:
    w = window()
    batch = circle(10)
    w.append(batch.take(np.array([0, 1, 4, 5, 6, 9])))
    spoiled = replace(moved(batch, 2, np.full(4, np.nan)), u=np.where(np.arange(10)[:, None] == 3, np.nan, batch.u))
    spoiled = replace(spoiled, t=np.where(np.isin(np.arange(10), [7, 8]), batch.t[[6] * 7 + [6, 9, 9]], batch.t))
    found = w.append(spoiled.take(np.array([8, 2, 3, 7, 1])))
    assert found == AppendReport(1, repeated=1, stopped=2, not_finite=1, no_input=1)
    assert [seq for _, seq in w.keys(0)] == [0, 1, 3, 4, 5, 6, 9]
    assert run_of(w) == [0, 1, 0, 1, 2, 3, 0]
    assert w.append(replace(batch.take(np.array([7])), t=batch.t[[2]])) == AppendReport(backwards=1)


def test_a_late_sample_throws_nothing_out_that_is_there() -> None:
    w = window()
    batch = circle(12)
    t = batch.t.copy()
    t[4] += 15 * STEP
    found = w.append(replace(batch, t=t).take(np.delete(np.arange(12), 2)))
    assert found == AppendReport(8, backwards=RESYNC, resynced=1)
    before = w.keys(0)
    assert w.append(batch.take(np.array([2]))) == AppendReport(1)
    assert w.keys(0) == sorted([*before, (1, 2)])


@pytest.mark.parametrize("hours", [-1, 1, 10**5])
def test_a_clock_that_is_set_is_believed_after_a_few_samples(hours: int) -> None:
    w = window()
    w.append(circle(10))
    away = replace(circle(10, 10), t=circle(10, 10).t + hours * 3600 * 10**9)
    found = w.append(away)
    assert (found.stored, found.refused, found.resynced) == (10 - RESYNC, RESYNC, 1)
    assert (found.backwards, found.leaped) == ((RESYNC, 0) if hours < 0 else (0, RESYNC))
    assert run_of(w)[10:] == [0, 1, 2, 3, 4, 5, 6]
    again = w.append(circle(10, 20))
    assert (again.stored, again.refused, again.resynced) == (10 - RESYNC, RESYNC, 1)


@pytest.mark.parametrize(("flags", "stored"), [(StateFlag.NONE, 0), (StateFlag.NEW_TRAJECTORY, 1)])
def test_a_trajectory_may_begin_any_time_later(flags: StateFlag, stored: int) -> None:
    w = window()
    w.append(circle(10))
    later = replace(circle(1, 10), t=circle(1, 10).t + 3600 * 10**9, flags=np.array([int(flags)], dtype=np.uint32))
    assert w.append(later).stored == stored


def test_recorded_history_may_have_ended_any_time_before() -> None:
    w = window()
    w.append(replace(circle(10), flags=np.full(10, int(StateFlag.HISTORY), dtype=np.uint32)))
    assert w.append(replace(circle(1, 10), t=circle(1, 10).t + 3600 * 10**9)) == AppendReport(1)


@pytest.mark.parametrize("lost", [1, 1000, 10**7])
def test_lost_samples_are_no_leap(lost: int) -> None:
    w = window()
    w.append(circle(10))
    assert w.append(circle(5, 10 + lost)) == AppendReport(5)


@pytest.mark.parametrize(
    ("seq", "steps", "leaps"),
    [(1, SPARE + PACE, False), (1, SPARE + PACE + 1, True), (SPARE + PACE, 1, False), (SPARE + PACE + 1, 1, True),
     (2**63, 1, True), (2**63, 2**31, True)],
)  # fmt: skip
def test_numbers_and_stamps_leap_beyond_what_the_other_says(seq: float, steps: float, leaps: bool) -> None:
    w = window()
    w.append(circle(10))
    one = circle(1, 9)
    one = replace(one, seq=np.array([9 + int(seq)], dtype=np.uint64), t=one.t + int(steps) * STEP)
    assert w.append(one) == (AppendReport(leaped=1) if leaps else AppendReport(1))


def test_an_epoch_set_back_is_believed_when_nothing_else_comes() -> None:
    w = window(vehicles=2)
    newest = replace(circle(60, 1000), epoch=np.full(60, 9, dtype=np.uint64))
    w.append(newest.take(np.arange(30)))
    w.append(circle(1, 5, slot=1))
    for k in range(LATE_BATCHES):
        assert w.append(circle(1, k)) == AppendReport(1)
    w.append(newest.take(np.array([30])))
    for k in range(LATE_BATCHES, 2 * LATE_BATCHES):
        assert w.append(circle(1, k)) == AppendReport(1)
    assert w.newest(ALL)[0][0] == 9, "while the newest epoch is alive, older samples are late ones"
    assert w.append(circle(1, 2 * LATE_BATCHES)) == AppendReport(1, resynced=1)
    assert w.keys(0) == [(1, k) for k in range(2 * LATE_BATCHES + 1)], "only what is newer than they are was wrong"
    assert w.append(circle(5, 2 * LATE_BATCHES + 1)) == AppendReport(5)
    assert run_of(w)[-6:] == [40, 41, 42, 43, 44, 45]
    assert w.keys(1) == [(1, 5)]


def test_an_older_epoch_that_goes_on_where_a_newer_one_has_begun_is_believed_soon() -> None:
    w = window()
    w.append(circle(20))
    w.append(replace(circle(1, 20), epoch=np.array([77], dtype=np.uint64)))
    for k in range(21, 21 + RESYNC):
        assert w.append(circle(1, k)) == AppendReport(leaped=1)
    assert w.append(circle(3, 21 + RESYNC)) == AppendReport(3, resynced=1)
    assert {epoch for epoch, _ in w.keys(0)} == {1}
    assert run_of(w)[-3:] == [0, 1, 2]


def test_the_same_sample_again_does_not_end_a_run() -> None:
    """Linked routers may deliver each sample twice."""
    w = window()
    w.append(circle(10))
    away = replace(circle(10, 10), t=circle(10, 10).t + 3600 * 10**9)
    for k in range(RESYNC):
        assert w.append(away.take(np.array([k, k]))) == AppendReport(leaped=2)
    assert w.append(away.take(np.array([RESYNC, RESYNC]))) == AppendReport(1, repeated=1, resynced=1)


def test_of_samples_of_one_key_the_first_that_is_one_counts() -> None:
    w = window()
    w.append(circle(10))
    spoiled = circle(1, 10)
    spoiled.x[0, 0] = np.nan
    assert w.append(SampleBatch.join([spoiled, circle(1, 10)])) == AppendReport(1, not_finite=1)


def test_derived_columns_are_those_of_the_samples_in_whatever_order_they_came() -> None:
    rng = np.random.default_rng(7)
    batch = circle(300)
    flags = np.where(rng.random(300) < 0.05, int(StateFlag.NEW_TRAJECTORY), 0).astype(np.uint32)
    flags |= np.where(rng.random(300) < 0.1, int(StateFlag.INPUT_MISSING), 0).astype(np.uint32)
    batch = replace(batch, flags=flags).take(np.flatnonzero(rng.random(300) < 0.95))
    in_order, shuffled = window(), window()
    in_order.append(batch)
    order = np.arange(len(batch.t)) + rng.integers(0, 8, len(batch.t))
    for rows in np.array_split(np.argsort(order, kind="stable"), 60):
        shuffled.append(batch.take(rows))
    for w in (in_order, shuffled):
        columns, count = w.arrays(), int(w.count[0])
        places = np.arange(count - SIZE, count) % SIZE
        block = w.block(ALL)
        np.testing.assert_array_equal(columns.t[0, places], block.t[0])
        np.testing.assert_array_equal(columns.x[0, places], batch.x[-SIZE:])
        np.testing.assert_array_equal(columns.u[0, places], block.u[0])
        np.testing.assert_array_equal(columns.input_known[0, places], batch.flags[-SIZE:] & 1 == 0)
        seq, new = batch.seq[-SIZE:], batch.flags[-SIZE:] & 2 != 0
        linked = np.r_[False, (np.diff(seq) == 1) & ~new[1:]]
        np.testing.assert_array_equal(block.linked[0], linked)
        age = np.arange(SIZE)
        np.testing.assert_array_equal(np.minimum(columns.run[0, places], age), runs(linked[None])[0])
    assert int(in_order.count[0]) == len(batch.t)
    assert in_order.revision[0] == 0
    assert shuffled.revision[0] > 0


class Twin:
    """The samples of one vehicle in a list: the rules for stamps, one by one, for samples that come in order."""

    def __init__(self) -> None:
        self.held: list[tuple[int, int, int]] = []
        self.runs: list[int] = []
        self.refused: list[tuple[int, int, int]] = []

    def append(self, epoch: int, seq: int, t: int) -> str:
        if not self.held:
            return self.store(epoch, seq, t, "stored")
        before = self.held[-1]
        if before[0] != epoch:
            what = "stored" if t > before[2] else "leaped"
        elif t <= before[2]:
            what = "stopped" if t == before[2] else "backwards"
        else:
            what = "stored" if self.agree(before, (epoch, seq, t)) else "leaped"
        if what == "stored":
            return self.store(epoch, seq, t, what)
        if not self.refused or not self.agree(self.refused[-1], (epoch, seq, t)):
            self.refused = []
        if len(self.refused) == RESYNC:
            return self.store(epoch, seq, t, "resynced")
        self.refused.append((epoch, seq, t))
        return what

    @staticmethod
    def agree(one: tuple[int, int, int], two: tuple[int, int, int]) -> bool:
        lost, steps = two[1] - one[1], (two[2] - one[2]) / STEP
        return one[0] == two[0] and lost > 0 and steps > 0 and lost <= 10 + 10 * steps and steps <= 10 + 10 * lost

    def store(self, epoch: int, seq: int, t: int, what: str) -> str:
        follows = False
        if self.held:
            before = self.held[-1]
            follows = before[:2] == (epoch, seq - 1) and abs(t - before[2] - STEP) <= 0.25 * STEP
        self.runs.append(self.runs[-1] + 1 if follows else 0)
        self.held.append((epoch, seq, t))
        self.refused = []
        return what


@settings(max_examples=examples(100))
@given(
    st.lists(
        st.sampled_from(["next"] * 8 + ["again", "back", "ahead", "far", "late", "lost", "anew", "high"]), max_size=60
    )
)
def test_stamps_are_judged_as_by_the_twin(story: list[str]) -> None:
    w, twin = window(), Twin()
    epoch, seq, t = 1, 0, START
    for what in story:
        seq += {"lost": 2, "high": 25}.get(what, 1)
        t += {"again": 0, "back": -7 * STEP, "ahead": 15 * STEP, "far": 45 * STEP, "late": round(1.3 * STEP)}.get(
            what, STEP
        )
        if what == "anew":
            epoch, seq = epoch + 1, 0
        batch = circle(1, seq)
        found = w.append(replace(batch, epoch=np.array([epoch], dtype=np.uint64), t=np.array([t])))
        expected = twin.append(epoch, seq, t)
        assert (
            found
            == {
                "stored": AppendReport(1),
                "resynced": AppendReport(1, resynced=1),
                "backwards": AppendReport(backwards=1),
                "stopped": AppendReport(stopped=1),
                "leaped": AppendReport(leaped=1),
            }[expected]
        )
    assert w.keys(0) == [one[:2] for one in twin.held]
    held = len(twin.held)
    np.testing.assert_array_equal(w.arrays().run[0, :held], twin.runs)
    np.testing.assert_array_equal(w.arrays().t[0, :held], [one[2] for one in twin.held])


def test_places_and_revisions_follow_what_happens() -> None:
    w = window(vehicles=2)
    for k in range(SIZE + 5):
        w.append(circle(1, 2 * k))
    assert w.count.tolist()[:2] == [SIZE + 5, 0]
    assert w.arrays().t[0, (w.count[0] - 1) % SIZE] == w.newest(ALL)[2][0]
    newest = int((w.count[0] - 2) % SIZE)
    w.gate(np.array([0]), np.array([newest]))
    assert w.revision.tolist()[:2] == [1, 0]
    assert w.arrays().gated[0].sum() == 1
    w.append(circle(1, 2 * SIZE + 5))
    assert (int(w.revision[0]), int(w.count[0])) == (2, SIZE + 6)
    gated = np.flatnonzero(w.arrays().gated[0])
    assert w.arrays().t[0, gated].tolist() == [START + 2 * (SIZE + 3) * STEP], "the glitch stays where its sample is"
    assert w.append(circle(1)) == AppendReport(too_old=1)
    assert w.append(circle(1, 2 * SIZE + 5)) == AppendReport(repeated=1)
    assert int(w.revision[0]) == 2
    for k in range(SIZE):
        w.append(circle(1, 1000 + k))
    assert not w.arrays().gated.any()
    w.clear(0)
    assert (int(w.count[0]), int(w.revision[0])) == (0, 3)


def test_a_hundred_bytes_hold_a_sample() -> None:
    w = window(vehicles=1)
    w.append(circle(1))
    held = sum(column.nbytes for column in w._ring)
    assert held / SIZE <= 100
