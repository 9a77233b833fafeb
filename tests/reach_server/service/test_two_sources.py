"""Two that publish one vehicle: which one counts, what is told, and what tubes say meanwhile."""

import numpy as np
import pytest

from fleet_bus.errors import MessageError
from fleet_bus.messages import Assignment, EventKind, Label, parse_profile
from fleet_bus.rejections import Rejections
from reach_server.data.events import EngineEvent
from reach_server.service.fleet import Fleet
from tests.reach_server.drives import SVEA
from tests.reach_server.service.fleet_desk import NOW, SMALL, Desk, assignment, document, kinds

DT = SVEA.dt_ns / 1e9


def ready() -> Desk:
    """A vehicle of session A that has a model; time is that of the samples."""
    desk = Desk()
    desk.fleet.set_profile("a", SMALL, "A", 0.0)
    desk.process(desk.states("a", 0, NOW, session="A"), now=NOW * DT)
    return desk


def at(desk: Desk, k: int, session: str, epoch: int = 1) -> tuple[list[EngineEvent], set[Label]]:
    """One planned sample of a source; events, and labels of the tubes."""
    outcome = desk.process(desk.states("a", k, k + 1, session=session, epoch=epoch, planned=True), now=k * DT)
    events = outcome.events + desk.fleet.elapse(k * DT)
    return events, {label for _, tubes in outcome.tubes for label in tubes.labels}


@pytest.mark.parametrize("second", [("B", 2), ("A", 2), ("B", 1)])
def test_two_live_agents_of_one_id_are_told_and_their_tubes_contradicted(second: tuple[str, int]) -> None:
    desk, told, labels = ready(), [], []
    for k in range(NOW, NOW + 20):
        for session, epoch in (("A", 1), second):
            events, found = at(desk, k, session, epoch)
            told += events
            labels.append(found)
    assert kinds(told) == [EventKind.TWO_SOURCES]
    assert told[0].details["first"] != told[0].details["second"]
    assert labels[0] == {Label.GUARANTEED}
    # From the second sample of each on.
    assert set().union(*labels[3:]) == {Label.CONTRADICTED}
    assert {epoch for epoch, _ in desk.fleet.window_keys("a")} == {1}
    assert len(desk.fleet.window_keys("a")) == len(set(desk.fleet.window_keys("a")))
    # The second one leaves: its samples are counted as refused, and the label is back.
    k = NOW + 20
    while not told[1:]:
        events, found = at(desk, k, "A")
        told += events
        k += 1
    assert kinds(told) == [EventKind.TWO_SOURCES, EventKind.ONE_SOURCE]
    assert at(desk, k, "A") == ([], {Label.GUARANTEED})
    assert desk.refused == {"other_source": 20}
    assert {epoch for epoch, _ in desk.fleet.window_keys("a")} == {1}


def test_when_the_first_of_two_leaves_the_window_begins_with_the_second() -> None:
    desk = ready()
    desk.fleet.set_profile("a", SMALL, "B", NOW * DT)
    for k in range(NOW, NOW + 10):
        at(desk, k, "A")
        at(desk, k, "B", 2)
    told: list[EngineEvent] = []
    for k in range(NOW + 10, NOW + 60):
        told += at(desk, k, "B", 2)[0]
    assert kinds(told) == [EventKind.ONE_SOURCE]
    assert {epoch for epoch, _ in desk.fleet.window_keys("a")} == {2}
    assert desk.fleet.window_keys("a")[0] == (2, NOW)


@pytest.mark.parametrize("pause", [0.05, 0.3, 5.0])
def test_an_agent_that_restarts_is_no_conflict(pause: float) -> None:
    desk, told = ready(), []
    start = NOW * DT + pause
    desk.fleet.set_profile("a", SMALL, "B", start)
    for k in range(NOW, NOW + 40):
        now = start + (k - NOW) * DT
        outcome = desk.process(desk.states("a", k, k + 1, session="B", epoch=2, planned=True), now=now)
        told += outcome.events + desk.fleet.elapse(now)
    assert kinds(told) == []
    held = desk.fleet.window_keys("a")
    # What was held until the first one had been silent is not lost, and the data before it stays.
    assert [key for key in held if key[0] == 2] == [(2, k) for k in range(NOW, NOW + 40)]
    assert (1, NOW - 1) in held
    assert desk.refused == {}


def test_one_stray_sample_of_another_epoch_changes_nothing() -> None:
    desk, alone = ready(), ready()
    at(desk, NOW, "A")
    at(alone, NOW, "A")
    assert at(desk, 7, "A", 2**62) == ([], set())
    for k in range(NOW + 1, NOW + 60):
        assert at(desk, k, "A") == at(alone, k, "A") == ([], {Label.GUARANTEED})
    assert desk.fleet.window_keys("a") == alone.fleet.window_keys("a")
    assert desk.refused == {"other_source": 1}


def test_a_profile_of_another_session_is_refused_and_what_was_in_force_stays() -> None:
    desk = ready()
    at(desk, NOW, "A")
    wide = SMALL.model_copy(update={"window": 400})
    assert desk.fleet.set_profile("a", wide, "B", NOW * DT) == []
    told: list[EngineEvent] = []
    for k in range(NOW + 1, NOW + 10):
        events, labels = at(desk, k, "A")
        told += events
        assert labels == {Label.GUARANTEED}
    assert kinds(told) == [EventKind.PROFILE_REFUSED]
    assert desk.refused == {"other_source": 1}
    assert desk.fleet.profile_of("a") == SMALL
    # Again: counted, not told again.
    desk.fleet.set_profile("a", wide, "B", (NOW + 10) * DT)
    for k in range(NOW + 10, NOW + 20):
        assert at(desk, k, "A")[0] == []
    assert desk.refused == {"other_source": 2}


def test_the_profile_of_whoever_writes_the_states_counts_whichever_came_first() -> None:
    desk = Desk()
    desk.fleet.set_profile("a", SMALL, "forger", 0.0)
    with pytest.raises(MessageError, match="other_source"):
        desk.fleet.set_profile("a", SMALL.model_copy(update={"window": 130}), "A", 0.1)
    desk.process(desk.states("a", 0, 5, session="A"), now=0.5)
    assert desk.fleet.profile_of("a") == SMALL.model_copy(update={"window": 130})


def test_states_wait_for_the_profile_of_their_own_session() -> None:
    desk = Desk()
    desk.fleet.set_profile("a", SMALL, "forger", 0.0)
    for k in range(200):
        events = desk.process(desk.states("a", k, k + 1, session="A"), now=k * DT).events
    assert desk.fleet.window_keys("a") == []
    assert kinds(desk.process(desk.states("a", 200, 201, session="A"), now=60.0).events) == []
    assert desk.fleet.waits_for_profile("a")
    events = desk.fleet.set_profile("a", SMALL, "A", 61.0)
    assert events == []
    desk.process(desk.states("a", 201, 202, session="A"), now=61.1)
    assert len(desk.fleet.window_keys("a")) > 120


def test_a_profile_that_changes_is_told_with_its_bounds_first() -> None:
    desk = ready()
    fields = SMALL.model_dump(by_alias=True, exclude_none=True)
    fields["window"] = 125
    fields["noise"]["process"]["box"] = [0.5, 0.5, 0.5, 0.5]
    fields["noise"]["process"].pop("generators", None)
    (told,) = desk.fleet.set_profile("a", parse_profile(fields), "A", NOW * DT)
    assert told.kind == EventKind.PROFILE_CHANGED
    assert told.message.index("noise.process") < told.message.index("window: 120 → 125")
    assert "0.5" in told.message


def test_scenarios_come_from_one_service() -> None:
    desk = ready()
    desk.fleet.set_scenario(document(0.5), "S", 10.0)
    desk.fleet.assign(assignment(), "S", 10.0)
    told: list[EngineEvent] = []
    with pytest.raises(MessageError, match="other_source"):
        desk.fleet.set_scenario(document(0.001, version=9), "forger", 10.5)
    with pytest.raises(MessageError, match="other_source"):
        desk.fleet.assign(assignment(active=False), "forger", 10.6)
    for k in range(30):
        desk.fleet.hear_service("S", 11.0 + k)
        told += desk.fleet.elapse(11.0 + k)
    assert kinds(told) == [EventKind.TWO_SOURCES]
    assert told[0].details["scenario"] == "box"
    tubes = desk.tubes(desk.states("a", NOW, NOW + 1, session="A"))
    assert {cut.scenario for cut in tubes["a"].cuts[0]} == {"box"}
    assert kinds(told) == [EventKind.TWO_SOURCES]


def test_a_service_that_restarts_is_followed_once_the_first_is_silent() -> None:
    desk = ready()
    desk.fleet.set_scenario(document(0.5), "S", 10.0)
    desk.fleet.assign(assignment(), "S", 10.0)
    with pytest.raises(MessageError, match="other_source"):
        desk.fleet.set_scenario(document(0.4, version=2), "S2", 10.5)
    with pytest.raises(MessageError, match="other_source"):
        desk.fleet.assign(Assignment(scenario="box", vehicle="b", time_zero=5), "S2", 10.5)
    assert desk.fleet.elapse(12.0) == []
    desk.fleet.hear_service("S2", 13.0)
    assert desk.fleet.elapse(20.0) == []
    # The new document is in force, and nobody was told of a conflict.
    with pytest.raises(MessageError, match="old_version"):
        desk.fleet.set_scenario(document(0.3), "S2", 20.5)
    assert desk.fleet.set_scenario(document(0.3, version=3), "S2", 20.5) == []


@pytest.mark.parametrize("version", [1, 2])
def test_versions_only_go_up(version: int) -> None:
    desk = ready()
    desk.fleet.set_scenario(document(0.5, version=2), "S", 10.0)
    desk.fleet.assign(assignment(), "S", 10.0)
    before = desk.tubes(desk.states("a", NOW, NOW + 1, session="A"))["a"].area
    with pytest.raises(MessageError, match="old_version") as refused:
        desk.fleet.set_scenario(document(0.01, version=version), "S", 11.0)
    assert "raise the version to 3" in str(refused.value)
    again = ready()
    again.fleet.set_scenario(document(0.5, version=2), "S", 10.0)
    again.fleet.assign(assignment(), "S", 10.0)
    np.testing.assert_array_equal(again.tubes(again.states("a", NOW, NOW + 1, session="A"))["a"].area, before)


def test_events_that_no_sample_tells_the_time_of_carry_the_time_of_day() -> None:
    noon = 1_800_000_000 * 10**9
    fleet = Fleet(Rejections(), lambda: noon)
    fleet.set_profile("a", SMALL, "A", 5.0)
    (told,) = fleet.set_profile("a", SMALL.model_copy(update={"window": 130}), "A", 6.0)
    assert (told.kind, told.t) == (EventKind.PROFILE_CHANGED, noon)
