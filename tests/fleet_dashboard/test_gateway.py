"""What the page knows after some messages, and what it does with those that it should not believe."""

import threading
from dataclasses import replace
from itertools import count

import numpy as np
import pytest

from fleet_bus import keys
from fleet_bus.bus import Handle
from fleet_bus.messages import Assignment, Cut, Label, ScenarioDocument, StateFlag
from fleet_bus.pubsub import Received
from fleet_dashboard import concerns, inbox, table
from fleet_dashboard.gateway import Gateway
from fleet_dashboard.picture import LABELS, NO_TUBE, Mark, Picture
from fleet_dashboard.regions import Regions
from fleet_dashboard.vehicle_list import rows
from fleet_dashboard.view import active_regions
from tests.fleet_dashboard.messages import (
    PROFILE,
    SECOND,
    T0,
    contradiction,
    of_event,
    of_profile,
    of_state,
    of_status,
    of_tube,
    tube,
)
from tests.memory_bus import Network, Time
from tests.waiting import wait_until


def fed(*messages: Received, now: int = T0) -> tuple[Gateway, Picture]:
    gateway = Gateway(Time(origin_ns=T0))
    for message in messages:
        gateway.feed(message)
    return gateway, gateway.tick(now)


def test_a_vehicle_stands_where_its_sample_says_and_its_sets_where_the_tube_says() -> None:
    told = tube("a", at=(3.0, 4.0), seq=7)
    # The profile has the position behind the speed, unlike the tube.
    gateway, picture = fed(
        of_profile("a"), of_state("a", [1.0, 2.5, 3.5, 0.25], seq=7), of_tube(told, T0 + SECOND // 50)
    )
    assert picture.ids[0] == "a"
    assert picture.position[0].tolist() == [2.5, 3.5]
    assert picture.heading[0] == 0.25
    assert LABELS[picture.label[0]] == "guaranteed"
    np.testing.assert_array_equal(picture.center[0, :3], told.center[:, :2])
    np.testing.assert_allclose(picture.outline[0, :3], told.outline, atol=1e-6)
    assert picture.steps[0] == 3
    assert picture.area[0] == told.area[-1]
    assert picture.area_free[0] == told.area_free[-1]
    assert picture.coverage[0] == pytest.approx(0.99)
    assert picture.nominal[0] == pytest.approx(PROFILE.confidence)
    assert picture.latency[0] == pytest.approx(0.02)
    assert gateway.table.servers[picture.server[0]] == "reach-1"
    assert picture.marks[0] == 0
    vertices = told.center[:, None, :2] + told.outline
    np.testing.assert_allclose(picture.low[0], np.minimum(vertices.min(axis=(0, 1)), [2.5, 3.5]), atol=1e-6)
    np.testing.assert_allclose(picture.high[0], np.maximum(vertices.max(axis=(0, 1)), [2.5, 3.5]), atol=1e-6)


def test_a_vehicle_without_a_profile_stands_at_its_first_set() -> None:
    _, picture = fed(of_state("a", [1, 2, 3, 4]), of_tube(tube("a", at=(3.0, 4.0))))
    assert picture.position[0].tolist() == [3.1, 4.0]
    assert np.isnan(picture.heading[0])
    assert Mark(int(picture.marks[0])) == Mark.NO_PROFILE


def test_a_vehicle_with_samples_alone_is_in_the_list_with_why_it_waits() -> None:
    gateway, picture = fed(of_state("a", [1, 2, 3, 4]), of_status(waiting={"a": "37 of 100 samples"}))
    assert picture.label.tolist() == [NO_TUBE]
    assert Mark(int(picture.marks[0])) == Mark.NO_PROFILE | Mark.NO_POSE
    (row,) = rows(gateway, picture)
    assert row["id"] == "a"
    assert "37 of 100 samples" in row["why"]
    assert row["area"] is None


def test_of_several_samples_in_one_tick_the_last_counts() -> None:
    _, picture = fed(of_profile("a"), *(of_state("a", [0, k, -k, 0], seq=k) for k in range(20)))
    assert picture.position[0].tolist() == [19, -19]


def test_samples_of_the_history_move_nobody() -> None:
    _, picture = fed(of_profile("a"), of_state("a", [0, 5, 5, 0], flags=StateFlag.HISTORY))
    assert Mark.NO_POSE in Mark(int(picture.marks[0]))
    assert picture.sampled.tolist() == [0]


def test_an_older_tube_changes_nothing_but_one_of_a_new_start_does() -> None:
    gateway, _ = fed(of_tube(tube("a", seq=10)))
    gateway.feed(of_tube(tube("a", seq=9, label=Label.UNCOVERED)))
    assert LABELS[gateway.tick(T0).label[0]] == "guaranteed"
    gateway.feed(of_tube(tube("a", seq=0, epoch=2, label=Label.UNCOVERED)))
    assert LABELS[gateway.tick(T0).label[0]] == "uncovered"


def test_tubes_of_other_sizes_share_the_arrays() -> None:
    small, large = tube("a", steps=2, corners=4), tube("b", steps=6, corners=12)
    gateway, _ = fed(of_tube(small))
    gateway.feed(of_tube(large))
    picture = gateway.tick(T0)
    for row, told in enumerate((small, large)):
        corners, steps = told.outline.shape[1], len(told.times)
        np.testing.assert_allclose(picture.outline[row, :steps, :corners], told.outline, atol=1e-6)
        # What is beyond repeats the last corner.
        last = np.broadcast_to(told.outline[:, -1:], picture.outline[row, :steps, corners:].shape)
        np.testing.assert_allclose(picture.outline[row, :steps, corners:], last, atol=1e-6)


def test_who_is_silent_is_marked_and_who_speaks_again_is_not() -> None:
    gateway, picture = fed(of_profile("a"), of_state("a", [0] * 4), of_tube(tube("a")), of_status())
    assert not picture.stale().any()
    late = T0 + 3 * SECOND
    picture = gateway.tick(late)
    assert Mark(int(picture.marks[0])) == Mark.SILENT | Mark.TUBE_OLD | Mark.SERVER_SILENT
    assert picture.age().tolist() == [3.0]
    assert concerns.problems(gateway) == ["reach server reach-1: silent for 3 s"]
    gateway.feed(of_state("a", [0] * 4, seq=1, arrived=late))
    gateway.feed(of_tube(tube("a", seq=1), late))
    assert not gateway.tick(late).stale().any()
    assert concerns.problems(gateway) == []


def test_a_server_whose_token_goes_is_silent_at_once() -> None:
    network = Network(Time(origin_ns=T0))
    gateway = listening(network)
    token = network.bus().alive("svc/reach/reach-1")
    network.deliver(of_tube(tube("a")))
    assert not gateway.tick(T0).stale().any()
    # Its last status comes with it, in one tick.
    network.deliver(of_status(t=T0 + 1))
    token.close()
    picture = gateway.tick(T0 + 1)
    assert Mark(int(picture.marks[0])) & Mark.SERVER_SILENT
    assert concerns.problems(gateway) == ["reach server reach-1: gone, silent for 0 s"]


def test_a_server_that_another_took_over_from_is_no_problem() -> None:
    gateway, _ = fed(of_tube(tube("a", server="old")), of_status("old"))
    later = T0 + 10 * SECOND
    gateway.feed(of_tube(tube("a", seq=1, server="new"), later))
    gateway.feed(of_status("new", t=later, arrived=later))
    picture = gateway.tick(later)
    assert Mark.SERVER_SILENT not in Mark(int(picture.marks[0]))
    assert concerns.problems(gateway) == []


def test_a_contradiction_is_an_alarm_that_says_who_and_why() -> None:
    assignment = Assignment(scenario="lot", vehicle="a", time_zero=T0 - SECOND)
    assigned = Received(
        keys.assignment("lot", "a"), assignment.encode(), Assignment.encoding(), None, arrived_ns=T0 - SECOND
    )
    gateway, picture = fed(assigned, of_tube(tube("a")), of_tube(tube("b")), of_profile("a"), of_profile("b"))
    assert concerns.alarms(gateway, picture) == []
    gateway.feed(of_event(contradiction("a")))
    # Recovery brings it again, and the assignment.
    gateway.feed(of_event(contradiction("a")))
    gateway.feed(assigned)
    picture = gateway.tick(T0)
    assert [Mark(int(marks)) for marks in picture.marks] == [Mark.LEFT, Mark(0)]
    assert concerns.alarms(gateway, picture) == ["a left its scenario: it left the lot"]
    assert len(gateway.events.until(T0)) == 1
    found = rows(gateway, picture)
    assert [row["id"] for row in found] == ["a", "b"]
    assert "it left the lot" in found[0]["why"]
    # Assigned anew, it takes part again.
    again = Assignment(scenario="lot", vehicle="a", time_zero=T0 + SECOND)
    gateway.feed(replace(assigned, payload=again.encode(), arrived_ns=T0 + SECOND))
    assert concerns.alarms(gateway, gateway.tick(T0 + SECOND)) == []


def test_a_violated_requirement_is_an_alarm() -> None:
    gateway, picture = fed(of_profile("a"), of_tube(tube("a", verdicts={"lot.fast": "violated"})))
    assert Mark(int(picture.marks[0])) == Mark.VIOLATES
    assert concerns.alarms(gateway, picture) == ["a violates lot.fast"]


def test_what_is_refused_is_counted_and_changes_nothing() -> None:
    gateway, before = fed(of_profile("a"), of_state("a", [0] * 4), of_tube(tube("a")))
    bad = of_tube(tube("a", seq=1))
    for message in (
        replace(bad, payload=b"\x00"), replace(of_state("a", [9] * 4), encoding="text/plain"),
        replace(bad, key="reach/a b/tube"), replace(of_status(), payload=b"\x80"),
        replace(of_state("a", [9] * 4), key="x"),
        replace(of_profile("a"), encoding="application/msgpack;fleet.profile.v9"),
        replace(of_event(contradiction("a")), payload=b""),
        # About another than their key says.
        replace(of_event(contradiction("a")), key="reach/b/event"),
        replace(of_event(contradiction("a")), key="svc/reach/reach-1/event"),
        replace(of_status(), key="svc/reach/x/status"),
    ):  # fmt: skip
        gateway.feed(message)
    picture = gateway.tick(T0)
    for name in ("position", "label", "marks", "area", "outline"):
        np.testing.assert_array_equal(getattr(picture, name), getattr(before, name))
    counted = gateway.rejections.snapshot()
    assert sum(counted.values()) == 10
    assert counted["version"] == 1


def test_a_tube_that_is_refused_hides_none_that_came_before_it() -> None:
    gateway, _ = fed()
    gateway.feed(of_tube(tube("a", seq=1, label=Label.CALIBRATED)))
    gateway.feed(of_tube(tube("a", seq=2)))
    for _ in range(3):
        gateway.feed(replace(of_tube(tube("a", seq=3)), payload=b"\x00"))
    assert LABELS[gateway.tick(T0).label[0]] == "guaranteed"
    assert gateway.rejections.snapshot() == {"malformed": 3}


def test_a_set_of_astronomic_size_is_said_and_not_drawn() -> None:
    gateway, picture = fed(of_profile("a"), of_profile("b"), of_tube(tube("a", radius=1e37)), of_tube(tube("b")))
    assert [Mark(int(marks)) for marks in picture.marks] == [Mark.TOO_LARGE, Mark(0)]
    assert "too large to draw" in rows(gateway, picture)[1]["why"] + rows(gateway, picture)[0]["why"]
    far = of_tube(tube("c", at=(1e38, -1e38)))
    gateway.feed(far)
    assert np.isfinite(gateway.tick(T0).position[2]).all()


def test_vehicles_beyond_the_most_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table, "MOST_VEHICLES", 3)
    gateway, picture = fed(*(of_tube(tube(f"t{k}")) for k in range(5)), *(of_state(f"s{k}", [0] * 4) for k in range(5)))
    assert len(picture) == 3
    assert gateway.rejections.snapshot()["overflow"] >= 2


def test_what_the_page_cannot_keep_until_it_looks_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inbox, "MOST_WAITING", 2)
    gateway, picture = fed(
        *(of_tube(tube(f"t{k}")) for k in range(3)), *(of_state("t0", [0] * 4, seq=k) for k in range(3)), of_status()
    )
    assert gateway.rejections.snapshot() == {"overflow": 2}
    assert list(picture.ids) == ["t0", "t1"]


def test_it_reads_the_bus_and_puts_nothing() -> None:
    network = Network(Time(origin_ns=T0))
    bus = network.bus()
    profiles = bus.publisher(keys.profile("a"), of_profile("a").encoding, cache=1)
    profiles.put(PROFILE.encode())
    puts = list(network.puts)
    gateway = listening(network)
    network.deliver(of_state("a", [1, 2, 3, 4]))
    network.deliver(of_tube(tube("a")))
    picture = gateway.tick(T0)
    assert picture.position[0].tolist() == [2, 3]
    assert network.puts == puts
    gateway.close()
    network.deliver(of_state("a", [1, 9, 9, 4], seq=1))
    assert gateway.tick(T0).position[0].tolist() == [2, 3]


def test_a_tick_that_fails_is_told_and_does_not_end_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    time = Time(origin_ns=T0)
    gateway = Gateway(time)
    stop, ticks = threading.Event(), count()

    def fail(*_: object) -> Picture:
        if next(ticks) == 2:
            monkeypatch.undo()
        raise ZeroDivisionError("no good")

    monkeypatch.setattr(gateway, "tick", fail)
    said: list[list[str]] = []

    def waited(now: float) -> None:
        said.append(concerns.problems(gateway))
        if now > 1.0:
            stop.set()

    time.on_wait = waited
    thread = threading.Thread(target=gateway.run, args=(stop,))
    thread.start()
    wait_until(lambda: not thread.is_alive())
    assert any("no good" in line for lines in said for line in lines)
    assert said[-1] == []
    assert gateway.picture.number > 0


def test_regions_whose_predicates_cut_are_active() -> None:
    lines = np.zeros((1, 2, 2))
    regions = Regions(
        {"P": lines, "O": lines}, {"P": (0, 0), "O": (0, 0)}, {"P": frozenset({"P.x"}), "O": frozenset({"O"})}
    )
    gateway = Gateway(Time(origin_ns=T0), draw=lambda text: regions)
    document = ScenarioDocument(scenario="lot", version=1, text="text")
    gateway.feed(Received(keys.document("lot"), document.encode(), document.encoding(), None, arrived_ns=T0))
    gateway.feed(of_tube(tube("a", cuts=[Cut("lot", "P.x", 1, 2), Cut("yard", "O", 1, 1)])))
    gateway.tick(T0)
    wait_until(lambda: gateway.regions.number == 1)
    assert active_regions(gateway, gateway.picture) == {("lot", "P")}
    # What a stale tube was cut by is not active.
    gateway.tick(T0 + 5 * SECOND)
    assert active_regions(gateway, gateway.picture) == set()


def listening(network: Network) -> Gateway:
    bus = network.bus()

    def subscribe(expression: str, callback: object) -> Handle:
        return bus.subscriber(expression, callback, history=0)  # type: ignore[arg-type]

    return Gateway(network.time).listen(bus, subscribe)
