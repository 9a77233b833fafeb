"""What a journal writes down of a round, and how it is split, chained and computed anew."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from fleet_bus import keys
from fleet_bus.errors import MessageError
from fleet_bus.messages import EventKind, JournalRound, ReachTube
from fleet_bus.messages.journal import BEGINNING, MOST_CALLS, MOST_LISTED, Call, digest_of, link, tube_digest
from fleet_bus.pubsub import Received
from reach_server.data.events import EngineEvent
from reach_server.service.journal import MOST_IDLE, Journal, event_digest, failure
from reach_server.service.replay import Round
from tests.fleet_bus.messages.examples import T0, a_round, a_tube, refusal

EVENT = EngineEvent(EventKind.MISS, "a", T0, "a miss", {"excess": 0.5})


class Notes:
    """A journal and what it has put."""

    def __init__(self) -> None:
        self.payloads: list[bytes] = []
        self.journal = Journal("one", T0, self.payloads.append)

    @property
    def messages(self) -> list[JournalRound]:
        return [JournalRound.decode(payload) for payload in self.payloads]

    def idle(self, times: Sequence[float]) -> None:
        for now in times:
            self.journal.begin(now, T0)
            self.journal.elapse(list)
            self.journal.end()


def samples(vehicles: int, each: int = 1, sessions: int = 1) -> list[tuple[str, Received]]:
    return [
        (f"v{k}", Received(keys.state(f"v{k}"), f"{k} {n}".encode(), "x", None, f"s{k % sessions}", T0 + n))
        for n in range(each)
        for k in range(vehicles)
    ]


def taken(notes: Notes, found: list[tuple[str, Received]], tubes: Sequence[ReachTube] = ()) -> Round:
    """The round of some samples and tubes, as it is read again."""
    notes.payloads.clear()
    notes.journal.begin(5.0, T0 + 1)
    notes.journal.process(found)
    notes.journal.processed([EVENT], None)
    for tube in tubes:
        notes.journal.tube(tube, tube.vehicle.encode() + bytes(8))
    notes.journal.elapse(list)
    notes.journal.end()
    return Round.of(notes.messages)


def test_a_round_names_what_came_in_its_order_and_what_came_of_it() -> None:
    notes = Notes()
    found = samples(2, 2)
    read = taken(notes, found, [a_tube(vehicle="v1", epoch=3, seq=9)])
    assert [(s.vehicle, s.arrived) for s in read.samples] == [(v, r.arrived_ns) for v, r in found]
    assert [s.reference for s in read.samples] == [
        (r.key, r.source, digest_of(r.payload, r.encoding)) for _, r in found
    ]
    assert [tube[:3] for tube in read.tubes] == [("v1", 3, 9)]
    assert read.events == (event_digest(EVENT),)
    assert [(call.kind, call.now) for call in read.calls] == [("process", 5.0), ("elapse", 5.0)]
    assert (read.head.number, read.head.now, read.head.stamp, read.head.totals) == (1, 5.0, T0 + 1, (4, 1, 1))
    assert notes.journal.summary()["value"] == read.chain
    assert (notes.journal.summary()["samples"], notes.journal.summary()["round"]) == ("4", "1")


@pytest.mark.parametrize(
    ("vehicles", "each", "sessions", "parts"),
    [
        (1, MOST_LISTED, 1, 1), (1, MOST_LISTED + 1, 1, 2), (1000, 3, 1000, 1), (1001, 1, 1, 3),
        (1200, 1, 1200, 3),
    ],
)  # fmt: skip
def test_a_large_round_is_split_into_few_parts(vehicles: int, each: int, sessions: int, parts: int) -> None:
    notes = Notes()
    found = samples(vehicles, each, sessions)
    read = taken(notes, found, [a_tube(vehicle=f"v{k}") for k in range(vehicles)])
    assert [m.part for m in notes.messages] == [(k + 1, parts) for k in range(parts)]
    assert [(s.vehicle, s.reference.source) for s in read.samples] == [(v, r.source) for v, r in found]
    assert [tube.vehicle for tube in read.tubes] == [f"v{k}" for k in range(vehicles)]


def test_many_calls_are_split_as_well() -> None:
    notes = Notes()
    notes.journal.begin(1.0, T0)
    for k in range(MOST_CALLS + 5):
        notes.journal.gone(f"v{k}")
    notes.journal.end()
    read = Round.of(notes.messages)
    assert len(notes.messages) == 2
    assert [call.subject for call in read.calls] == [f"v{k}" for k in range(MOST_CALLS + 5)]


def test_the_chain_goes_over_every_message_and_is_kept_if_nobody_listens() -> None:
    notes, deaf = Notes(), Journal("one", T0, lambda payload: None)
    for journal in (notes.journal, deaf):
        for k in range(3):
            journal.begin(float(k), T0 + k)
            journal.process(samples(2))
            journal.processed((), None)
            journal.end()
    chain = BEGINNING
    for payload, message in zip(notes.payloads, notes.messages, strict=True):
        chain = link(chain, payload)
        assert message.chain == chain
    assert deaf.chain == chain
    assert len({message.chain for message in notes.messages}) == 3


def test_rounds_without_input_are_written_down_with_the_next_one_or_after_a_while() -> None:
    notes = Notes()
    notes.idle([1.0, 2.0])
    assert notes.messages == []
    taken(notes, samples(1))
    assert notes.messages[0].idle.tolist() == [1.0, 2.0]
    notes.payloads.clear()
    notes.idle(range(10, 11 + MOST_IDLE))
    assert [len(m.idle) for m in notes.messages] == [MOST_IDLE]
    assert [call.kind for call in notes.messages[0].calls] == ["elapse"]
    notes.idle([99.0])
    notes.journal.flush()
    assert [(m.number, m.idle.tolist()) for m in notes.messages] == [(2, list(range(10, 10 + MOST_IDLE))), (3, [99.0])]
    notes.journal.flush()
    assert len(notes.messages) == 2


def test_an_error_of_the_fleet_is_told_from_one_of_the_bus() -> None:
    notes = Notes()

    def raises(error: Exception) -> list[EngineEvent]:
        raise error

    item = Received("fleet/a/profile", b"", "", None)
    for error, expected in ((ValueError("x"), "fleet: ValueError"), (MessageError("range", "x"), "")):
        notes.journal.begin(1.0, T0)
        with pytest.raises(type(error)):
            notes.journal.document("profile", item, lambda error=error: raises(error))  # type: ignore[misc]
        if expected:
            notes.journal.fail(error)
        notes.journal.end()
        assert notes.messages[-1].failed == expected
    notes.journal.begin(1.0, T0)
    notes.journal.process(samples(1))
    notes.journal.processed((), "late")
    notes.journal.fail(OSError())
    notes.journal.end()
    assert (notes.messages[-1].failed, notes.messages[-1].note) == (failure(OSError(), inside=False), "late")


def test_a_round_that_cannot_be_written_leaves_a_gap() -> None:
    notes = Notes()
    notes.journal.begin(-1.0, T0)
    notes.journal.gone("a")
    notes.journal.end()
    assert (notes.messages, notes.journal.number) == ([], 1)
    assert taken(notes, samples(1)).head.number == 2


def test_a_round_that_cannot_be_put_is_not_written_down_again() -> None:
    put: list[bytes] = []

    def full(payload: bytes) -> None:
        put.append(payload)
        if len(put) == 1:
            raise OSError("nobody there")

    journal = Journal("one", T0, full)
    for k in range(2):
        journal.begin(float(k), T0)
        journal.gone(f"v{k}")
        if k == 0:
            with pytest.raises(OSError, match="nobody there"):
                journal.end()
        journal.end()
    second = JournalRound.decode(put[1])
    assert (second.number, [call.subject for call in second.calls]) == (2, ["v1"])
    assert second.chain == link(JournalRound.decode(put[0]).chain, put[1])


def test_digests_tell_what_counts() -> None:
    tube = a_tube()
    slow = replace(tube, compute_seconds=0.5)
    assert tube_digest(tube.encode()) == tube_digest(slow.encode())
    assert tube_digest(tube.encode()) != tube_digest(replace(tube, server_epoch=1).encode())
    assert tube_digest(tube.encode()) != tube_digest(replace(tube, center=tube.center + 1e-15).encode())
    assert digest_of(b"x", "a") != digest_of(b"x", "b")
    others = (
        replace(EVENT, t=3), replace(EVENT, vehicle="b"), replace(EVENT, message="x"), replace(EVENT, details={}),
        replace(EVENT, kind=EventKind.JUMP),
    )  # fmt: skip
    assert event_digest(EVENT) not in [event_digest(other) for other in others]


def test_places_and_parts_that_cannot_be_are_refused() -> None:
    places = np.array([0, 2, 0], dtype="<u2")
    for change, text in (
        ({"sample_vehicle": places}, "kv is 2: expected places among 2 names"),
        ({"sample_session": places}, "ks is 2: expected places among 1 names"),
        ({"tube_vehicle": places[:1] + 2}, "tv is 2"),
        ({"part": (3, 2)}, "part 3 of 2"),
        ({"vehicles": ("a/b", "c")}, "v holds 'a/b'"),
        ({"calls": (Call("profile", 1.0, digest="xy"),)}, "c holds 'xy'"),
        ({"calls": (Call("elapse", 1.0),) * 1001}, "c holds 1001 calls"),
    ):
        with pytest.raises(MessageError, match=text):
            a_round(**change).encode()
    whole = a_round().encode()
    assert refusal(JournalRound.decode, whole.replace(b"\xa2kd\xc4\x18", b"\xa2kd\xc4\x10")) in ("malformed", "shape")
    assert refusal(JournalRound.decode, whole[:-32] + b"z" * 32) == "fields"
