"""What has gone is let go of: vehicles, classes, and ids that never had a profile; and what is wrong with one vehicle
stops no other one's."""

import gc
import tracemalloc

import numpy as np
import pytest

from fleet_bus.errors import MessageError, ScenarioError
from fleet_bus.messages import EventKind, VehicleProfile
from reach_server.engine.engine import Engine
from reach_server.service import registry
from reach_server.service.registry import LEAST_SILENT_KEPT, LET_GO, SILENT
from reach_server.service.sample_admission import MOST_UNKNOWN
from tests.reach_server.service.fleet_desk import NOW, SMALL, Desk, assignment, document, kinds

TINY = SMALL.model_copy(update={"window": 40})


def test_silent_vehicles_beyond_a_number_are_let_go_and_their_slots_serve_again() -> None:
    desk = Desk()
    desk.fleet.set_profile("lives", TINY)
    for k in range(300):
        name, now = f"v{k}", 40.0 * k
        desk.fleet.set_profile(name, TINY, now=now)
        desk.process(desk.states(name, 0, 3), desk.states("lives", k, k + 1), now=now)
        desk.fleet.let_go(now)
        # The newest may not have been silent for long enough.
        assert len(desk.fleet.vehicles) <= LEAST_SILENT_KEPT + 2
    (engine,) = desk.fleet.engines
    assert len(engine.vehicles) <= LEAST_SILENT_KEPT + 3
    assert engine.count == len(desk.fleet.vehicles)
    assert engine.window_filled().tolist().count(3) == engine.count - 1


@pytest.mark.slow
def test_two_thousand_ids_come_and_go_in_little_memory() -> None:
    desk = Desk()
    desk.fleet.set_profile("lives", SMALL)
    held = []
    tracemalloc.start()
    for k in range(2000):
        now = 2.0 * k
        desk.fleet.set_profile(f"v{k}", SMALL, now=now)
        desk.process(
            desk.states(f"v{k}", 0, 3), *([] if k % 10 else [desk.states("lives", k // 10, k // 10 + 1)]), now=now
        )
        desk.fleet.mark_gone(f"v{k - 2}")
        desk.fleet.let_go(now)
        if k % 100 == 0:
            gc.collect()
            held.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert len(desk.fleet.vehicles) <= LEAST_SILENT_KEPT + 4
    # What the first few ids took stays, and serves those that come after them.
    assert (held[-1] - held[1]) / 1900 < 100
    assert (held[-1] - held[0]) / 2000 < 5000


def test_silent_vehicles_are_let_go_after_a_time_and_live_ones_never() -> None:
    desk = Desk()
    for name in "ab":
        desk.fleet.set_profile(name, TINY)
    desk.process(desk.states("a", 0, 3), desk.states("b", 0, 3), now=0.0)
    for now in np.arange(0.0, LET_GO + 100.0, 20.0):
        desk.process(desk.states("b", int(now) // 2, int(now) // 2 + 1), now=now)
        gone = desk.fleet.let_go(now)
        assert gone == (["a"] if now - 20.0 <= LET_GO < now else [])
    assert desk.fleet.vehicles == ("b",)


def test_while_the_network_is_away_no_vehicle_is_let_go_for_its_number() -> None:
    desk = Desk()
    names = [f"v{k}" for k in range(3 * LEAST_SILENT_KEPT)]
    for name in names:
        desk.fleet.set_profile(name, TINY)
        desk.process(desk.states(name, 0, 3), now=0.0)
    assert desk.fleet.let_go(10 * SILENT) == []
    assert len(desk.fleet.let_go(LET_GO + 1)) == len(names)
    assert desk.fleet.engines == ()


def test_a_slot_that_serves_again_knows_nothing_of_the_vehicle_before() -> None:
    used, fresh = Desk(), Desk()
    used.fleet.set_profile("before", SMALL)
    used.fleet.set_scenario(document(0.02))
    used.fleet.assign(assignment().model_copy(update={"vehicle": "before"}))
    used.process(used.states("before", 0, NOW + 20), now=0.0)
    used.fleet.set_profile("lives", SMALL)
    used.process(used.states("lives", 0, 1), now=LET_GO + 1)
    assert used.fleet.let_go(LET_GO + 1) == ["before"]
    assert len(used.fleet.engines[0].vehicles) == 2
    areas = []
    for desk in (used, fresh):
        desk.fleet.set_profile("a", SMALL)
        desk.process(desk.states("a", 0, NOW), now=LET_GO + 2)
        tubes = desk.tubes(desk.states("a", NOW, NOW + 1, planned=True))["a"]
        row = tubes.vehicles.index("a")
        areas.append((tubes.area[row], tubes.labels[row], tubes.cuts[row], tubes.notes[row]))
    np.testing.assert_array_equal(areas[0][0], areas[1][0])
    assert areas[0][1:] == areas[1][1:]
    assert len(used.fleet.engines[0].vehicles) == 2


def test_many_profiles_of_one_vehicle_leave_one_class() -> None:
    desk = Desk()
    desk.fleet.set_profile("a", TINY)
    desk.process(desk.states("a", 0, 5))
    for window in range(41, 100):
        desk.fleet.set_profile("a", TINY.model_copy(update={"window": window}))
    assert len(desk.fleet.engines) == 1


def test_a_profile_without_states_takes_no_place_in_a_class() -> None:
    desk = Desk()
    for k in range(50):
        desk.fleet.set_profile(f"v{k}", TINY)
    assert desk.fleet.engines == ()


def test_ids_without_a_profile_are_bounded_counted_and_let_go() -> None:
    desk = Desk()
    for k in range(MOST_UNKNOWN + 50):
        desk.process(desk.states(f"v{k}", 0, 1), now=0.0)
    assert desk.refused == {"no_profile": 50}
    desk.fleet.let_go(LET_GO + 1)
    assert desk.fleet.vehicles == ()


def test_the_number_of_vehicles_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "MOST_VEHICLES", 3)
    desk = Desk()
    for k in range(5):
        desk.process(desk.states(f"v{k}", 0, 2))
    with pytest.raises(MessageError, match="overflow"):
        desk.fleet.set_profile("v9", TINY)
    assert (len(desk.fleet.vehicles), desk.refused) == (3, {"overflow": 4})


@pytest.mark.parametrize("error", [ScenarioError("does not fit"), OverflowError("too large"), ValueError("odd")])
def test_what_is_wrong_with_one_vehicle_stops_no_other_and_leaves_no_old_scenario(
    monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    desk = Desk()
    for name in "abc":
        desk.fleet.set_profile(name, SMALL)
        desk.process(desk.states(name, 0, NOW))
    desk.fleet.set_scenario(document(0.5))
    for name in "abc":
        desk.fleet.assign(assignment().model_copy(update={"vehicle": name}))
    assign = Engine.assign

    def fail_for_b(engine: Engine, vehicle: str, *arguments: object) -> None:
        if vehicle == "b":
            raise error
        assign(engine, vehicle, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(Engine, "assign", fail_for_b)
    events = desk.fleet.set_scenario(document(0.4, version=2))
    assert kinds(events) == [EventKind.SCENARIO_REFUSED]
    assert events[0].vehicle == "b"
    tubes = desk.tubes(*(desk.states(name, NOW, NOW + 1) for name in "abc"))
    cut = {name: bool(tubes[name].cuts[tubes[name].vehicles.index(name)]) for name in "abc"}
    assert cut == {"a": True, "b": False, "c": True}


def test_a_profile_that_no_engine_can_be_made_for_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    desk = Desk()
    desk.fleet.set_profile("a", SMALL)
    desk.process(desk.states("a", 0, NOW))
    held = desk.fleet.window_keys("a")

    def fail(profile: VehicleProfile) -> Engine:
        raise MemoryError("no room")

    monkeypatch.setattr(registry, "Engine", fail)
    with pytest.raises(MessageError, match="no room"):
        desk.fleet.set_profile("a", SMALL.model_copy(update={"window": 100}))
    assert desk.fleet.profile_of("a") == SMALL
    assert desk.fleet.window_keys("a") == held
