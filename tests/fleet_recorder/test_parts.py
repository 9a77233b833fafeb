"""When files end and begin, what is removed, and a disk that takes nothing."""

import errno
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.reader import NonSeekingReader

from fleet_bus.errors import UsageError
from fleet_bus.messages import EventKind
from fleet_bus.pubsub import Received
from fleet_recorder import recording_file
from fleet_recorder.files import Folder, file_name
from fleet_recorder.parts import FLUSH_SECONDS, RETRY_SECONDS, Parts, Rules
from fleet_recorder.reader import Reading, read
from tests.fleet_recorder.made import (
    RULES,
    T0,
    assignment,
    document,
    event,
    numbered,
    parts,
    profile,
    recorded,
    state,
    status,
    token,
)
from tests.memory_bus import Time


class Disk:
    """Stands in for ``os.pwrite`` and the free bytes; ``room`` bytes are left."""

    def __init__(self, room: int = 10**12) -> None:
        self.room = room
        self.error = errno.ENOSPC
        self.writes = 0

    def write(self, descriptor: int, data: memoryview, place: int) -> int:
        self.writes += 1
        if self.room <= 0:
            raise OSError(self.error, os.strerror(self.error))
        # As a disk does: as much as there is room for.
        count = os.pwrite(descriptor, data[: self.room], place)
        self.room -= count
        return count

    def free(self, path: Path) -> int:
        return self.room


def whole_chunks(path: Path) -> list[bytes]:
    """What the plain library reads of a file, cut off or not."""
    found = []
    with path.open("rb") as file:
        try:
            for _, _, message in NonSeekingReader(file, validate_crcs=True).iter_messages(log_time_order=False):
                found.append(message.data)
        except Exception:
            return found
    return found


def test_a_chunk_is_on_the_disk_within_a_second_although_the_file_is_open(tmp_path: Path) -> None:
    time = Time()
    with parts(tmp_path, time=time) as writing:
        assert writing.ready()
        writing.add(recorded(state(0), 0))
        writing.flush()
        (path,) = writing.files
        assert whole_chunks(path) == []
        time.now += FLUSH_SECONDS
        assert time.now < 1
        writing.flush()
        assert whole_chunks(path) == [state(0).payload]
        assert writing.recorded == 1


def test_a_full_chunk_is_written_at_once(tmp_path: Path) -> None:
    with parts(tmp_path, Rules(keep_free=0, chunk_bytes=1000)) as writing:
        assert writing.ready()
        for message in numbered(state(n) for n in range(20)):
            writing.add(message)
        assert len(whole_chunks(writing.files[0])) > 10


@pytest.mark.parametrize("sync", [False, True])
def test_syncing_waits_for_the_disk_at_every_chunk(sync: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    monkeypatch.setattr(os, "fsync", synced.append)
    time = Time()
    with parts(tmp_path, Rules(keep_free=0, sync=sync), time=time) as writing:
        assert writing.ready()
        for n in range(3):
            writing.add(recorded(state(n), n))
            writing.flush(now=True)
        assert (len(synced) >= 3) == sync
        assert bool(synced) == sync


def test_each_part_stands_on_its_own(tmp_path: Path) -> None:
    """It begins with the profile, document, assignment, status and tokens in force, as they came, and only these."""
    time = Time()
    in_force = [profile(), document(2), assignment(T0 + 5), status(T0 + 6), token("a", True, T0 + 7)]
    before = [document(1), assignment(T0), token("b", True, T0), *in_force, event(EventKind.MISS, T0), state(0)]
    gone = token("b", False, T0 + 8)
    with parts(tmp_path, Rules(keep_free=0, part_seconds=60), time=time) as writing:
        assert writing.ready()
        for message in numbered([*before, gone]):
            writing.add(message)
        time.now += 60
        writing.flush()
        writing.add(recorded(state(1), 11))
    first, second = writing.files
    assert list(read(first)) == [*before, gone]
    again = list(Reading(second))
    assert [m.received for m in again] == [*in_force, state(1)]
    assert [m.carried for m in again] == [True] * 5 + [False]
    # Where a file begins is not when its oldest message came.
    assert {m.logged_ns for m in again[:5]} == {time.time_ns()}
    # One after the other they are one recording: nothing twice, nothing missing.
    reading = Reading(tmp_path)
    assert [m.received for m in reading] == [*before, gone, state(1)]
    assert reading.missing == 0


def test_a_part_that_is_missing_in_the_middle_is_missed(tmp_path: Path) -> None:
    with parts(tmp_path, Rules(keep_free=0, part_bytes=1)) as writing:
        assert writing.ready()
        for n, received in enumerate([profile(), state(0), state(1)]):
            writing.add(recorded(received, n))
            writing.flush(now=True)
    first, second, third, _ = writing.files
    told: list[str] = []
    reading = Reading([first, third], warn=told.append)
    assert [m.received for m in reading] == [profile(), profile(), state(1)]
    assert reading.missing == 1
    assert f"{third}: 1 messages came to the recorder and are not in the recording" in told[0]
    assert list(read([first, second, third])) == [profile(), state(0), state(1)]


def test_a_part_ends_at_its_size(tmp_path: Path) -> None:
    with parts(tmp_path, Rules(keep_free=0, part_bytes=20_000, chunk_bytes=2000)) as writing:
        assert writing.ready()
        messages = [state(n) for n in range(1000)]
        for message in numbered(messages):
            assert writing.add(message)
    sizes = [path.stat().st_size for path in writing.files]
    assert len(sizes) > 2
    assert all(20_000 <= size < 40_000 for size in sizes[:-1])
    assert list(read(tmp_path)) == messages
    assert writing.bytes == sum(sizes)


@pytest.mark.parametrize("what", ["MOST_CHANNELS", "MOST_PLACES"])
def test_a_part_ends_before_it_has_more_channels_than_mcap_can_count(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording_file, what, 10)
    messages = [state(n, f"car{n}") for n in range(35)]
    with parts(tmp_path) as writing:
        assert writing.ready()
        for message in numbered(messages):
            assert writing.add(message)
    assert len(writing.files) == 4
    assert list(read(tmp_path)) == messages


@pytest.mark.slow
def test_the_oldest_files_go_and_no_others(tmp_path: Path) -> None:
    others = tmp_path / "incident-20200101.mcap"
    others.write_bytes(b"x" * 100_000)
    old = tmp_path / file_name(0, 1)
    old.write_bytes(b"x" * 50_000)
    rules = Rules(keep_free=0, part_bytes=20_000, chunk_bytes=2000)
    with Folder(tmp_path, limit=100_000) as folder:
        writing = Parts(folder, rules, clock=Time())
        assert writing.ready()
        for message in numbered(state(n) for n in range(2000)):
            assert writing.add(message)
            assert sum(size for _, size in folder.files()) <= 100_000
        writing.close()
        assert folder.removed > 1
        kept = [path for path, _ in folder.files()]
    assert others.exists()
    assert not old.exists()
    assert kept == writing.files[-len(kept) :]
    assert 2 <= len(kept) < len(writing.files)
    assert list(read(kept))[-1] == state(1999)


def test_names_sort_by_time_and_part() -> None:
    names = [file_name(T0, 1), file_name(T0, 2), file_name(T0, 10), file_name(T0 + 10**6, 1), file_name(T0 + 10**10, 1)]
    assert names == sorted(names)
    assert names[0] == "fleet-20010909T014640.000Z-000001.mcap"


def test_two_recorders_do_not_share_a_folder(tmp_path: Path) -> None:
    with Folder(tmp_path), pytest.raises(UsageError, match="another recorder writes to"):
        Folder(tmp_path)
    with Folder(tmp_path):
        pass


@pytest.mark.parametrize("kind", ["a file", "below a file", "of the kernel"])
def test_a_folder_that_cannot_be_written_is_refused(kind: str, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_bytes(b"")
    path = {"a file": file, "below a file": file / "x", "of the kernel": Path("/proc/nowhere")}[kind]
    with pytest.raises(UsageError, match="-o"):
        Folder(path)


@pytest.fixture
def full(tmp_path: Path) -> Iterator[tuple[Parts, Disk, Time]]:
    """A recording of some messages whose disk is full from now on, in the middle of a chunk."""
    disk, time = Disk(), Time()
    with parts(tmp_path, time=time, write=disk.write, free=lambda _: 10**12) as writing:
        assert writing.ready()
        for n in range(10):
            assert writing.add(recorded(state(n), n))
        writing.flush(now=True)
        disk.room = 100
        for n in range(10, 20):
            assert writing.add(recorded(state(n), n))
        writing.flush(now=True)
        yield writing, disk, time


def test_a_full_disk_is_said_and_leaves_the_file_whole(full: tuple[Parts, Disk, Time]) -> None:
    writing, disk, time = full
    assert writing.trouble is not None
    assert "No space left on device" in writing.trouble
    assert writing.recorded == 10
    (path,) = writing.files
    reading = Reading(path, warn=lambda _: None)
    assert [m.received for m in reading] == [state(n) for n in range(10)]
    # Not a byte of the chunk that did not fit.
    chunks = path.stat().st_size
    assert whole_chunks(path) == [state(n).payload for n in range(10)]
    assert not writing.ready()
    tries = disk.writes
    assert not writing.ready()
    assert disk.writes == tries, "it is tried once a second"
    time.now += RETRY_SECONDS
    assert not writing.ready()
    assert disk.writes > tries
    assert path.stat().st_size == chunks


def test_recording_goes_on_where_it_ended_once_there_is_room(full: tuple[Parts, Disk, Time]) -> None:
    writing, disk, time = full
    disk.room = 10**9
    time.now += RETRY_SECONDS
    assert writing.ready()
    assert writing.trouble is None
    writing.add(recorded(state(20), 20))
    writing.close()
    assert list(read(writing.files)) == [state(n) for n in range(21)]
    assert (writing.recorded, writing.lost) == (21, 0)


def test_a_recorder_that_ends_while_the_disk_is_full_says_what_is_lost(full: tuple[Parts, Disk, Time]) -> None:
    writing, _, _ = full
    writing.close()
    assert (writing.recorded, writing.lost) == (10, 10)
    assert [r.received for r in Reading(writing.files[0], warn=lambda _: None)] == [state(n) for n in range(10)]


@pytest.mark.parametrize("room", [0, 5000])
def test_a_disk_that_is_full_when_a_file_ends_is_survived(room: int, tmp_path: Path) -> None:
    """Neither the summary of the old file nor the beginning of the new one fits; both come when there is room."""
    disk, time = Disk(), Time()
    rules = Rules(keep_free=0, part_seconds=60)
    messages = [profile(), *(state(n) for n in range(5))]
    with parts(tmp_path, rules, time=time, write=disk.write, free=lambda _: 10**12) as writing:
        assert writing.ready()
        for message in numbered(messages):
            assert writing.add(message)
        writing.flush(now=True)
        disk.room = room
        time.now += 60
        writing.flush()
        assert writing.trouble is not None
        disk.room = 10**9
        time.now += RETRY_SECONDS
        assert writing.ready()
        writing.add(recorded(state(5), 6))
    assert len(writing.files) == 2
    assert list(read(tmp_path)) == [*messages, state(5)]
    assert list(read(writing.files[1])) == [profile(), state(5)]


def test_what_is_kept_free_is_left_to_others(tmp_path: Path) -> None:
    disk, time = Disk(room=10**6), Time()
    rules = Rules(keep_free=900_000)
    with parts(tmp_path, rules, time=time, write=disk.write, free=disk.free) as writing:
        assert writing.ready()
        n = 0
        while writing.trouble is None:
            assert writing.add(recorded(Received("k", os.urandom(5000), "e", None, "", T0), n))
            writing.flush(now=True)
            n += 1
        assert "kept for others" in writing.trouble
        assert disk.room >= 890_000


def test_a_file_that_somebody_removes_is_told_and_the_next_begins(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    with parts(folder) as writing:
        assert writing.ready()
        for message in numbered([profile(), state(0)]):
            writing.add(message)
        writing.flush(now=True)
        writing.add(recorded(state(1), 2))
        writing.files[0].unlink()
        folder.rmdir()
        writing.flush(now=True)
        assert writing.lost == 1
        writing.add(recorded(state(2), 3))
    assert list(read(folder)) == [profile(), state(2)]


def test_a_failing_scene_costs_no_message(tmp_path: Path) -> None:
    def scene(received: Received) -> list[object]:
        raise RuntimeError("cannot draw")

    with parts(tmp_path, RULES, scene=lambda: scene) as writing:
        assert writing.ready()
        writing.add(recorded(state(0), 0))
    assert list(read(tmp_path)) == [state(0)]
