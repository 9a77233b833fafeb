"""A fleet of classes: who belongs where, what is kept, refused and told, and which plan counts."""

import numpy as np
import pytest

from fleet_bus.errors import MessageError
from fleet_bus.messages import (
    EventKind,
    ScenarioDocument,
    StateBatch,
    StateFlag,
    VehicleProfile,
    parse_profile,
)
from reach_server.data.events import EngineEvent
from reach_server.service.ingest import VehicleBatch
from reach_server.service.sample_admission import PROFILE_PATIENCE
from reach_server.service.vehicle import MOST_KEPT
from tests.reach_server.drives import START, SVEA
from tests.reach_server.service.fleet_desk import NOW, SMALL, Desk, assignment, document, kinds


def test_a_vehicle_without_a_profile_is_told_once_and_served_when_it_comes() -> None:
    desk = Desk()
    assert not desk.process(desk.states("a", 0, 90), now=0.0).events
    # Under load a profile comes late; it is missing when samples have gone on without it for long.
    assert not desk.process(desk.states("a", 90, 99), now=PROFILE_PATIENCE).events
    outcome = desk.process(desk.states("a", 99, 100), now=PROFILE_PATIENCE + 0.1)
    assert kinds(outcome.events) == [EventKind.UNKNOWN_VEHICLE]
    assert "fleet/a/profile" in outcome.events[0].message
    assert not desk.process(desk.states("a", 100, NOW)).events
    assert not desk.fleet.window_keys("a")
    desk.fleet.set_profile("a", SMALL)
    assert set(desk.tubes(desk.states("a", NOW, NOW + 1))) == {"a"}
    assert desk.fleet.window_keys("a")[-1] == (1, NOW)
    assert len(desk.fleet.window_keys("a")) > 120
    assert not desk.refused


def test_samples_without_a_profile_are_kept_up_to_a_limit() -> None:
    desk = Desk()
    count = 400
    for start in range(0, MOST_KEPT + 2 * count, count):
        x = np.zeros((count, 4))
        desk.process(
            VehicleBatch(
                ("a",) * count,
                StateBatch(
                    np.arange(count), np.ones(count, dtype=np.uint64), np.arange(start, start + count, dtype=np.uint64),
                    START + np.arange(start, start + count), np.zeros(count, dtype=np.uint32), x, x[:, :2],
                    None, None, None,
                ),
            )
        )  # fmt: skip
    assert desk.refused == {"no_profile": 2 * count}


def test_a_wrong_shape_is_counted_and_told_once_and_other_samples_go_through() -> None:
    desk = Desk()
    desk.fleet.set_profile("a", SMALL)
    desk.fleet.set_profile("b", SMALL)
    short = desk.states("a", 0, 5, x=np.zeros((5, 3)))
    outcome = desk.process(short, desk.states("a", 5, 8), desk.states("b", 0, 4))
    assert kinds(outcome.events) == [EventKind.PROFILE_CONTRADICTED]
    assert "3 states" in outcome.events[0].message
    assert desk.refused == {"profile": 5}
    assert [seq for _, seq in desk.fleet.window_keys("a")] == [5, 6, 7]
    assert len(desk.fleet.window_keys("b")) == 4
    again = desk.process(desk.states("a", 8, 9, x=np.zeros((1, 3))))
    assert not again.events
    assert desk.refused == {"profile": 6}


def test_a_bound_beyond_the_stated_one_is_refused() -> None:
    desk = Desk()
    desk.fleet.set_profile("a", SMALL)
    assert SMALL.noise.measurement is not None
    stated = np.abs(SMALL.noise.measurement.matrix()).sum(axis=1)
    assert desk.process(desk.states("a", 0, 1, bound=stated[None])).stored == 1
    outcome = desk.process(desk.states("a", 1, 2, bound=1.01 * stated[None]))
    assert (outcome.stored, desk.refused) == (0, {"profile": 1})
    assert kinds(outcome.events) == [EventKind.PROFILE_CONTRADICTED]


def test_a_wrong_sample_interval_is_told_once() -> None:
    desk = Desk()
    desk.fleet.set_profile("a", SMALL)
    outcome = desk.process(desk.states("a", 0, 30, dt_ns=2 * SVEA.dt_ns))
    assert kinds(outcome.events) == [EventKind.PROFILE_CONTRADICTED]
    assert "every 0.1 s" in outcome.events[0].message
    assert not desk.process(desk.states("a", 30, 60, dt_ns=2 * SVEA.dt_ns)).events


def test_lost_samples_are_no_wrong_interval() -> None:
    desk = Desk()
    desk.fleet.set_profile("a", SMALL)
    batch = desk.states("a", 0, 60)
    rows = np.flatnonzero(np.arange(60) % 4 < 2)
    thinned = [desk.states("a", int(k), int(k) + 1) for k in rows]
    assert batch.states.x.shape == (60, 4)
    assert not desk.process(*thinned).events


@pytest.mark.parametrize(("flags", "told"), [(StateFlag.NONE, True), (StateFlag.INPUT_MISSING, False)])
def test_an_input_beyond_its_limits_is_told_once_unless_it_is_none(flags: StateFlag, told: bool) -> None:
    desk = Desk()
    spec = SMALL.model_dump(by_alias=True, exclude_none=True)
    spec["inputs"]["velocity"]["limits"] = [0.1, 1.7]
    desk.fleet.set_profile("a", parse_profile(spec))
    found = []
    for k in range(3):
        u = np.array([[0.0, 0.0]])
        found += desk.process(desk.states("a", k, k + 1, u=u, flags=flags)).events
    assert kinds(found) == [EventKind.PROFILE_CONTRADICTED] * told
    assert all("velocity" in event.message for event in found)


def test_a_profile_that_changes_in_flight_starts_an_empty_window_of_another_class() -> None:
    desk = Desk()
    other = SMALL.model_copy(update={"window": 130})
    desk.fleet.set_profile("a", SMALL)
    desk.fleet.set_profile("b", SMALL)
    desk.process(desk.states("a", 0, NOW), desk.states("b", 0, NOW))
    assert not desk.fleet.set_profile("a", SMALL)
    assert len(desk.fleet.window_keys("a")) > 120
    (told,) = desk.fleet.set_profile("a", other)
    assert told.kind == EventKind.PROFILE_CHANGED
    assert "window: 120 → 130" in told.message
    assert desk.fleet.profile_of("a") == other
    assert desk.fleet.window_keys("a") == []
    assert len(desk.fleet.engines) == 2
    outcome = desk.process(desk.states("a", NOW, NOW + 1), desk.states("b", NOW, NOW + 1))
    waiting = {vehicle: why for _, tubes in outcome.tubes for vehicle, why in tubes.waiting.items()}
    assert set(waiting) == {"a"}
    assert {v for _, tubes in outcome.tubes for v in tubes.vehicles} == {"b"}
    # Back in the first class it does not find the model that it left behind.
    desk.fleet.set_profile("a", SMALL)
    (result,) = [tubes for _, tubes in desk.process(desk.states("a", NOW + 1, NOW + 12)).tubes]
    assert "too few" in result.waiting["a"]


def test_the_plan_of_the_newest_sample_counts_and_no_older_one() -> None:
    desk = Desk()
    desk.fleet.set_profile("a", SMALL)
    desk.process(desk.states("a", 0, NOW))
    planned = desk.tubes(desk.states("a", NOW, NOW + 1, planned=True))["a"].area[0, -1]
    without = desk.tubes(desk.states("a", NOW + 1, NOW + 2))["a"].area[0, -1]
    assert planned < 0.3 * without
    # A planned sample that comes late, or beside a newer one without a plan, says nothing about what comes.
    mixed = desk.tubes(
        desk.states("a", NOW + 3, NOW + 4), desk.states("a", NOW + 2, NOW + 3, planned=True)
    )["a"].area[0, -1]  # fmt: skip
    assert mixed > 2 * planned
    desk.process(desk.states("a", NOW + 5, NOW + 6))
    late = desk.tubes(desk.states("a", NOW + 4, NOW + 5, planned=True))
    assert not late
    newest = desk.tubes(desk.states("a", NOW + 6, NOW + 7, planned=True))["a"].area[0, -1]
    assert newest < 0.5 * without


def test_a_plan_that_is_too_short_is_not_used() -> None:
    desk = Desk()
    desk.fleet.set_profile("a", SMALL.model_copy(update={"horizon": 12}))
    desk.process(desk.states("a", 0, NOW))
    planned = desk.tubes(desk.states("a", NOW, NOW + 1, planned=True))["a"]
    free = Desk()
    free.fleet.set_profile("a", SMALL.model_copy(update={"horizon": 12}))
    free.process(free.states("a", 0, NOW))
    np.testing.assert_allclose(planned.area, free.tubes(free.states("a", NOW, NOW + 1))["a"].area)


def test_repeated_samples_are_counted_and_make_no_tube() -> None:
    desk = Desk()
    desk.fleet.set_profile("a", SMALL)
    assert desk.process(desk.states("a", 0, NOW)).stored == NOW
    outcome = desk.process(desk.states("a", NOW - 50, NOW))
    assert (outcome.stored, outcome.repeated, outcome.tubes) == (0, 50, [])


def test_a_leap_is_counted_and_told_and_so_is_what_is_believed() -> None:
    desk = Desk()
    desk.fleet.set_profile("car", SMALL)
    desk.process(desk.states("car", 0, NOW))
    outcome = desk.process(desk.states("car", NOW, NOW + 1, dt_ns=20 * SVEA.dt_ns))
    assert desk.refused == {"leap": 1}
    assert kinds(outcome.events) == [EventKind.LEAP]
    outcome = desk.process(desk.states("car", NOW + 1, NOW + 6, dt_ns=20 * SVEA.dt_ns))
    assert desk.refused == {"leap": 3, "resynced": 1}
    assert kinds(outcome.events) == [EventKind.LEAP]
    assert outcome.events[0].details == {"believed": True}
    assert desk.fleet.window_keys("car")[-1] == (1, NOW + 5)


def test_stamps_that_do_not_advance_are_counted() -> None:
    desk = Desk()
    desk.fleet.set_profile("a", SMALL)
    desk.process(desk.states("a", 0, 10))
    desk.process(desk.states("a", 10, 12, dt_ns=1))
    assert desk.refused == {"range": 2}


def test_the_first_sample_of_the_newest_epoch_is_remembered() -> None:
    desk = Desk()
    assert desk.fleet.first_sample("a") is None
    desk.process(desk.states("a", 5, 8))
    assert desk.fleet.first_sample("a") == (1, 5)
    desk.process(desk.states("a", 3, 4))
    assert desk.fleet.first_sample("a") == (1, 3)
    later = desk.states("a", 9, 10)
    later.states.epoch[:] = 2
    desk.process(later, now=START / 1e9 + 60)
    assert desk.fleet.first_sample("a") == (2, 9)


@pytest.mark.parametrize("order", ["profile", "scenario", "assignment"])
def test_an_assignment_acts_once_profile_and_scenario_are_there(order: str) -> None:
    desk = Desk()
    steps = {
        "profile": lambda: desk.fleet.set_profile("a", SMALL),
        "scenario": lambda: desk.fleet.set_scenario(document(0.5)),
        "assignment": lambda: desk.fleet.assign(assignment()),
    }
    for name in sorted(steps, key=lambda name: name != order):
        assert steps[name]() == []
    desk.process(desk.states("a", 0, NOW))
    assert desk.tubes(desk.states("a", NOW, NOW + 1))["a"].cuts[0]
    desk.fleet.assign(assignment(active=False))
    assert not desk.tubes(desk.states("a", NOW + 1, NOW + 2))["a"].cuts[0]


def test_publishing_the_same_scenario_again_forgives_no_contradiction() -> None:
    desk = Desk()
    desk.fleet.set_profile("a", SMALL)
    desk.process(desk.states("a", 0, NOW))
    desk.fleet.set_scenario(document(0.02))
    desk.fleet.assign(assignment())
    found: list[EngineEvent] = []
    for k in range(NOW, NOW + 30):
        found += desk.process(desk.states("a", k, k + 1, planned=True)).events
    assert kinds(found) == [EventKind.CONTRADICTION]
    desk.fleet.set_scenario(document(0.02))
    assert not desk.process(desk.states("a", NOW + 30, NOW + 31, planned=True)).events
    # Another version may be true again, and is told about again.
    desk.fleet.set_scenario(document(0.02, version=2))
    assert kinds(desk.process(desk.states("a", NOW + 31, NOW + 32, planned=True)).events) == [EventKind.CONTRADICTION]


def test_a_scenario_that_does_not_fit_is_refused() -> None:
    desk = Desk()
    with pytest.raises(MessageError):
        desk.fleet.set_scenario(ScenarioDocument(scenario="box", version=1, text="no scenario"))
    with pytest.raises(MessageError, match="holds"):
        desk.fleet.set_scenario(document(1.0).model_copy(update={"version": 3}))
    desk.fleet.set_profile("a", VehicleProfile(**{**SMALL.model_dump(by_alias=True), "maps_to": {}}))
    desk.fleet.set_scenario(document(1.0))
    assert kinds(desk.fleet.assign(assignment())) == [EventKind.SCENARIO_REFUSED]
