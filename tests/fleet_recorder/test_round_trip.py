"""What came over the bus comes out of a recording, every byte and every name of it."""

from io import BytesIO
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, make_reader
from mcap.stream_reader import CRCValidationError

from fleet_bus import keys, schemas
from fleet_bus.messages import EventKind, StateSample
from fleet_bus.pubsub import Received
from fleet_recorder import layout
from fleet_recorder.layout import SceneMessage
from fleet_recorder.reader import Reading, read
from tests.fleet_recorder.made import T0, assignment, document, event, parts, profile, state, status, token, write

#: Of everything that a fleet's bus carries, and of what it should not.
EVERYTHING = [
    profile(),
    document(1),
    assignment(T0),
    token("a", True, T0),
    state(0),
    state(0, source="another session"),
    state(1),
    event(EventKind.MISS, T0),
    status(T0),
    Received("fleet/a/state", b"", "zenoh/bytes", None, "", T0 + 5),
    Received("fleet/a/state", b"\xc1 no msgpack", "application/msgpack;fleet.state.v99", 3, "x", 0),
    Received("svc/reach/one/new", b"\x00" * 5, "application/msgpack;fleet.nobody_knows.v1", None, "y", T0 + 6),
    Received("spec/s/ä key of others", b"\x80", "", 2**64 - 1, "z", 2**64 - 1),
    token("a", False, T0 + 7),
]


def test_what_is_read_is_what_came(tmp_path: Path) -> None:
    path = write(tmp_path, EVERYTHING)
    reading = Reading(path)
    found = list(reading)
    assert [recorded.received for recorded in found] == EVERYTHING
    assert [recorded.sequence for recorded in found] == list(range(len(EVERYTHING)))
    assert (reading.messages, reading.missing, reading.cut) == (len(EVERYTHING), 0, [])


texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=30)
times = st.integers(0, 2**64 - 1)


@pytest.mark.slow
@given(
    st.lists(
        st.builds(Received, texts, st.binary(max_size=60), texts, st.none() | times, texts, times),
        min_size=1,
        max_size=20,
    )
)
def test_any_message_comes_back(tmp_path_factory: pytest.TempPathFactory, messages: list[Received]) -> None:
    folder = tmp_path_factory.mktemp("recording")
    assert list(read(write(folder, messages))) == messages


def test_others_can_read_it_too(tmp_path: Path) -> None:
    path = write(tmp_path, EVERYTHING)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "fleet-reach"
        found = list(reader.iter_messages(log_time_order=False))
        summary = reader.get_summary()
    with path.open("rb") as file:
        # In file order the checksum of all that was written is looked at, too.
        in_order = NonSeekingReader(file, validate_crcs=True).iter_messages(log_time_order=False)
        assert [message.data for _, _, message in in_order] == [received.payload for received in EVERYTHING]
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(EVERYTHING)
    assert [message.data for _, _, message in found] == [received.payload for received in EVERYTHING]
    states = [(schema, channel, message) for schema, channel, message in found if channel.topic == "fleet/a/state"]
    schema, channel, message = states[0]
    assert schema is not None
    assert (schema.name, schema.encoding, channel.message_encoding) == ("fleet.state.v1", "jsonschema", "msgpack")
    assert schema.data.decode() == schemas.shipped()["fleet.state.v1.json"]
    assert (message.log_time, message.publish_time) == (state(0).arrived_ns, state(0).timestamp_ns)
    # One channel a source, so that who put a message is not lost.
    assert len({channel.id for _, channel, _ in states}) == 4
    (foreign,) = (schema for schema, channel, _ in found if channel.topic == "svc/reach/one/new")
    assert foreign is None


def test_the_time_of_publishing_is_the_stamp_else_that_of_the_payload_else_that_of_arrival() -> None:
    stamped = state(3)
    bare = Received(stamped.key, stamped.payload, stamped.encoding, None, "", 5)
    assert layout.publish_time(stamped, 5) == stamped.timestamp_ns
    assert layout.publish_time(bare, 5) == StateSample.decode(bare.payload).t
    assert layout.publish_time(Received(bare.key, b"broken", bare.encoding, None, "", 5), 5) == 5
    assert layout.publish_time(Received("spec/s/document", b"", "", None, "", 5), 5) == 5


def test_the_scene_stands_beside_and_is_not_read(tmp_path: Path) -> None:
    def scene(received: Received) -> list[SceneMessage]:
        if received.key != keys.state("a"):
            raise ValueError("nothing to draw")
        message = SceneMessage(
            "/scene", "foxglove.SceneUpdate", "jsonschema", b"{}", "json", b"[1]", received.arrived_ns
        )
        return [message, message._replace(topic="/tf", schema="")]

    with parts(tmp_path, scene=lambda: scene) as writing:
        assert writing.ready()
        messages = [state(0), profile(), state(1)]
        for number, received in enumerate(messages):
            writing.add(layout.Recorded(received, number, received.arrived_ns))
    assert list(read(tmp_path)) == messages
    with writing.files[0].open("rb") as file:
        found = [
            (channel.topic, schema and schema.name, channel.message_encoding, message.data)
            for schema, channel, message in make_reader(file).iter_messages(log_time_order=False)
        ]
    assert found.count(("/scene", "foxglove.SceneUpdate", "json", b"[1]")) == 2
    assert found.count(("/tf", None, "json", b"[1]")) == 2
    drawn: list[str] = []
    list(Reading(tmp_path, scene=lambda schema, channel, message: drawn.append(channel.topic)))
    assert drawn == ["/scene", "/tf"] * 2


def test_a_plain_reader_in_file_order_sees_that_the_head_of_a_chunk_is_damaged(tmp_path: Path) -> None:
    content = bytearray(write(tmp_path, EVERYTHING).read_bytes())
    # Between the opcode of a chunk and what is compressed: length, times, size, checksum, name, and length again.
    place = content.index(b"\x28\xb5\x2f\xfd") - 9 - 8 - 8 - 8 - 4 - 4 - len(b"zstd") - 8
    assert content[place] == Opcode.CHUNK
    content[place] ^= 1 << 5
    with pytest.raises(CRCValidationError):
        list(NonSeekingReader(BytesIO(content), validate_crcs=True).iter_messages(log_time_order=False))


@pytest.mark.parametrize(
    "message",
    [
        Received("fleet/a/state", b"x", "e", 2**64, "", 1),
        Received("fleet/a/state", b"x", "e", None, "", -1),
        Received("fleet/\ud800/state", b"x", "e", None, "", 1),
    ],
    ids=["stamp", "arrival", "key"],
)
def test_what_mcap_has_no_room_for_is_counted_and_spoils_nothing(tmp_path: Path, message: Received) -> None:
    with parts(tmp_path) as writing:
        assert writing.ready()
        for number, received in enumerate([state(0), message, state(1)]):
            assert writing.add(layout.Recorded(received, number, received.arrived_ns))
    assert (writing.recorded, writing.lost) == (2, 1)
    reading = Reading(tmp_path, warn=lambda _: None)
    assert [recorded.received for recorded in reading] == [state(0), state(1)]
    assert reading.missing == 1
