"""Which scenario asks what of which vehicle, from when on, and until it turns out to be false."""

import numpy as np
import pytest

from fleet_bus.messages import Cut, EventKind
from reach_server.numeric.types import FloatArray
from reach_server.side_information.scenarios import Assignments, InitialConditions
from side_info import Scenario, ScenarioError
from side_info.progression import TRUE
from tests.reach_server.scenarios import DISC, PROFILE, scenario
from tests.reach_server.side_information.watched import NOISE, OUTSIDE, START, STEP, S, Watched, box


def test_time_counts_from_the_time_zero_of_each_vehicle() -> None:
    watched = Watched(3)
    watched.made.assign(0, box(), START, 0.0)
    watched.made.assign(1, box(), START + S, 0.0)
    watched.made.assign(2, box(), START, 0.25)
    for slot in range(3):
        watched.see(slot, 0.5)
    # 1 s is five samples ahead for the first, 2 s fifteen for the second; the third keeps clear by its slack.
    for slot, first, last in ((0, 5, 25), (1, 15, 35), (2, 8, 22)):
        assert watched.asked(slot, first - 1) == [set()]
        assert watched.asked(slot, first) == [{"P.x1"}]
        assert watched.asked(slot, last) == [{"P.x1"}]
        assert watched.asked(slot, last + 1) == [set()]


def test_nothing_is_asked_before_the_first_sample_and_of_others() -> None:
    watched = Watched(2)
    watched.made.assign(0, box(window="0:3 s"), START, 0.0)
    rows, obligations, _ = watched.made.obligations(np.array([0, 1]))
    assert not len(rows)
    watched.see(0, 0.0)
    rows, obligations, tested = watched.made.obligations(np.array([1, 0]))
    assert rows.tolist() == [1]
    assert obligations[0] != TRUE
    assert tested.all()


def test_scenarios_add_up_and_can_be_taken_back() -> None:
    watched = Watched()
    watched.made.assign(0, box(window="0:3 s"), START, 0.0)
    watched.made.assign(0, scenario("always[0:9 s](ring)", DISC, "ring"), START, 0.0)
    watched.see(0, 0.0, [0.0, 0.3, -2.0])
    assert watched.asked(0) == [{"P.x1", "ring"}]
    watched.made.unassign(0, "box")
    assert watched.asked(0) == [{"ring"}]
    watched.made.unassign(0, "never assigned")


def test_a_vehicle_that_leaves_is_told_at_that_sample_and_once() -> None:
    watched = Watched(2)
    for slot in (0, 1):
        watched.made.assign(slot, box(), START, 0.0)
        watched.made.assign(slot, box("other", "2:3 s"), START, 0.0)
        for k in range(16):
            assert not watched.see(slot, k / 10)
    (event,) = watched.see(0, 1.6, OUTSIDE)
    assert event.kind is EventKind.CONTRADICTION
    assert event.details == {"scenario": "box", "predicate": "P.x1", "elapsed": 1.6}
    assert event.t == START + 16 * STEP
    assert not watched.see(0, 1.7, OUTSIDE)
    assert watched.made.contradicted() == {0}
    # The other scenario and the other vehicle are not touched.
    assert watched.asked(0, 3) == [{"P.x1"}]
    assert watched.asked(1, 0) == [{"P.x1"}]


def test_what_lies_within_the_measurement_noise_is_no_contradiction() -> None:
    watched = Watched()
    watched.made.assign(0, box(window="0:3 s"), START, 0.0)
    assert not watched.see(0, 0.0, [0.0, 2.0099, 0.0])
    assert watched.see(0, 0.1, [0.0, 2.0101, 0.0])


def test_without_a_bound_of_the_noise_nothing_is_contradicted() -> None:
    watched = Watched(received=None)
    watched.made.assign(0, box(window="0:3 s"), START, 0.0)
    assert not watched.see(0, 0.0, OUTSIDE)


def test_many_samples_at_once_are_the_same_as_one_by_one() -> None:
    one, many = Watched(), Watched()
    text = "eventually[0:2 s](x1 >= 1) and always[1:3 s](x1 <= 5)"
    for watched in (one, many):
        watched.made.assign(0, scenario(text), START, 0.0)
    for k in range(15):
        state = [0.0, 1.5 if k == 7 else 0.0, 0.0]
        one.see(0, k / 10, state)
        many.sample(0, k / 10, state)
    many.look(0)
    assert one.asked(0, 3) == many.asked(0, 3) == [{"x1 <= 5"}]
    late = Watched()
    late.samples = many.samples
    late.made.assign(0, scenario(text), START, 0.0)
    late.look(0)
    assert late.asked(0, 3) == [{"x1 <= 5"}]


def test_a_scenario_that_begins_with_the_vehicle_ends_with_its_trajectory() -> None:
    watched = Watched()
    watched.made.assign(0, box(window="0:3 s"), START, 0.0)
    watched.see(0, 0.0)
    watched.made.began(np.array([0]), np.array([START + STEP]), [(1, 2)])
    assert not watched.see(0, 0.1, OUTSIDE)
    assert watched.asked(0) == []
    watched.made.assign(0, box(window="0:3 s"), START + STEP, 0.0)
    assert watched.see(0, 0.2, OUTSIDE)


def test_time_zero_to_come_is_seen_by_the_tube() -> None:
    watched = Watched()
    watched.made.assign(0, box(window="0:3 s"), START + 5 * STEP, 0.0)
    watched.see(0, 0.0)
    assert watched.asked(0, 4) == [set()]
    assert watched.asked(0, 5) == [{"P.x1"}]


def test_the_same_assignment_again_forgives_nothing_another_one_does() -> None:
    watched, document = Watched(2), box(window="0:3 s")
    made = watched.made
    made.assign(0, document, START, 0.0)
    watched.see(0, 0.0, OUTSIDE)
    made.assign(0, document, START, 0.0)
    made.assign(1, document, START, 0.0)
    assert made.contradicted() == {0}
    made.assign(0, document, START + S, 0.0)
    assert not made.contradicted()
    watched.see(0, 0.9)
    assert made.contradict(0, "car-0", START, None)
    # Another document of the same name takes the place of the first, for every vehicle.
    made.assign(1, box(window="0:4 s"), START, 0.0)
    assert not made.contradicted()
    watched.see(0, 1.0)
    assert watched.asked(0, 40) == [{"P.x1"}]


def test_a_miss_that_no_predicate_explains_ends_all_scenarios() -> None:
    watched = Watched()
    for name in ("box", "other"):
        watched.made.assign(0, box(name), START, 0.0)
    watched.made.assign(0, box("over", "0:100 ms"), START - S, 0.0)
    watched.made.assign(0, box("to-come"), START + 90 * S, 0.0)
    watched.see(0, 0.5)
    events = watched.made.contradict(0, "car-0", START, None)
    assert [event.details["scenario"] for event in events] == ["box", "other"]
    assert not watched.made.contradict(0, "car-0", START, None)


def test_states_that_the_profile_does_not_have_are_refused() -> None:
    made = Assignments(PROFILE.model_copy(update={"maps_to": {}}), np.zeros((3, 0)), NOISE)
    with pytest.raises(ScenarioError, match="maps_to"):
        made.assign(0, box(), START, 0.0)


def test_cuts_are_described_by_their_first_and_last_step() -> None:
    watched = Watched()
    watched.made.assign(0, box(), START, 0.0)
    watched.see(0, 0.0)
    acted = np.zeros((2, 5, watched.made.literals.count), dtype=bool)
    acted[0, [1, 3], 0] = True
    assert watched.made.describe(acted) == ((Cut("box", "P.x1", 2, 4),), ())


MONITORED = """
scenario: m
version: 1
state: {x1: m, x2: m}
time: {zero: on_start, semantics: sampled}
assume: "always[0:9 s](x2 <= 100)"
monitor:
  stays: "always[0:300 ms](x1 <= 1)"
  comes: "eventually[0:2 s](x1 >= 5)"
"""


def verdicts(watched: Watched, x1: FloatArray, half: float, t: int) -> dict[str, str]:
    """On boxes around (0, x1, 0) at coming steps."""
    instants = InitialConditions(np.array([0]), np.array([t]), np.zeros((1, 3)), np.zeros((1, 3)))
    sets = [(np.array([[0.0, x, 0.0]]), half * np.eye(3)[None]) for x in x1]
    return dict(watched.made.verdicts(instants, sets)[0])


def test_verdicts_say_what_is_certain_and_why_the_rest_is_not() -> None:
    watched = Watched()
    watched.made.assign(0, Scenario.parse(MONITORED), START, 0.0)
    watched.see(0, 0.0)
    still = np.zeros(5)
    assert verdicts(watched, still, 0.1, START) == {
        "m.stays": "satisfied", "m.comes": "undecided (time)",
    }  # fmt: skip
    wide = verdicts(watched, still, 2.0, START)
    assert wide["m.stays"] == "undecided (size), may be violated at step 1"
    assert verdicts(watched, still + 3, 0.1, START)["m.stays"] == "violated"
    assert verdicts(watched, np.array([0.0, 0.0, 6.0, 0.0, 0.0]), 0.5, START)["m.comes"] == "satisfied"
    watched.see(0, 0.1, [0.0, 3.0, 0.0])
    assert verdicts(watched, still, 0.1, START + STEP)["m.stays"] == "violated"


def test_verdicts_do_not_depend_on_the_side_information_being_true() -> None:
    watched = Watched()
    watched.made.assign(0, Scenario.parse(MONITORED), START, 0.0)
    assert watched.see(0, 0.0, [0.0, 0.0, 200.0])
    assert verdicts(watched, np.zeros(5), 0.1, START)["m.stays"] == "satisfied"


def test_only_what_is_needed_for_the_contradiction_is_named() -> None:
    watched = Watched()
    watched.made.assign(0, scenario("always[0:5 s](x1 <= 1) and eventually[0:5 s](x1 >= 3)"), START, 0.0)
    (event,) = watched.see(0, 0.0, [0.0, 2.0, 0.0])
    assert event.details["predicate"] == "x1 <= 1"


def test_what_no_vehicle_has_any_more_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    text = "always[0:90 s](x1 <= 2) and eventually[0:4 s](x1 >= 1) and always[5:9 s](eventually[0:1 s](x1 <= 1))"
    plain, forgetful = Watched(2), Watched(2)
    sizes = []
    for watched, most in ((plain, 10**6), (forgetful, 40)):
        monkeypatch.setattr("reach_server.side_information.scenarios.MOST_OBLIGATIONS", most)
        for slot in (0, 1):
            watched.made.assign(slot, scenario(text), START + slot * STEP, 0.0)
        for k in range(130):
            for slot in (0, 1):
                events = watched.see(slot, k / 10, [0.0, 1.5 if 20 < k < 60 else 0.0, 0.0])
                assert not events
        sizes.append(len(watched.made.table))
        assert watched.asked(0, 5) == [{"x1 <= 2"}]
    assert sizes[1] < 150 < sizes[0]
    monkeypatch.undo()
    for watched in (plain, forgetful):
        assert watched.see(0, 13.0, OUTSIDE)
