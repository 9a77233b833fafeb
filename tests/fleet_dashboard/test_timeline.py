"""What became of obligations, and events."""

import pytest

from fleet_dashboard.services import MOST_SERVICES, Services
from fleet_dashboard.timeline import MOST_EVENTS, EventLog, Fate, Obligations, fate
from fleet_dashboard.timeline_view import MOST_ROWS, bars
from tests.fleet_dashboard.messages import SECOND, T0, contradiction


@pytest.mark.parametrize(
    ("verdict", "wanted"),
    [
        ("satisfied", Fate.WITNESSED), ("satisfied, may be violated at step 3", Fate.WITNESSED),
        ("violated", Fate.CONTRADICTED), ("undecided (size)", Fate.PENDING), ("undecided (time)", Fate.PENDING),
        ("undecided (past)", Fate.PENDING), ("something new", Fate.PENDING), ("", Fate.PENDING),
    ],
)  # fmt: skip
def test_a_verdict_says_what_became_of_a_requirement(verdict: str, wanted: Fate) -> None:
    assert fate(verdict) is wanted


def test_obligations_go_from_pending_to_witnessed_and_contradicted() -> None:
    obligations = Obligations()
    for k, verdict in enumerate(["undecided (time)", "undecided (size)", "satisfied", "satisfied", "violated"]):
        obligations.verdicts("a", {"lot.r": verdict}, T0 + k)
    (transitions,) = obligations.until(T0 + 9).values()
    assert [(each.t - T0, each.fate) for each in transitions] == [
        (0, Fate.PENDING), (2, Fate.WITNESSED), (4, Fate.CONTRADICTED),
    ]  # fmt: skip
    # As it was known before.
    (transitions,) = obligations.until(T0 + 3).values()
    assert [each.fate for each in transitions] == [Fate.PENDING, Fate.WITNESSED]
    assert obligations.until(T0 - 1) == {}


def test_a_contradiction_ends_the_side_information() -> None:
    obligations = Obligations()
    obligations.assigned("a", "lot", True, T0)
    obligations.event(contradiction("a", T0 + 5), T0 + 5)
    obligations.assigned("a", "lot", True, T0)
    (transitions,) = obligations.until(T0 + 9).values()
    assert [each.fate for each in transitions] == [Fate.PENDING, Fate.CONTRADICTED]
    assert [each.obligation for each in obligations.contradicted("a", T0 + 9)] == ["lot.assume"]
    assert obligations.contradicted("b", T0 + 9) == []
    assert obligations.contradicted("a", T0 + 4) == []


def test_what_a_clock_that_is_ahead_says_happened_when_it_was_heard_of() -> None:
    log, obligations = EventLog(), Obligations()
    ahead = contradiction("a", T0 + 60 * SECOND)
    log.add(ahead, T0)
    obligations.event(ahead, T0)
    assert log.until(T0) == [(T0, ahead)]
    assert obligations.until(T0) != {}


def test_events_come_once_newest_first_and_are_bounded() -> None:
    log = EventLog()
    assert log.add(contradiction("a", T0), T0)
    assert not log.add(contradiction("a", T0), T0 + 1)
    assert log.add(contradiction("b", T0 + 1), T0 + 1)
    assert [event.vehicle for _, event in log.until(T0 + 1)] == ["b", "a"]
    assert [event.vehicle for _, event in log.until(T0)] == ["a"]
    assert [event.vehicle for _, event in log.until(T0 + 1, "a")] == ["a"]
    for k in range(MOST_EVENTS + 10):
        log.add(contradiction("c", T0 + 2 + k), T0 + 10**6)
    assert len(log.until(T0 + 10**7)) == MOST_EVENTS
    # One that was forgotten may come again.
    assert log.add(contradiction("a", T0), T0)


def test_bars_lead_from_one_fate_to_the_next_and_on_until_now() -> None:
    obligations = Obligations()
    obligations.verdicts("a", {"r": "undecided (time)"}, T0)
    obligations.verdicts("b", {"r": "undecided (time)"}, T0 + 1)
    obligations.verdicts("a", {"r": "violated"}, T0 + 10)
    names, drawn = bars(obligations.until(T0 + 20), T0 + 5, T0 + 20)
    assert names == ["a · r", "b · r"]
    assert [(row, begin - T0, end - T0, what.fate) for row, begin, end, what in drawn] == [
        (0, 5, 10, Fate.PENDING), (0, 10, 20, Fate.CONTRADICTED), (1, 5, 20, Fate.PENDING),
    ]  # fmt: skip


def test_of_many_rows_those_with_a_contradiction_are_drawn() -> None:
    obligations = Obligations()
    for k in range(500):
        obligations.verdicts(f"v{k}", {"r": "violated" if k == 3 else "satisfied"}, T0 + k)
    names, _ = bars(obligations.until(T0 + 1000), T0, T0 + 1000)
    assert len(names) == MOST_ROWS
    assert names[0] == "v3 · r"


def test_services_are_bounded() -> None:
    services = Services()
    for k in range(MOST_SERVICES + 50):
        services.heard(f"s{k}", T0 + k)
    assert len(services.seen) == MOST_SERVICES
    assert ("reach", f"s{MOST_SERVICES + 49}") in services.seen
    services.token("svc/reach/x/y", True, T0)
    services.token("fleet/a/alive", True, T0)
    assert len(services.seen) == MOST_SERVICES
