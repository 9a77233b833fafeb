"""Messages that are documents: strict on the wire."""

from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet_bus.messages import Assignment, Document, Event, EventKind, ScenarioDocument, ServiceStatus, ranges
from tests.fleet_bus.messages.examples import T0, documents, finite, ids, numbers, refusal, stamps, whole

counts = st.dictionaries(st.text(max_size=20), whole(ranges.COUNTER), max_size=8)
details = st.dictionaries(
    st.text(max_size=20), st.text() | st.integers(-(2**63), 2**64 - 1) | numbers(ranges.DETAIL) | st.booleans()
)

any_document = st.one_of(
    st.builds(ScenarioDocument, scenario=ids, version=whole(ranges.VERSION), text=st.text(max_size=500)),
    st.builds(
        Assignment, scenario=ids, vehicle=ids, time_zero=stamps, active=st.booleans(),
        clock_offset=numbers(ranges.CLOCK_OFFSET),
    ),
    st.builds(
        Event, kind=st.sampled_from(EventKind), vehicle=ids, t=stamps, source=ids, message=st.text(max_size=50),
        details=details,
    ),
    st.builds(
        ServiceStatus, kind=ids, instance=ids, t=stamps, started=stamps, counters=counts,
        gauges=st.dictionaries(st.text(max_size=20), finite, max_size=8), refused=counts,
    ),
)  # fmt: skip


@given(any_document)
@pytest.mark.slow
def test_a_document_survives_the_wire(document: Document) -> None:
    found = type(document).decode(document.encode(), document.encoding())
    assert found == document
    assert found.encode() == document.encode()


def test_details_keep_their_types() -> None:
    for document in documents():
        if isinstance(document, Event):
            found = Event.decode(document.encode()).details
            assert [type(value) for value in found.values()] == [float, int, bool, str]


def wire(cls: type[Document], changes: dict[str, Any]) -> bytes:
    (example,) = [d for d in documents() if type(d) is cls]
    packed: bytes = msgpack.packb({**msgpack.unpackb(example.encode()), **changes})
    return packed


BROKEN: list[tuple[type[Document], dict[str, Any], str]] = [
    (ScenarioDocument, {"scenario": "a b"}, "fields"),
    (ScenarioDocument, {"scenario": "a\n"}, "fields"),
    (ScenarioDocument, {"version": 0}, "range"),
    (ScenarioDocument, {"version": "1"}, "fields"),
    (ScenarioDocument, {"version": 1.0}, "fields"),
    (ScenarioDocument, {"version": True}, "fields"),
    (ScenarioDocument, {"text": b"bytes"}, "fields"),
    (ScenarioDocument, {"text": "x" * 200_001}, "fields"),
    (Assignment, {"time_zero": 0}, "range"),
    (Assignment, {"time_zero": 2**63}, "range"),
    (Assignment, {"time_zero": str(T0)}, "fields"),
    (Assignment, {"active": 1}, "fields"),
    (Assignment, {"active": "yes"}, "fields"),
    (Assignment, {"clock_offset": -1.0}, "range"),
    (Assignment, {"clock_offset": float("inf")}, "not_finite"),
    (Assignment, {"clock_offset": float("nan")}, "not_finite"),
    (Assignment, {"clock_offset": "0.5"}, "fields"),
    (Assignment, {"vehicle": "*"}, "fields"),
    (Event, {"kind": "surprise"}, "fields"),
    (Event, {"kind": None}, "fields"),
    (Event, {"t": -5}, "range"),
    (Event, {"source": ""}, "fields"),
    (Event, {"message": "x" * 2001}, "fields"),
    (Event, {"details": {"a": []}}, "fields"),
    (Event, {"details": {"a": None}}, "fields"),
    (Event, {"details": {"a": float("nan")}}, "not_finite"),
    (Event, {"details": {str(i): i for i in range(65)}}, "fields"),
    (ServiceStatus, {"counters": {"a": 1.5}}, "fields"),
    (ServiceStatus, {"counters": {"a": True}}, "fields"),
    (ServiceStatus, {"gauges": {"a": float("inf")}}, "not_finite"),
    (ServiceStatus, {"refused": []}, "fields"),
    (ServiceStatus, {"started": None}, "fields"),
    (ServiceStatus, {"kind": "svc/x"}, "fields"),
]


@pytest.mark.parametrize(("cls", "changes", "reason"), BROKEN)
def test_what_a_document_does_not_allow_is_refused_by_place(
    cls: type[Document], changes: dict[str, Any], reason: str
) -> None:
    payload = wire(cls, changes)
    assert refusal(cls.decode, payload) == reason
    with pytest.raises(ValueError, match=next(iter(changes))):
        cls.decode(payload)


def test_a_map_with_more_entries_than_any_message_has_is_malformed() -> None:
    assert (
        refusal(ServiceStatus.decode, wire(ServiceStatus, {"counters": {str(i): i for i in range(257)}})) == "malformed"
    )


def test_many_errors_are_summed_up() -> None:
    with pytest.raises(ValueError, match="and 60 more"):
        Event.decode(wire(Event, {"details": {f"k{i}": None for i in range(16)}}))


@pytest.mark.parametrize("cls", [type(document) for document in documents()])
def test_another_encoding_is_refused(cls: type[Document]) -> None:
    payload = wire(cls, {})
    assert cls.decode(payload, cls.encoding()).encode() == payload
    assert refusal(cls.decode, payload, cls.encoding().replace(".v1", ".v2")) == "version"
    assert refusal(cls.decode, payload, "application/json") == "encoding"


def test_documents_are_frozen() -> None:
    for document in documents():
        with pytest.raises(ValueError, match="frozen"):
            document.t = 1  # type: ignore[attr-defined]
