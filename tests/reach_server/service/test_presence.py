"""Who is gone, who else is there, and who is late: no clock but the one that is handed in."""

from fleet_bus.messages import ServiceStatus
from reach_server.service.load import LATE, ROUNDS, Load
from reach_server.service.other_servers import GONE, OtherServers
from reach_server.service.presence import SILENCE, STARVED, Presence


def told(presence: Presence, heard: dict[str, float], start: float, stop: float) -> list[tuple[float, str]]:
    """Who is told as gone, and when, by a server that looks around every half second."""
    found = []
    for k in range(int((stop - start) / 0.5)):
        now = start + 0.5 * k
        found += [(now, vehicle) for vehicle in presence.gone(heard, {}, now)]
    return found


def test_a_vehicle_without_token_and_samples_is_gone_once() -> None:
    presence = Presence()
    presence.token("a", True, 0.0)
    presence.token("a", False, 10.0)
    ((when, vehicle),) = told(presence, {"a": 9.95}, 10.0, 60.0)
    assert vehicle == "a"
    assert SILENCE < when - 10.0 <= SILENCE + 0.5
    assert presence.waiting == ()


def test_a_token_that_goes_while_samples_come_is_no_news() -> None:
    presence = Presence()
    presence.token("a", False, 10.0)
    heard: dict[str, float] = {}
    for k in range(100):
        now = 10.0 + 0.5 * k
        heard["a"] = now
        assert presence.gone(heard, {}, now) == []
    # Now they stop as well.
    assert [vehicle for _, vehicle in told(presence, heard, now + 0.5, now + 20)] == ["a"]


def test_a_token_that_comes_back_is_no_news() -> None:
    presence = Presence()
    presence.token("a", False, 10.0)
    presence.token("a", True, 11.0)
    assert told(presence, {}, 11.0, 60.0) == []


def test_a_starved_server_reports_nobody_gone_that_it_may_not_have_heard() -> None:
    presence = Presence()
    assert presence.gone({}, {}, 0.0) == []
    for vehicle in map(str, range(500)):
        presence.token(vehicle, False, 5.0)
    # Its rounds take seconds; in between the vehicles are heard again.
    now = 5.0
    heard: dict[str, float] = {}
    for _ in range(20):
        now += STARVED + 2.0
        assert presence.gone(heard, {}, now) == []
        heard = dict.fromkeys(map(str, range(500)), now)


def test_a_slow_vehicle_is_given_five_of_its_samples() -> None:
    presence = Presence()
    presence.token("a", False, 0.0)
    assert all(presence.gone({}, {"a": 10.0}, 0.5 * k) == [] for k in range(100))
    assert presence.gone({}, {"a": 10.0}, 50.5) == ["a"]


def status(instance: str) -> ServiceStatus:
    return ServiceStatus(kind="reach", instance=instance, t=1, started=1)


def test_another_server_is_told_once_by_its_session_whatever_its_id() -> None:
    others = OtherServers("mine", "reach-1")
    assert others.hear(status("reach-1"), "mine", 0.0) is None
    news = others.hear(status("reach-2"), "theirs", 0.0)
    assert news is not None
    assert "reach-2" in news
    assert others.hear(status("reach-2"), "theirs", 1.0) is None
    same = others.hear(status("reach-1"), "double", 1.0)
    assert same is not None
    assert "of the same id" in same
    assert len(others.problems) == 2
    assert others.elapse(1.0 + GONE) == []
    assert len(others.elapse(1.1 + GONE)) == 2
    assert others.problems == []


def test_a_server_is_behind_after_some_late_rounds_and_caught_up_after_some_early_ones() -> None:
    load = Load()
    assert not any(load.see(0.1) for _ in range(10))
    assert load.message == "the server keeps up again"
    assert [load.see(3.0) for _ in range(ROUNDS + 2)] == [False] * (ROUNDS - 1) + [True, False, False]
    assert load.note == "published 3.0 s late"
    assert "3.0 s" in load.message
    # Half way back is not back.
    assert not any(load.see(0.8 * LATE) for _ in range(10))
    assert [load.see(0.1) for _ in range(ROUNDS)] == [False] * (ROUNDS - 1) + [True]
    assert load.message == "the server keeps up again"
