"""A stretch around an instant stands alone: what was in force comes along, and nothing else."""

from datetime import UTC, datetime
from pathlib import Path

import pytest
from mcap.reader import make_reader

from fleet_bus import codec, keys
from fleet_bus.errors import FleetError, RecordingError, UsageError
from fleet_bus.messages import EventKind
from fleet_bus.pubsub import Received
from fleet_recorder import layout, recording_file
from fleet_recorder.incident import Cut, cut, find_event, find_instant
from fleet_recorder.layout import SceneMessage
from fleet_recorder.parts import Rules
from fleet_recorder.reader import Reading, read
from tests.fleet_recorder.made import (
    T0,
    assignment,
    document,
    event,
    parts,
    profile,
    recorded,
    state,
    status,
    token,
    write,
)

SECOND = 10**9


def at(seconds: float) -> int:
    return T0 + round(seconds * SECOND)


def checkpoint(number: int, part: int, count: int, seconds: float) -> Received:
    payload = codec.pack({"se": T0, "r": number, "p": [part, count], "d": bytes(50)})
    encoding = codec.encoding("fleet.checkpoint", 1)
    return Received("svc/reach/one/some-state", payload, encoding, at(seconds), "server", at(seconds))


def journal(number: int, seconds: float) -> Received:
    encoding = codec.encoding("fleet.journal", 1)
    return Received("svc/reach/one/some-log", b"%d" % number, encoding, at(seconds), "server", at(seconds))


#: 100 s of a drive: a sample a second, documents and other things that change in between.
OLD = [document(1), assignment(T0, at=at(1)), token("gone", True, at(2)), token("gone", False, at(3))]
IN_FORCE = [
    profile(at=at(4)),
    document(2, at=at(5)),
    assignment(at(5), at=at(6)),
    status(at(7)),
    token("a", True, at(8)),
]
LATER = [document(3, at=at(70)), status(at(71)), event(EventKind.MISS, at(30)), event(EventKind.CONTRADICTION, at(60))]
CHECKPOINTS = [
    *(checkpoint(10, n, 3, 9 + n / 10) for n in (1, 2, 3)),
    *(checkpoint(20, n, 2, 20 + n / 10) for n in (1, 2)),
    # Begun before the stretch that begins at 30 s, and complete only in it.
    *(checkpoint(30, n, 2, 29.8 + n / 4) for n in (1, 2)),
]
JOURNAL = [journal(n, 15 + n) for n in range(10)]
SAMPLES = [state(n, every=1.0) for n in range(100)]
ALL = sorted([*OLD, *IN_FORCE, *LATER, *CHECKPOINTS, *JOURNAL, *SAMPLES], key=lambda m: m.arrived_ns)


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A recording of it in several files."""
    folder = tmp_path / "drive"
    with parts(folder, Rules(keep_free=0, part_bytes=4000)) as writing:
        assert writing.ready()
        for number, message in enumerate(ALL):
            writing.add(recorded(message, number))
            if number % 10 == 0:
                writing.flush(now=True)
    assert len(writing.files) > 3
    return folder


def made(drive: Path, seconds: float, **more: float | bool) -> tuple[Cut, list[layout.Recorded]]:
    out = drive.parent / "cut.mcap"
    done = cut([*sorted(drive.glob("*.mcap"))], out, at(seconds), **more)  # type: ignore[arg-type]
    return done, list(Reading(out))


def test_the_stretch_and_what_was_in_force_are_in_it(drive: Path) -> None:
    done, found = made(drive, 40.0, before=10.0, after=10.0)
    inside = [m for m in ALL if at(30) <= m.arrived_ns <= at(50)]
    assert [m.received for m in found if not m.carried] == inside
    carried = [m.received for m in found if m.carried]
    assert carried == [*IN_FORCE, *CHECKPOINTS[3:5]]
    assert (done.messages, done.carried, done.checkpoint) == (len(inside), len(carried), True)
    # All at the beginning, with the times at which they came, and the file begins with the stretch.
    assert {m.logged_ns for m in found if m.carried} == {inside[0].arrived_ns}
    assert [m.carried for m in found] == sorted((m.carried for m in found), reverse=True)


def test_sequences_stay_so_that_what_is_missing_is_seen(drive: Path) -> None:
    _, found = made(drive, 40.0, before=10.0, after=10.0)
    numbers = [m.sequence for m in found if not m.carried]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    reading = Reading(drive.parent / "cut.mcap")
    list(reading)
    assert reading.missing == 0


def test_from_the_checkpoint_on_nothing_is_left_out(drive: Path) -> None:
    done, found = made(drive, 40.0, before=10.0, after=10.0, from_checkpoint=True)
    # What the server took in next may have come to the recorder before the checkpoint did.
    inside = [m for m in ALL if CHECKPOINTS[3].arrived_ns - 5 * SECOND <= m.arrived_ns <= at(50)]
    assert [m.received for m in found if not m.carried] == inside
    assert [m.received for m in found if m.carried] == IN_FORCE
    assert done.checkpoint
    assert all(journal in inside for journal in JOURNAL[6:])
    assert CHECKPOINTS[3] in inside
    assert CHECKPOINTS[2] not in [m.received for m in found]


def test_without_a_checkpoint_that_is_said(tmp_path: Path) -> None:
    path = write(tmp_path, SAMPLES)
    out = tmp_path / "cut.mcap"
    assert not cut([path], out, at(50)).checkpoint
    with pytest.raises(RecordingError, match="no checkpoint of a server was recorded before the stretch"):
        cut([path], tmp_path / "other.mcap", at(50), from_checkpoint=True)


def test_a_cut_of_a_cut_and_a_cut_of_a_later_file_are_the_same(drive: Path) -> None:
    """What a file carries is in force in it as if it had come there."""
    _, found = made(drive, 96.0, before=3.0, after=2.0)
    (last,) = sorted(drive.glob("*.mcap"))[-1:]
    first_of_last = next(m for m in Reading(last) if not m.carried)
    assert first_of_last.logged_ns < at(93)
    alone = drive.parent / "alone.mcap"
    cut([last], alone, at(96), before=3.0, after=2.0)
    again = drive.parent / "again.mcap"
    cut([drive.parent / "cut.mcap"], again, at(96), before=3.0, after=2.0)
    assert [m.received for m in Reading(again)] == [m.received for m in found]
    checkpoints = {m.received.key for m in found if m.received.key.endswith("some-state")}
    assert [m.received for m in Reading(alone)] == [m.received for m in found if m.received.key not in checkpoints]


@pytest.mark.parametrize("whole", [True, False])
def test_the_scene_of_the_stretch_comes_along(whole: bool, tmp_path: Path) -> None:
    def scene(received: Received) -> list[SceneMessage]:
        data = b"at %d" % received.arrived_ns
        return [SceneMessage("/scene", "foxglove.SceneUpdate", "jsonschema", b"{}", "json", data, received.arrived_ns)]

    path = write(tmp_path, SAMPLES, scene=lambda: scene)
    if not whole:
        path.write_bytes(path.read_bytes()[:-300])
    out = tmp_path / "cut.mcap"
    done = cut([path], out, at(50), before=2.0, after=2.0, warn=bool)
    with out.open("rb") as file:
        found = [(c.topic, m.data) for _, c, m in make_reader(file).iter_messages(topics=["/scene"])]
    assert found == [("/scene", b"at %d" % SAMPLES[n].arrived_ns) for n in range(48, 52)]
    assert done.scene == len(found) == done.messages


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("0", T0),
        ("12.5", T0 + 12_500_000_000),
        (str(T0 + 5), T0 + 5),
        ("2001-09-09T01:46:40Z", T0),
        ("2001-09-09T01:46:40.25", T0 + 250_000_000),
        ("2001-09-09T03:46:41.000001+02:00", T0 + SECOND + 1000),
    ],
)
def test_an_instant_is_an_iso_time_nanoseconds_or_seconds_from_the_beginning(
    text: str, wanted: int, tmp_path: Path
) -> None:
    path = write(tmp_path, [token("a", True, T0), *SAMPLES])
    assert find_instant([path], text) == wanted


@pytest.mark.parametrize("text", ["yesterday", "-1", "nan", "1e300", "", "2001-13-01"])
def test_what_is_no_instant_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--at"):
        find_instant([write(tmp_path, SAMPLES)], text)


def test_an_event_is_found_by_its_kind_or_its_number(drive: Path) -> None:
    files = sorted(drive.glob("*.mcap"))
    when, found = find_event(files, "contradiction")
    assert (when, found.kind) == (at(60) + 1, EventKind.CONTRADICTION)
    assert find_event(files, "1")[0] == at(30) + 1
    assert find_event(files, "2")[0] == at(60) + 1
    with pytest.raises(RecordingError, match="there are: 1 miss, 1 contradiction"):
        find_event(files, "3")
    with pytest.raises(RecordingError, match="no such event"):
        find_event(files, "behind")
    with pytest.raises(UsageError, match="give a number, or one of unknown_vehicle, "):
        find_event(files, "explosion")


def test_a_stretch_in_which_nothing_came_says_what_there_is_and_leaves_no_file(drive: Path) -> None:
    with pytest.raises(RecordingError) as raised:
        made(drive, 500.0)
    for seconds in (470, 530, 0, 99):
        instant = datetime.fromtimestamp((T0 // SECOND) + seconds, UTC)
        assert f"{instant:%Y-%m-%dT%H:%M:%S}" in str(raised.value)
    assert sorted(path.name for path in drive.parent.iterdir()) == ["drive"]


def test_a_file_that_is_there_is_not_replaced(drive: Path) -> None:
    out = drive.parent / "cut.mcap"
    out.write_bytes(b"mine")
    with pytest.raises(UsageError, match="is there already"):
        made(drive, 40.0)
    assert out.read_bytes() == b"mine"


def test_a_file_that_cannot_be_written_is_said(drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FleetError, match="cannot be written: No such file or directory"):
        cut([*drive.glob("*.mcap")], drive / "no folder" / "cut.mcap", at(40))
    monkeypatch.setattr(recording_file, "MOST_CHANNELS", 4)
    with pytest.raises(UsageError, match="cut a shorter one"):
        made(drive, 40.0)
    assert sorted(path.name for path in drive.parent.iterdir()) == ["drive"]


def test_a_plain_reader_finds_all_of_it(drive: Path) -> None:
    made(drive, 60.0, before=5.0, after=5.0)
    kinds = [m.key for m in read(drive.parent / "cut.mcap") if m.key == keys.event("a")]
    assert kinds == [keys.event("a")]
