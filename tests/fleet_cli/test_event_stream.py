"""Which events ``fleet events`` tells, and how."""

import json

import pytest

from fleet_bus.errors import UsageError
from fleet_bus.messages import Event, EventKind
from fleet_bus.pubsub import Received
from fleet_cli.event_stream import Filter, Reader, kinds_of, since_of
from fleet_cli.terminal import as_text
from fleet_cli.watch import event_document, event_text
from tests.docs.test_docs import page, section
from tests.fleet_bus.messages.examples import T0
from tests.fleet_view.messages import event_of


def received(event: Event, key: str = "reach/svea1/event") -> Received:
    return Received(key, event.encode(), Event.encoding(), None)


def test_each_event_is_told_once_in_the_order_of_time() -> None:
    reader = Reader()
    later, sooner = event_of(t=T0 + 5), event_of(t=T0 + 1)
    found = reader.in_order([received(later), received(sooner), received(later)])
    assert [event.t for event in found] == [T0 + 1, T0 + 5]
    assert reader.read(received(later)) is None
    assert reader.read(received(event_of(t=T0 + 6))) is not None


def test_what_is_no_event_is_counted() -> None:
    reader = Reader()
    assert reader.read(Received("reach/a/event", b"x", Event.encoding(), None)) is None
    assert reader.read(Received("reach/a/event", b"x", "application/msgpack;fleet.event.v7", None)) is None
    assert sum(reader.rejections.snapshot().values()) >= 1


def test_filters() -> None:
    event, service = event_of("svea1"), event_of(None, kind=EventKind.BEHIND)
    assert Filter().wants(event, cached=True)
    assert Filter().wants(service, cached=False)
    assert Filter(vehicle="svea*").wants(event, cached=True)
    assert not Filter(vehicle="svea*").wants(service, cached=True)
    assert not Filter(vehicle="car?").wants(event, cached=True)
    assert not Filter(kinds=kinds_of(["jump", "leap"])).wants(event, cached=True)
    assert Filter(kinds=kinds_of(["miss"])).wants(event, cached=True)
    # What comes now is new, whatever the clock of who says so shows.
    assert not Filter(since=T0 + 1).wants(event, cached=True)
    assert Filter(since=T0 + 1).wants(event, cached=False)


def test_kinds_are_those_of_the_wire() -> None:
    with pytest.raises(UsageError, match="contradiction"):
        kinds_of(["accident"])


@pytest.mark.parametrize(
    ("text", "seconds"), [("0", 0), ("90", 90), ("1.5 s", 1.5), ("10min", 600), ("2 h", 7200), ("1d", 86400)]
)
def test_a_span_reaches_back_from_now(text: str, seconds: float) -> None:
    assert since_of(text, T0) == T0 - round(seconds * 1e9)


def test_a_time_is_taken_as_it_is() -> None:
    assert since_of("2026-01-31T12:00:00+00:00", T0) == 1_769_860_800 * 10**9
    assert since_of("2026-01-31T13:00+01:00", T0) == 1_769_860_800 * 10**9
    for wrong in ("yesterday", "", "-5", "5 weeks", "9" * 40, "nan", "2026-13-01"):
        with pytest.raises(UsageError, match="--since"):
            since_of(wrong, T0)


def test_a_line_holds_the_documented_keys() -> None:
    text = section(page("reference/command.md"), "fleet events")
    line = json.loads(json.dumps({**event_document(event_of(details={"excess": 0.5})), "cached": True}))
    assert set(line) == {"type", "t", "time", "kind", "vehicle", "source", "message", "details", "cached"}
    assert all(f"`{key}`" in text for key in line)
    assert line["time"].endswith("+00:00")


def test_a_line_for_people_is_whole_and_harmless() -> None:
    event = event_of(message="x" * 300 + "\x1b]0;title\x07\nsecond line")
    found = as_text(event_text(event, whole=True), width=80, whole=True)
    assert found.count("\n") == 1
    assert "x" * 300 in found
    assert "\x1b" not in found
    assert "\x07" not in found
    assert " svea1 miss " in found
