"""What a view tells of vehicles and services, from messages and a clock alone."""

import math
from dataclasses import replace

import numpy as np
import pytest

from fleet_bus import keys
from fleet_bus.errors import MessageError
from fleet_bus.messages import Audit, EventKind, Label
from fleet_view import SORTS, FleetView, VehicleRow
from fleet_view.snapshot import Condition
from fleet_view.view import REFUTED, natural
from tests.fleet_bus.messages.examples import T0, a_profile, a_tube
from tests.fleet_view.messages import Fleet


def row(fleet: Fleet, vehicle: str = "svea1") -> VehicleRow:
    snapshot = fleet.view.snapshot(fleet.now)
    return snapshot.row(snapshot.names.index(vehicle))


def ordered(fleet: Fleet, by: str) -> list[str]:
    snapshot = fleet.view.snapshot(fleet.now)
    return [snapshot.names[i] for i in snapshot.order(snapshot.select(None), by).tolist()]


def test_a_vehicle_as_its_newest_tube_says() -> None:
    fleet = Fleet()
    fleet.sample()
    fleet.tube(seq=6)
    fleet.wait(0.5)
    tube = fleet.tube(area=np.array([1.0, 2.0, 3.0]), area_free=np.array([1.0, 2.0, 4.0]))
    fleet.wait(0.25)
    found = row(fleet)
    assert found.condition is Condition.GUARANTEED
    assert found.label is Label.GUARANTEED
    assert (found.sample_age, found.tube_age, found.age) == (0.75, 0.25, 0.25)
    assert (found.area, found.area_free) == (3.0, 4.0)
    assert (found.checked, found.inside, found.recent, found.recent_inside, found.band) == (10, 9, 10, 9, 3)
    assert found.coverage == 0.9
    assert found.nominal == 1.0
    assert found.server == "reach-1"
    assert found.why == "rank deficient"
    assert not found.stale
    newest = fleet.view.newest_tube("svea1")
    assert newest is not None
    assert newest.seq == tube.seq == 7
    assert fleet.view.newest_tube("nobody") is None


def test_the_nominal_coverage_is_that_of_the_label() -> None:
    fleet = Fleet()
    fleet.tube(label=Label.CALIBRATED)
    assert row(fleet).nominal is None
    fleet.profile(profile=a_profile().model_copy(update={"confidence": 0.95}))
    assert row(fleet).nominal == 0.95
    fleet.tube(label=Label.GUARANTEED)
    assert row(fleet).nominal == 1.0


@pytest.mark.parametrize(("seconds", "stale"), [(2.9, False), (3.1, True)])
def test_a_vehicle_without_new_tubes_is_stale(seconds: float, stale: bool) -> None:
    fleet = Fleet()
    fleet.tube()
    fleet.wait(seconds)
    fleet.sample()
    assert row(fleet).stale is stale
    assert row(fleet).condition is (Condition.STALE if stale else Condition.GUARANTEED)


def test_a_slow_vehicle_is_stale_after_three_of_its_samples() -> None:
    fleet = Fleet()
    fleet.profile(profile=a_profile().model_copy(update={"sample_time": 5.0}))
    fleet.tube()
    fleet.wait(14.0)
    assert not row(fleet).stale
    fleet.wait(2.0)
    assert row(fleet).stale


def test_who_is_silent_is_said() -> None:
    fleet = Fleet()
    fleet.status()
    fleet.sample()
    fleet.tube()
    fleet.wait(5.0)
    fleet.status()
    assert row(fleet).why.startswith("no samples come")
    fleet.sample()
    assert row(fleet).why.startswith("samples come, no tube of reach-1")
    fleet.wait(3.5)
    fleet.sample()
    assert row(fleet).why.startswith("server reach-1 is silent")


def test_why_a_vehicle_waits_is_what_a_server_that_is_up_says() -> None:
    fleet = Fleet()
    fleet.sample()
    assert row(fleet).why == "no tube: no reach server is up"
    assert row(fleet).condition is Condition.WAITING
    fleet.status()
    assert row(fleet).why == "no tube yet"
    fleet.status(waiting={"svea1": "no profile has come"})
    assert row(fleet).why == "waits: no profile has come"
    # The server is gone, and with it what it said.
    fleet.wait(3.5)
    fleet.sample()
    assert row(fleet).why == "no tube: no reach server is up"
    fleet.status(waiting={"svea1": "no profile has come"})
    fleet.tube(notes=())
    assert row(fleet).why == ""
    assert row(fleet).condition is Condition.GUARANTEED
    fleet.wait(1.0)
    fleet.status(waiting={"svea1": "its samples leap"})
    assert row(fleet).why == "waits: its samples leap"
    fleet.status()
    assert row(fleet).condition is Condition.GUARANTEED


def test_a_waiting_vehicle_is_there_before_anything_else_of_it_comes() -> None:
    fleet = Fleet()
    fleet.status(waiting={"car": "no profile has come"})
    fleet.status("side-info-1", kind="side-info")
    found = row(fleet, "car")
    assert (found.label, found.tube_age, found.area, found.coverage, found.server) == (None,) * 5
    assert found.condition is Condition.WAITING


def test_a_refuted_vehicle_comes_first_with_the_event_that_told_so() -> None:
    fleet = Fleet()
    fleet.tube("a", label=Label.CONTRADICTED)
    fleet.tube("b", notes=(REFUTED,))
    fleet.event("a", kind=EventKind.JUMP)
    fleet.event("b", kind=EventKind.CONTRADICTION, message="left the lot")
    assert row(fleet, "a").why == "rank deficient"
    fleet.event("a", kind=EventKind.MISS, message="lay outside")
    assert row(fleet, "a").condition is row(fleet, "b").condition is Condition.CONTRADICTED
    assert row(fleet, "a").why == "miss: lay outside; rank deficient"
    assert row(fleet, "b").why == f"contradiction: left the lot; {REFUTED}"
    details: dict[str, str | int | float | bool] = {"scenario": "lot", "predicate": "P.x1, P.x2"}
    fleet.event("b", kind=EventKind.CONTRADICTION, details=details)
    assert row(fleet, "b").why.startswith("contradiction: lot (P.x1, P.x2); ")
    fleet.event("b", kind=EventKind.CONTRADICTION, details={"scenario": "lot", "predicate": ""})
    assert row(fleet, "b").why.startswith("contradiction: lot; ")
    # A tube without the note: it has come back.
    fleet.tube("b", notes=())
    assert row(fleet, "b").condition is Condition.GUARANTEED
    assert row(fleet, "b").why == ""


def test_more_misses_than_the_band_allows_are_said() -> None:
    fleet = Fleet()
    fleet.tube("a", audit=Audit(100, 96, 0.1, 100, 96, 4), notes=())
    fleet.tube("b", audit=Audit(100, 95, 0.1, 100, 95, 4), notes=())
    assert row(fleet, "a").condition is Condition.GUARANTEED
    assert row(fleet, "b").condition is Condition.OUT_OF_BAND
    assert row(fleet, "b").why == "5 of 100 missed, 4 are explained"


def test_orders() -> None:
    fleet = Fleet()
    fleet.tube("car10", area=np.array([1.0] * 3), audit=Audit(10, 9, 0.1, 10, 9, 3))
    fleet.wait(1.0)
    fleet.tube("car9", area=np.array([3.0] * 3), label=Label.UNCOVERED, audit=Audit(10, 7, 0.1, 10, 7, 3))
    fleet.tube("car1", area=np.array([2.0] * 3), label=Label.CALIBRATED, audit=Audit())
    fleet.profile("car9")
    assert ordered(fleet, "name") == ["car1", "car9", "car10"]
    assert ordered(fleet, "label") == ["car9", "car1", "car10"]
    assert ordered(fleet, "area") == ["car9", "car1", "car10"]
    assert ordered(fleet, "age") == ["car10", "car1", "car9"]
    assert ordered(fleet, "coverage") == ["car9", "car10", "car1"]
    fleet.sample("car2")
    assert ordered(fleet, "area")[-1] == ordered(fleet, "coverage")[-1] == "car2"
    with pytest.raises(KeyError):
        ordered(fleet, "colour")


@pytest.mark.parametrize("by", SORTS)
def test_every_order_has_every_vehicle_once(by: str) -> None:
    fleet = Fleet()
    for i in range(30):
        fleet.tube(f"car{i}", label=list(Label)[i % 4])
        fleet.sample(f"other{i}")
    assert sorted(ordered(fleet, by)) == sorted(fleet.view.snapshot(fleet.now).names)
    snapshot = fleet.view.snapshot(fleet.now)
    assert sum(snapshot.counts(snapshot.select(None)).values()) == len(snapshot) == 60


def test_where_there_is_no_room_names_are_those_of_the_worst() -> None:
    fleet = Fleet()
    for i in range(6):
        fleet.tube(f"car{i}", label=Label.CONTRADICTED if i in (3, 5) else Label.GUARANTEED)
    snapshot = fleet.view.snapshot(fleet.now)

    def shown(by: str, most: int) -> list[str]:
        return [snapshot.names[i] for i in snapshot.worst(snapshot.select(None), by, most).tolist()]

    assert shown("name", 3) == ["car0", "car3", "car5"]
    assert shown("label", 3) == ["car3", "car5", "car0"]
    assert shown("name", 6) == [f"car{i}" for i in range(6)]
    assert [snapshot.names[i] for i in snapshot.select("car[35]")] == ["car3", "car5"]
    assert not len(snapshot.select("svea*"))


def test_what_is_gone_for_long_is_forgotten_and_memory_is_bounded() -> None:
    fleet = Fleet(forget_after=60.0, most_events=5, most_vehicles=3)
    for i in range(5):
        fleet.tube(f"car{i}")
        fleet.event(f"car{i}", t=T0 + i)
        fleet.event(f"car{i}", t=T0 + i)
    fleet.status()
    assert len(fleet.view.snapshot(fleet.now)) == 3
    assert fleet.view.crowded_out == 2
    assert len(fleet.view.events) == 5
    assert fleet.view.told == 10
    fleet.wait(40.0)
    fleet.sample("car1")
    fleet.wait(40.0)
    assert fleet.view.snapshot(fleet.now).names == ("car1",)
    assert fleet.view.services == {}
    assert fleet.view.newest_tube("car0") is None
    assert fleet.view.newest_tube("car1") is not None
    assert len(fleet.view.traffic.flows([keys.tube("car0")], fleet.now)[1].nonzero()[0]) == 0
    fleet.tube("car7")
    assert row(fleet, "car7").sample_age is None


def test_services_are_stale_without_a_status() -> None:
    fleet = Fleet()
    fleet.status()
    fleet.status("side-info-1", kind="side-info")
    fleet.wait(2.0)
    fleet.status()
    assert fleet.view.stale_services(fleet.now) == []
    fleet.wait(1.5)
    assert fleet.view.stale_services(fleet.now) == ["side-info/side-info-1"]
    assert set(fleet.view.services) == {"reach/reach-1", "side-info/side-info-1"}


def test_what_could_not_be_read_is_counted_and_said_of_its_vehicle() -> None:
    fleet = Fleet()
    fleet.put(keys.tube("svea1"), a_tube().encode(), "application/msgpack;fleet.tube.v2")
    fleet.put(keys.tube("svea1"), b"nonsense", "application/msgpack;fleet.tube.v1")
    fleet.put(keys.tube("svea1"), a_tube().encode(), "application/msgpack;fleet.tube.v2")
    fleet.put("reach/-odd-/tube", b"", "text/plain")
    assert {reason: known.count for reason, known in fleet.view.refused.items()} == {
        "version": 2, "malformed": 1, "key": 1
    }  # fmt: skip
    assert fleet.view.refused["version"].key == keys.tube("svea1")
    assert "this program reads version 1" in row(fleet).why
    assert row(fleet).condition is Condition.WAITING
    fleet.tube()
    fleet.wait(0.1)
    assert row(fleet).condition is Condition.GUARANTEED
    assert row(fleet).why == "rank deficient"


def test_a_tube_of_another_vehicle_is_refused() -> None:
    fleet = Fleet()
    fleet.put(keys.tube("svea2"), a_tube().encode(), "application/msgpack;fleet.tube.v1")
    assert fleet.view.refused["fields"].count == 1
    assert fleet.view.newest_tube("svea1") is None


def test_an_empty_view_answers() -> None:
    view = FleetView()
    snapshot = view.snapshot(1.0)
    assert len(snapshot) == 0
    assert snapshot.counts(snapshot.select("*")) == {}
    assert [len(snapshot.order(snapshot.select(None), by)) for by in SORTS] == [0] * len(SORTS)
    assert view.traffic.total(1.0).messages == 0


def test_a_tube_that_is_handed_in_needs_no_feed() -> None:
    view = FleetView()
    view.tube(replace(a_tube(), area=np.zeros(0), area_free=np.zeros(0)), 5.0)
    view.refuse(MessageError("range", "out of it"), "svc/reach/x/status", 5.0)
    snapshot = view.snapshot(6.0)
    assert snapshot.row(0).area is None
    assert snapshot.row(0).tube_age == 1.0
    assert math.isnan(view.compute(6.0)["reach-1"].batch)


def test_names_count() -> None:
    assert sorted(["b2", "a10", "a9", "10", "9x", "a"], key=natural) == ["9x", "10", "a", "a9", "a10", "b2"]
