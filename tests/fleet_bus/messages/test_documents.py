"""Messages that are documents: strict on the wire."""

from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet_bus.messages import Assignment, Document, Event, EventKind, ScenarioDocument, ServiceStatus
from tests.fleet_bus.messages.examples import T0, documents, finite, ids, refusal, stamps

counts = st.dictionaries(st.text(max_size=20), st.integers(-(2**63), 2**63 - 1), max_size=8)
details = st.dictionaries(st.text(max_size=20), st.text() | st.integers(-(2**63), 2**63) | finite | st.booleans())

any_document = st.one_of(
    st.builds(ScenarioDocument, scenario=ids, version=st.integers(1, 2**63), text=st.text(max_size=500)),
    st.builds(
        Assignment, scenario=ids, vehicle=ids, time_zero=stamps, active=st.booleans(), clock_offset=st.floats(0, 1e9)
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


BROKEN: list[tuple[type[Document], dict[str, Any]]] = [
    (ScenarioDocument, {"scenario": "a b"}),
    (ScenarioDocument, {"scenario": "a\n"}),
    (ScenarioDocument, {"version": 0}),
    (ScenarioDocument, {"version": "1"}),
    (ScenarioDocument, {"version": 1.0}),
    (ScenarioDocument, {"version": True}),
    (ScenarioDocument, {"text": b"bytes"}),
    (ScenarioDocument, {"text": "x" * 200_001}),
    (Assignment, {"time_zero": 0}),
    (Assignment, {"time_zero": 2**63}),
    (Assignment, {"time_zero": str(T0)}),
    (Assignment, {"active": 1}),
    (Assignment, {"active": "yes"}),
    (Assignment, {"clock_offset": -1.0}),
    (Assignment, {"clock_offset": float("inf")}),
    (Assignment, {"clock_offset": float("nan")}),
    (Assignment, {"clock_offset": "0.5"}),
    (Assignment, {"vehicle": "*"}),
    (Event, {"kind": "surprise"}),
    (Event, {"kind": None}),
    (Event, {"t": -5}),
    (Event, {"source": ""}),
    (Event, {"message": "x" * 2001}),
    (Event, {"details": {"a": []}}),
    (Event, {"details": {"a": None}}),
    (Event, {"details": {"a": float("nan")}}),
    (Event, {"details": {str(i): i for i in range(65)}}),
    (ServiceStatus, {"counters": {"a": 1.5}}),
    (ServiceStatus, {"counters": {"a": True}}),
    (ServiceStatus, {"gauges": {"a": float("inf")}}),
    (ServiceStatus, {"refused": []}),
    (ServiceStatus, {"started": None}),
    (ServiceStatus, {"kind": "svc/x"}),
]


@pytest.mark.parametrize(("cls", "changes"), BROKEN)
def test_what_a_document_does_not_allow_is_refused_by_place(cls: type[Document], changes: dict[str, Any]) -> None:
    payload = wire(cls, changes)
    assert refusal(cls.decode, payload) == "fields"
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
