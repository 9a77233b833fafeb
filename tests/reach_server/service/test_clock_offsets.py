"""Clocks that are off are told, and scenarios that speak about a time of day wait for them."""

import numpy as np
import pytest

from fleet_bus.messages import Assignment, EventKind, ScenarioDocument, StateFlag
from reach_server.service.clock_offsets import CLOCK_BOUND, PERIOD, ClockOffset
from tests.reach_server.drives import START, SVEA, history
from tests.reach_server.service.fleet_desk import NOW, SMALL, Desk, kinds

HOUR = 3600.0


@pytest.mark.parametrize("offset", [0.0, 0.2, -0.7, HOUR, -HOUR])
def test_the_offset_is_that_of_the_fastest_message(offset: float) -> None:
    rng, clock = np.random.default_rng(0), ClockOffset()
    least = np.inf
    for k in range(1000):
        way = float(rng.exponential(0.05))
        least = min(least, way) if k > 800 else least
        clock.see(offset - way, k * 0.05)
    assert offset - 0.01 < clock.offset <= offset
    assert 0.1 < clock.spread < 1.0


def test_what_was_seen_long_ago_is_forgotten() -> None:
    clock = ClockOffset()
    clock.see(HOUR, 0.0)
    assert clock.crossed()
    for k in range(1, 100):
        clock.see(0.0, k * PERIOD / 10)
        if k * PERIOD / 10 > 2 * PERIOD + 1:
            assert clock.offset == 0.0
    assert clock.crossed()
    assert not clock.off


def test_nothing_is_told_inside_of_the_bound_and_each_crossing_once() -> None:
    clock, told = ClockOffset(), []
    for k, difference in enumerate([0.0, 0.9, 0.9, 1.1, 1.1, 0.9, 0.6, 0.4, 0.0]):
        clock.see(difference, k * 3 * PERIOD)
        told.append(clock.crossed())
    assert [k for k, crossed in enumerate(told) if crossed] == [3, 7]


def fixed(desk: Desk) -> None:
    """A scenario whose time zero is a time of day."""
    here = history(0).truth[NOW, :2]
    low, high = here - 0.5, here + 0.5
    zero = np.datetime64(START + NOW * SVEA.dt_ns, "ns").astype("datetime64[ms]")
    text = (
        f"scenario: dated\nversion: 1\nstate: {{x1: m, x2: m}}\ntime: {{zero: {zero}Z, semantics: sampled}}\n"
        f"regions: {{P: {{box: {{x1: [{low[0]}, {high[0]}], x2: [{low[1]}, {high[1]}]}}}}}}\n"
        "assume: always[0:100 s](P)\n"
    )
    desk.fleet.set_scenario(ScenarioDocument(scenario="dated", version=1, text=text))
    desk.fleet.assign(Assignment(scenario="dated", vehicle="a", time_zero=START + NOW * SVEA.dt_ns))


@pytest.mark.parametrize(("ahead", "told"), [(HOUR, 1), (-HOUR, 1), (2 * CLOCK_BOUND, 1), (CLOCK_BOUND / 2, 0)])
def test_a_clock_off_its_bound_is_told_and_noted_and_a_dated_scenario_does_not_cut(ahead: float, told: int) -> None:
    desk = Desk()
    desk.fleet.set_profile("a", SMALL)
    fixed(desk)
    desk.process(desk.states("a", 0, NOW, late=-ahead), now=0.0)
    outcome = desk.process(desk.states("a", NOW, NOW + 1, late=-ahead), now=0.1)
    ((_, tubes),) = outcome.tubes
    assert bool(tubes.cuts[0]) == (not told)
    assert any("clock off" in note for note in tubes.notes[0]) == bool(told)
    offset, _ = desk.fleet.clock_offsets()["a"]
    assert offset == pytest.approx(ahead)
    # Set right again: told, no note, and the scenario cuts.
    if told:
        after = desk.process(desk.states("a", NOW + 1, NOW + 2, late=0.0), now=0.1 + 3 * PERIOD)
        assert EventKind.CLOCK in kinds(after.events)
        ((_, tubes),) = after.tubes
        assert tubes.cuts[0]
        assert not any("clock" in note for note in tubes.notes[0])


def test_what_was_recorded_before_says_nothing_about_a_clock() -> None:
    desk = Desk()
    desk.fleet.set_profile("a", SMALL)
    outcome = desk.process(desk.states("a", 0, NOW, late=HOUR, flags=StateFlag.HISTORY), now=0.0)
    assert kinds(outcome.events) == []
    assert desk.fleet.clock_offsets() == {}
