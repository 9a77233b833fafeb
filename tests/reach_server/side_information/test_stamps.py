"""Scenarios at stamps that stray, are missing or went back: nothing is concluded that need not be so."""

import numpy as np
import pytest

from fleet_bus.messages import EventKind, ranges
from tests.reach_server.scenarios import scenario
from tests.reach_server.side_information.watched import OUTSIDE, START, S, Watched, box


def test_what_was_not_received_may_have_been_the_witness() -> None:
    text = "eventually[0:500 ms](x1 >= 1)"
    seen, missed = Watched(), Watched()
    for watched, samples in ((seen, range(5)), (missed, (0, 1, 2, 4))):
        watched.made.assign(0, scenario(text), START, 0.0)
        for k in samples:
            assert not watched.see(0, k / 10)
    (event,) = seen.see(0, 0.5)
    assert event.details["predicate"] == "x1 >= 1"
    assert not missed.see(0, 0.5)


def test_stamps_off_the_grid_weaken_windows_by_a_step() -> None:
    exact, jittering = Watched(), Watched()
    for watched in (exact, jittering):
        watched.made.assign(0, box(), START, 0.0)
        watched.see(0, 0.0)
    exact.see(0, 0.1)
    jittering.see(0, 0.13)
    assert exact.asked(0, 9) == [{"P.x1"}]
    assert jittering.asked(0, 9) == [set()]
    assert jittering.asked(0, 10) == [{"P.x1"}]
    assert exact.asked(0, 29) == [{"P.x1"}]
    assert jittering.asked(0, 28) == [{"P.x1"}]
    assert jittering.asked(0, 29) == [set()]


def test_what_was_measured_before_a_stamp_strayed_is_not_forgotten() -> None:
    for witness, told in ((1.5, 0), (0.0, 1)):
        watched = Watched()
        watched.made.assign(0, scenario("eventually[0:1 s](x1 >= 1)"), START, 0.0)
        watched.see(0, 0.0)
        watched.see(0, 0.1, [0.0, witness, 0.0])
        events = [event for k in range(2, 14) for event in watched.see(0, k / 10 + 0.01)]
        assert len(events) == told


def test_two_samples_at_one_place_are_asked_nothing() -> None:
    watched = Watched()
    watched.made.assign(0, scenario("always[0:3 s](x1 <= 2)"), START, 0.0)
    for seconds in (0.0, 0.06):
        assert not watched.see(0, seconds)
    assert not watched.see(0, 0.12, OUTSIDE)
    _, _, tested = watched.made.obligations(np.array([0]))
    assert not tested[0]
    assert watched.see(0, 0.2, OUTSIDE)


def test_a_clock_that_was_set_back_forgets_what_was_seen() -> None:
    watched = Watched()
    watched.made.assign(0, scenario("eventually[0:2 s](x1 >= 1)"), START, 0.0)
    for k in range(20):
        watched.see(0, k / 10)
    assert watched.asked(0) == [set()]
    watched.see(0, 1.0)
    assert watched.asked(0) == []
    assert not watched.see(0, 2.0)


def test_a_second_sample_at_the_last_place_of_a_window_may_be_the_witness() -> None:
    watched = Watched()
    watched.made.assign(0, scenario("eventually[0:540 ms](x1 >= 1)"), START, 0.0)
    for seconds in (0.0, 0.1, 0.2, 0.31, 0.385, 0.46):
        assert not watched.see(0, seconds)
    assert not watched.see(0, 0.53, [0.0, 1.0, 0.0])
    assert not watched.see(0, 0.6)
    assert not watched.see(0, 0.7)
    none = Watched()
    none.made.assign(0, scenario("eventually[0:540 ms](x1 >= 1)"), START, 0.0)
    events = [e for k in range(9) for e in none.see(0, k / 10 + 0.005)]
    assert len(events) == 1


def test_stamps_that_stray_in_a_block_are_judged_as_those_that_come_one_by_one() -> None:
    one, many = Watched(), Watched()
    for watched in (one, many):
        watched.made.assign(0, scenario("always[0:500 ms](x1 <= 1)"), START, 0.0)
    for k in range(9):
        seconds = k / 10 + (0.01 if k else 0.0)
        state = [0.0, 0.0 if seconds <= 0.5 else 5.0, 0.0]
        assert not one.see(0, seconds, state)
        many.sample(0, seconds, state)
    assert not many.look(0)


@pytest.mark.parametrize("late", [False, True])
def test_stamps_from_before_the_clock_was_set_back_say_nothing(late: bool) -> None:
    watched = Watched()
    side = scenario("always[3:9 s](x1 <= -1)")
    if not late:
        watched.made.assign(0, side, START, 0.0)
    for k in (*range(20), *range(31, 40)):
        watched.sample(0, k / 10, [0.0, -2.0 if k > 30 else 0.0, 0.0])
        if not late:
            assert not watched.look(0)
    if late:
        watched.made.assign(0, side, START, 0.0)
    for k in (20, 21, 22):
        assert not watched.see(0, k / 10)
        assert watched.asked(0) == [set()]


def test_a_stamp_that_strays_into_a_window_that_ends_between_samples_may_be_the_witness() -> None:
    watched = Watched()
    watched.made.assign(0, scenario("eventually[0:540 ms](x1 >= 1)"), START, 0.0)
    for k in range(6):
        assert not watched.see(0, k / 10)
    assert not watched.see(0, 0.53, [0.0, 1.0, 0.0])
    assert not watched.see(0, 0.6)


def test_of_a_received_sample_the_way_from_the_last_one_is_not_known() -> None:
    watched = Watched()
    watched.made.assign(0, scenario("eventually[0:1 s](x1 - last(x1) >= 0.1)"), START, 0.0)
    for k in range(14):
        assert not watched.see(0, k / 10, [0.0, 0.15 * k, 0.0])


def test_a_trajectory_that_begins_with_earlier_stamps_is_the_current_one() -> None:
    watched = Watched()
    watched.made.began(np.array([0]), np.array([START + 50 * S]), [(1, 0)])
    watched.made.began(np.array([0]), np.array([START + 10 * S]), [(2, 0)])
    watched.made.began(np.array([0]), np.array([START + 60 * S]), [(1, 7)])
    watched.made.assign(0, box(window="0:3 s"), START + 10 * S, 0.0)
    assert watched.see(0, 10.1, OUTSIDE)


@pytest.mark.parametrize("zero", [1, START, int(ranges.TIME.high)])
@pytest.mark.parametrize("t", [1, START, int(ranges.TIME.high)])
def test_any_time_zero_meets_any_stamp(zero: int, t: int) -> None:
    watched = Watched()
    watched.made.assign(0, box(window="0:3 s"), zero, 0.0)
    tracker = watched.made.tracker("box")
    # Nothing holds outside of the region: what is asked of a sample at time zero only is false there alone.
    watched.samples[0].append((t, OUTSIDE))
    told = watched.look(0)
    assert [event.kind for event in told] == [EventKind.CONTRADICTION] * (t == zero)
    assert tracker.started(np.array([0])).tolist() == [t >= zero]
