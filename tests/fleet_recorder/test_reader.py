"""Files that are cut off, damaged, of others, of later days: said as such, with what to do."""

import os
import re
from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer

from fleet_bus import codec
from fleet_bus.errors import RecordingError
from fleet_bus.pubsub import Received
from fleet_recorder import chunks, layout
from fleet_recorder.parts import Rules
from fleet_recorder.reader import newer_than, read
from tests.fleet_recorder.made import T0, numbered, parts, state, write


def foreign(path: Path, channels: int = 2, finish: bool = True) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema("nav_msgs/msg/Odometry", "ros2msg", b"...")
        for n in range(channels):
            channel = writer.register_channel(f"/odometry/{n}", "cdr", schema)
            writer.add_message(channel, n, b"x", n)
        writer.flush()  # type: ignore[no-untyped-call]
        if finish:
            writer.finish()  # type: ignore[no-untyped-call]
    return path


def raises(path: Path, *words: str) -> None:
    with pytest.raises(RecordingError) as raised:
        list(read(path, warn=bool))
    for word in (str(path), *words):
        assert word in str(raised.value)


def test_a_missing_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="there is no such file"):
        read(tmp_path / "nowhere.mcap")


def test_an_empty_file_is_said(tmp_path: Path) -> None:
    path = tmp_path / "empty.mcap"
    path.write_bytes(b"")
    raises(path, "the file is empty")


@pytest.mark.parametrize("content", [b"PK\x03\x04 an NPZ", b"\x89PNG\r\n\x1a\n", b"{}", b"\x89MCAP1\r\n" + bytes(100)])
def test_what_is_no_mcap_file_is_said(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    raises(path, "not an MCAP file", "`fleet record`")


def test_a_folder_without_recordings_is_said(tmp_path: Path) -> None:
    raises(tmp_path, "no recordings (*.mcap) in this folder")


@pytest.mark.parametrize("finish", [True, False], ids=["whole", "cut off"])
def test_a_file_of_others_is_said_with_what_is_in_it(finish: bool, tmp_path: Path) -> None:
    path = foreign(tmp_path / "bag.mcap", 11, finish)
    raises(
        path, "without messages of a fleet's bus", "/odometry/0 (nav_msgs/msg/Odometry)", "and 3 more", "`fleet record`"
    )


def test_a_recording_in_which_nothing_came_is_said(tmp_path: Path) -> None:
    with parts(tmp_path) as writing:
        assert writing.ready()
    raises(writing.files[0], "no messages of the bus", "nothing came")


def whole_and_cut(tmp_path: Path) -> tuple[bytes, list[Received]]:
    messages = [state(n) for n in range(60)]
    with parts(tmp_path, Rules(keep_free=0, chunk_bytes=1500)) as writing:
        assert writing.ready()
        for message in numbered(messages):
            assert writing.add(message)
    return writing.files[0].read_bytes(), messages


def read_what_is_there(path: Path) -> tuple[list[Received], list[str]]:
    """Messages of a file, and all that was told about it, errors too."""
    found: list[Received] = []
    told: list[str] = []
    try:
        for received in read(path, warn=told.append):
            found.append(received)
    except RecordingError as error:
        told.append(str(error))
    return found, told


@pytest.mark.slow
def test_a_file_that_is_cut_off_anywhere_gives_what_is_whole_and_says_so(tmp_path: Path) -> None:
    content, messages = whole_and_cut(tmp_path / "whole")
    path = tmp_path / "cut.mcap"
    most = 0
    for length in range(1, len(content) - 8, 31):
        path.write_bytes(content[:length])
        found, told = read_what_is_there(path)
        assert found == messages[: len(found)]
        assert len(found) >= most, "more of the file gives no less"
        most = len(found)
        assert f"cut off, or still being written: {len(found)} messages came" in told[0]
        assert bool(found) == (len(told) == 1)
    assert most == len(messages)
    path.write_bytes(content)
    assert read_what_is_there(path) == (messages, [])


@pytest.mark.slow
def test_a_flipped_bit_is_never_taken_for_a_message_and_never_passes_in_silence(tmp_path: Path) -> None:
    content, messages = whole_and_cut(tmp_path / "whole")
    path = tmp_path / "flipped.mcap"
    errors = 0
    for place in range(8, len(content) - 8, 11):
        flipped = bytearray(content)
        flipped[place] ^= 1 << place % 8
        path.write_bytes(flipped)
        found, told = read_what_is_there(path)
        errors += bool(told)
        rest = iter(messages)
        assert all(message in rest for message in found), "in order, and none that did not come"
        # Else it was in the summary, or an index, which are for other readers.
        assert told or found == messages
    assert errors > 100


def test_a_damaged_chunk_is_said_with_its_place(tmp_path: Path) -> None:
    content, messages = whole_and_cut(tmp_path / "whole")
    path = tmp_path / "damaged.mcap"
    # Inside of what was compressed, of the third chunk.
    inside = [match.start() for match in re.finditer(re.escape(b"\x28\xb5\x2f\xfd"), content)][2] + 30
    path.write_bytes(content[:inside] + bytes(20) + content[inside + 20 :])
    found, told = read_what_is_there(path)
    assert found
    assert found == messages[: len(found)]
    assert "damaged at byte" in told[-1]
    assert "what stands before it is sound" in told[-1]


def test_lengths_that_a_file_claims_take_no_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunks, "MOST_BYTES", 5000)
    path = tmp_path / "large.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start()
        channel = writer.register_channel("k", "x", 0, {layout.FLEET: "1"})
        writer.add_message(channel, 1, bytes(100_000), 1)
        writer.finish()  # type: ignore[no-untyped-call]
    assert path.stat().st_size < 5000
    raises(path, "at most 5000 are read")
    huge = tmp_path / "huge.mcap"
    huge.write_bytes(path.read_bytes()[:8] + b"\x06" + (10_000).to_bytes(8, "little") + bytes(10_000))
    raises(huge, "at most 5000 are read")


@pytest.mark.parametrize(
    ("details", "words"),
    [
        ({"format": "2"}, "it has the layout 2, this program reads 1"),
        (
            {"schemas": "fleet.state.v2 fleet.tube.v1 fleet.other.v7"},
            "it knows fleet.state.v2, this program fleet.state.v1",
        ),
    ],
)
def test_a_recording_of_a_newer_version_is_said_with_what_is_newer(
    details: dict[str, str], words: str, tmp_path: Path
) -> None:
    with parts(tmp_path, details=details) as writing:
        assert writing.ready()
        for message in numbered([state(0)]):
            writing.add(message)
    raises(writing.files[0], "recorded by a newer version of fleet-reach", words, "update to read it")


def test_a_channel_of_a_newer_layout_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(layout, "FORMAT", 3)
    path = write(tmp_path, [state(0)])
    monkeypatch.undo()
    raises(path, "recorded by a newer version of fleet-reach", "3")


def test_a_message_newer_than_its_recorder_comes_as_it_is_and_is_told_once(tmp_path: Path) -> None:
    """A server refused it then, and will again: that is part of what happened."""
    newer = [Received("fleet/a/state", b"new", codec.encoding("fleet.state", 2), None, "x", T0 + n) for n in range(3)]
    told: list[str] = []
    path = write(tmp_path, [*newer, state(0)])
    assert list(read(path, warn=told.append)) == [*newer, state(0)]
    assert [
        line for line in told if "fleet.state.v2 on fleet/a/state: this program reads fleet.state.v1" in line
    ] == told
    assert len(told) == 1


def test_versions_are_compared_as_numbers() -> None:
    assert newer_than("fleet.state.v10")
    assert newer_than("fleet.token.v2")
    assert not newer_than("fleet.state.v1")
    assert not newer_than("fleet.nobody_knows.v9")
    assert not newer_than("")


def test_other_channels_beside_ours_are_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "both.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        other = writer.register_channel("/camera", "cdr", 0)
        metadata = layout.metadata(state(0), False)
        ours = writer.register_channel("fleet/a/state", "msgpack", 0, metadata)
        writer.add_message(other, 1, b"picture", 1)
        writer.add_message(ours, state(0).arrived_ns, state(0).payload, state(0).timestamp_ns or 0, 5)
        writer.finish()  # type: ignore[no-untyped-call]
    assert list(read(path)) == [state(0)]


@pytest.mark.slow
def test_reading_holds_one_chunk_and_not_the_file(tmp_path: Path) -> None:
    import tracemalloc

    payloads = [os.urandom(10_000) for _ in range(20)]
    count = 3000
    path = write(tmp_path, (Received("k", payloads[n % 20], "e", None, "", T0 + n) for n in range(count)))
    tracemalloc.start()
    try:
        assert sum(1 for _ in read(path)) == count
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 10 * (1 << 20) < count * 10_000


def test_a_file_that_is_still_being_written_can_be_read(tmp_path: Path) -> None:
    told: list[str] = []
    with parts(tmp_path) as writing:
        assert writing.ready()
        for message in numbered([state(0), state(1)]):
            writing.add(message)
        writing.flush(now=True)
        assert list(read(writing.files[0], warn=told.append)) == [state(0), state(1)]
    assert "still being written: 2 messages came" in told[0]
