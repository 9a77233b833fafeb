"""What waits to be read: bounded, in order, newest first where there is too much."""

import pytest

from fleet_bus import keys
from fleet_bus.messages.tube import ENCODING
from fleet_bus.pubsub import Received
from fleet_view import feed
from tests.fleet_bus.messages.examples import a_tube
from tests.fleet_view.messages import Fleet


def arrive(fleet: Fleet, vehicle: str, seq: int) -> None:
    payload = a_tube(vehicle=vehicle, seq=seq).encode()
    fleet.feed.arrived(Received(keys.tube(vehicle), payload, ENCODING, None))


def test_ages_count_from_when_a_message_came_not_from_when_it_was_read() -> None:
    fleet = Fleet()
    arrive(fleet, "a", 1)
    fleet.wait(2.0)
    assert fleet.feed.take_in() == 1
    assert fleet.feed.take_in() == 0
    assert fleet.view.snapshot(fleet.now).row(0).tube_age == 2.0


def test_history_is_no_sign_of_life_but_traffic() -> None:
    fleet = Fleet()
    fleet.sample(history=True)
    assert len(fleet.view.snapshot(fleet.now)) == 0
    assert fleet.view.traffic.total(fleet.now).messages == 1
    fleet.sample()
    assert fleet.view.snapshot(fleet.now).row(0).sample_age == 0.0


def test_of_too_many_tubes_the_newest_of_each_vehicle_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(feed, "MOST_TUBES", 4)
    fleet = Fleet()
    for seq in range(3):
        for vehicle in "ab":
            arrive(fleet, vehicle, seq)
    assert fleet.feed.take_in() == 6
    assert fleet.view.skipped == 4
    for vehicle in "ab":
        tube = fleet.view.newest_tube(vehicle)
        assert tube is not None
        assert tube.seq == 2
    assert fleet.view.traffic.total(fleet.now).messages == 6


def test_more_than_can_wait_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(feed, "MOST_WAITING", 3)
    fleet = Fleet()
    for seq in range(5):
        arrive(fleet, "a", seq)
    fleet.feed.take_in()
    assert fleet.view.refused["overflow"].count == 2
    tube = fleet.view.newest_tube("a")
    assert tube is not None
    assert tube.seq == 2


def test_a_sample_that_cannot_be_read_does_not_take_others_with_it() -> None:
    fleet = Fleet()
    encoding = "application/msgpack;fleet.state.v1"
    fleet.feed.arrived(Received(keys.state("bad"), b"\x81\xa1d\xc4\x00", encoding, None))
    fleet.feed.arrived(Received("fleet/-/state", b"", encoding, None))
    fleet.sample("good")
    assert set(fleet.view.snapshot(fleet.now).names) == {"bad", "good"}
    assert sum(known.count for known in fleet.view.refused.values()) == 2
    assert fleet.view.snapshot(fleet.now).row(0).why.startswith("state refused (shape)")
