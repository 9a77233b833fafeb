"""Which scenario cuts which vehicle, from when on, and until it turns out to be false."""

import numpy as np

from fleet_bus.messages import Cut, EventKind
from reach_server.assignments import Assignments
from side_info import Scenario
from tests.reach_server.test_predicates import DISC, PROFILE, scenario

S = 10**9
START = 10**18


def box(name: str = "box", window: str = "1:3 s") -> Scenario:
    return scenario(f"always[{window}](P)", "{P: {box: {x1: [-1, 2]}}}", name)


def at(*seconds: float) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    return START + np.array([round(s * S) for s in seconds], dtype=np.int64)


def test_time_counts_from_the_time_zero_of_each_vehicle() -> None:
    made = Assignments(PROFILE)
    made.assign(0, box(), START, 0.0)
    made.assign(2, box(), START + S, 0.0)
    made.assign(3, box(), START, 0.6)
    times = np.stack([at(1, 2, 3, 4)] * 4)
    active = made.active(np.array([0, 1, 2, 3]), times)[..., 0]
    np.testing.assert_array_equal(
        active, [[True, True, True, False], [False] * 4, [False, True, True, True], [False, True, False, False]]
    )
    # Rows follow the slots asked for.
    np.testing.assert_array_equal(made.active(np.array([2, 0]), times[:2])[..., 0], active[[2, 0]])


def test_scenarios_add_up_and_can_be_taken_back() -> None:
    made = Assignments(PROFILE)
    made.assign(0, box(), START, 0.0)
    made.assign(0, scenario("always[0:9 s](ring)", DISC, "ring"), START, 0.0)
    assert made.table.count == 9
    assert made.active(np.array([0]), at(2)[None]).sum() == 9
    made.unassign(0, "box")
    assert made.active(np.array([0]), at(2)[None]).sum() == 8
    made.unassign(0, "never assigned")


def test_a_contradicted_scenario_cuts_no_more_and_is_told_once() -> None:
    made = Assignments(PROFILE)
    for slot in (0, 1):
        made.assign(slot, box(), START, 0.0)
        made.assign(slot, box("other"), START, 0.0)
    empty = np.zeros((3, made.table.count), dtype=bool)
    empty[1, made.table.scenario.index("other")] = True
    events = made.contradict(0, "car", int(at(2)[0]), empty)
    assert [event.kind for event in events] == [EventKind.CONTRADICTION]
    assert events[0].details == {"scenario": "other", "predicate": "P.x1", "elapsed": 2.0}
    assert not made.contradict(0, "car", int(at(2)[0]), empty)
    active = made.active(np.array([0, 1]), np.stack([at(2), at(2)]))[:, 0]
    of_box = np.array([owner == "box" for owner in made.table.scenario])
    np.testing.assert_array_equal(active[0], of_box)
    assert active[1].all()
    assert 0 in made.contradicted()
    assert 1 not in made.contradicted()
    # A miss that no single predicate explains ends all of the vehicle's scenarios.
    assert [event.details["scenario"] for event in made.contradict(1, "car", int(at(2)[0]), None)] == ["box", "other"]


def test_the_same_assignment_again_forgives_nothing_another_one_does() -> None:
    made, document = Assignments(PROFILE), box()
    made.assign(0, document, START, 0.0)
    made.contradict(0, "car", START, None)
    made.assign(0, document, START, 0.0)
    assert 0 in made.contradicted()
    made.assign(1, document, START, 0.0)
    assert 0 in made.contradicted()
    made.assign(0, document, START + S, 0.0)
    assert 0 not in made.contradicted()
    made.contradict(0, "car", START, None)
    made.assign(1, box(window="1:4 s"), START, 0.0)
    assert 0 not in made.contradicted()


def test_cuts_are_described_by_their_first_and_last_step() -> None:
    made = Assignments(PROFILE)
    made.assign(0, box(), START, 0.0)
    cut = np.zeros((2, 5, made.table.count), dtype=bool)
    cut[0, [1, 3], 0] = True
    assert made.describe(np.array([0, 1]), cut) == ((Cut("box", "P.x1", 2, 4),), ())
