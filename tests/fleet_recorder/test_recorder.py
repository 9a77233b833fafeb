"""The recorder on a bus: everything is there, nothing waits for it, and what is lost is counted."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from fleet_bus import keys
from fleet_bus.messages import Event, EventKind, ReachTube, ServiceStatus
from fleet_bus.pubsub import Received
from fleet_recorder import layout
from fleet_recorder.files import Folder
from fleet_recorder.parts import Parts, Rules
from fleet_recorder.reader import Reading, read
from fleet_recorder.recorder import OVERHEAD, Recorder, Summary
from tests.fleet_recorder.made import RULES, T0, assignment, document, event, profile, state, status
from tests.fleet_recorder.test_parts import Disk
from tests.memory_bus import MemoryBus, Network


@contextmanager
def recording(folder: Path, network: Network, rules: Rules = RULES, **more: Any) -> Iterator[Recorder]:
    with Folder(folder) as opened:
        with Recorder(opened, rules, network.bus, clock=network.time, **more) as recorder:
            yield recorder


def put(bus: MemoryBus, message: Received, cache: int = 1) -> None:
    bus.publisher(message.key, message.encoding, cache=cache).put(message.payload)


def come(recorder: Recorder, *messages: Received) -> None:
    for message in messages:
        recorder.put(message)


def payloads(path: Path) -> dict[str, list[bytes]]:
    found: dict[str, list[bytes]] = {}
    for received in read(path, warn=bool):
        found.setdefault(received.key, []).append(received.payload)
    return found


def test_everything_on_the_bus_is_recorded_what_was_there_before_too(tmp_path: Path) -> None:
    network = Network()
    other = network.bus()
    tube = Received(keys.tube("a"), b"tube", ReachTube.__name__, None)
    journal = Received("svc/reach/one/some-log", b"log", "application/msgpack;fleet.new.v1", None)
    told = Received(keys.service_event("reach", "one"), b"told", Event.encoding(), None)
    truth = Received(keys.truth("a"), b"truth", state(0).encoding, None)
    early = [profile(), document(1), assignment(T0), status(T0), event(EventKind.MISS, T0), state(0), tube]
    late = [state(1), told, journal, truth, document(2)]
    for message in early:
        put(other, message)
    with other.alive(keys.alive("a")), recording(tmp_path, network) as recorder:
        for message in late:
            put(other, message)
        recorder.step()
    found = payloads(tmp_path)
    for message in [*early, *late]:
        assert message.payload in found[message.key], message.key
    tokens = [r for r in read(tmp_path, warn=bool) if r.encoding == layout.TOKEN]
    assert [(t.key, layout.is_alive(t)) for t in tokens if t.key == "fleet/a/alive"] == [("fleet/a/alive", True)]
    assert {r.source for r in read(tmp_path) if r.encoding != layout.TOKEN} == {other.session_id}
    assert recorder.summary().lost == 0


def test_tokens_that_come_and_go_are_records(tmp_path: Path) -> None:
    network = Network()
    with recording(tmp_path, network):
        with network.bus().alive(keys.alive("a")):
            network.time.now += 1
    alive = [(r.key, layout.is_alive(r), r.arrived_ns) for r in read(tmp_path) if r.key == "fleet/a/alive"]
    assert alive == [("fleet/a/alive", True, T0), ("fleet/a/alive", False, T0 + 10**9)]


def test_it_works_until_told_to_stop_and_tells_how_it_is(tmp_path: Path) -> None:
    network, stop = Network(), threading.Event()
    told: list[Summary] = []
    heard: list[Received] = []
    viewer = network.bus()
    viewer.subscriber(keys.ALL_STATUS, heard.append, history=1)

    def later(now: float) -> None:
        if now >= 3:
            stop.set()

    network.time.on_wait = later
    with recording(tmp_path, network) as recorder:
        put(viewer, state(0))
        recorder.run(stop, told.append)
    statuses = [ServiceStatus.decode(r.payload, r.encoding) for r in heard]
    assert all(1.0 <= (b.t - a.t) / 1e9 < 1.2 for a, b in pairwise(statuses))
    assert len(statuses) >= 3
    assert (statuses[-1].kind, statuses[-1].instance) == ("recorder", "recorder-1")
    assert statuses[-1].counters["recorded"] >= 1
    assert statuses[-1].gauges["disk_free"] > 0
    assert statuses[-1].problems == []
    assert told[-1].received >= told[0].received
    assert network.tokens == []


def test_what_finds_the_queue_full_is_counted_and_told(tmp_path: Path) -> None:
    network = Network()
    size = len(state(0).payload) + OVERHEAD
    with recording(tmp_path, network, queue_bytes=10 * size + size // 2) as recorder:
        recorder.step()
        come(recorder, *(state(n) for n in range(15)))
        summary = recorder.summary()
        assert summary.lost == 15 - 10
        recorder.step()
        come(recorder, state(15))
        assert recorder.status().refused == {"overflow": 5}
        assert "5 messages were not recorded" in recorder.status().problems[0]
    told: list[str] = []
    reading = Reading(tmp_path, warn=told.append)
    samples = [m.received for m in reading if m.received.key == keys.state("a")]
    assert samples == [*(state(n) for n in range(10)), state(15)]
    assert reading.missing == 5
    assert "5 messages came to the recorder and are not in the recording" in told[0]


def test_a_full_disk_is_told_waited_for_and_costs_only_what_there_is_no_room_for(tmp_path: Path) -> None:
    network, disk = Network(), Disk()
    size = len(state(0).payload) + OVERHEAD
    full = partial(Parts, write=disk.write, free=lambda _: 10**12)
    with recording(tmp_path, network, parts=full, queue_bytes=20 * size + size // 2) as recorder:
        recorder.step()
        come(recorder, *(state(n) for n in range(5)))
        recorder.step()
        recorder.parts.flush(now=True)
        written = recorder.summary().recorded
        disk.room = 0
        network.time.now += 1
        come(recorder, *(state(n) for n in range(5, 10)))
        recorder.step()
        assert recorder.status().problems == [f"nothing can be recorded now: {tmp_path}: No space left on device"]
        come(recorder, *(state(n) for n in range(10, 40)))
        for _ in range(3):
            network.time.now += 1
            recorder.step()
        assert recorder.summary().recorded == written
        # One was in the chunk that did not fit, four waited already.
        assert recorder.summary().lost == 4 + 30 - 20
        disk.room = 10**9
        network.time.now += 1
        recorder.step()
        assert recorder.parts.trouble is None
        come(recorder, state(40))
    samples = [r for r in read(tmp_path, warn=bool) if r.key == keys.state("a")]
    assert samples == [*(state(n) for n in range(26)), state(40)]


def test_a_recorder_that_ends_on_a_full_disk_counts_what_waits_as_lost(tmp_path: Path) -> None:
    network, disk = Network(), Disk()
    with recording(tmp_path, network, parts=partial(Parts, write=disk.write, free=lambda _: 10**12)) as recorder:
        recorder.step()
        recorder.parts.flush(now=True)
        written = recorder.summary().recorded
        disk.room = 0
        come(recorder, state(0), state(1))
        recorder.step()
        recorder.parts.flush(now=True)
        come(recorder, state(2))
    summary = recorder.summary()
    assert (summary.recorded, summary.waiting) == (written, 0)
    assert summary.lost == summary.received - written >= 3


def test_a_disk_that_is_full_from_the_start_loses_nothing_that_the_queue_holds(tmp_path: Path) -> None:
    network, disk = Network(), Disk()
    disk.room = 0
    parts = partial(Parts, write=disk.write, free=disk.free)
    with recording(tmp_path, network, Rules(keep_free=10), parts=parts) as recorder:
        come(recorder, state(0))
        recorder.step()
        assert "kept for others" in recorder.status().problems[0]
        disk.room = 10**9
        network.time.now += 1
        come(recorder, state(1))
        recorder.step()
    assert [r for r in read(tmp_path) if r.key == keys.state("a")] == [state(0), state(1)]


def test_each_file_has_what_is_put_for_a_recorder_that_comes(tmp_path: Path) -> None:
    """Servers see a new token before the old one goes, so that they never believe that nobody records."""
    network = Network()
    server = network.bus()
    there: set[str] = set()
    seen: list[set[str]] = []

    def answer(key: str, alive: bool) -> None:
        (there.add if alive else there.discard)(key)
        seen.append(set(there))
        if alive:
            put(
                server, Received("svc/reach/one/some-state", b"s%d" % len(seen), "application/msgpack;fleet.x.v1", None)
            )

    server.watch_alive("svc/recorder/*", answer)
    rules = Rules(keep_free=0, part_seconds=10)
    with recording(tmp_path, network, rules, extra=lambda: [status(T0)]) as recorder:
        for _ in range(3):
            recorder.step()
            network.time.now += 10
        recorder.step()
        files = recorder.parts.files
    assert all(seen[:-1])
    assert len(files) == 4
    for path in files:
        found = payloads(path)
        assert len(found["svc/reach/one/some-state"]) == 1, path
        assert found[keys.service_status("reach", "one")][-1] == status(T0).payload


def test_a_file_that_begins_when_it_ends_asks_nobody(tmp_path: Path) -> None:
    network = Network()
    asked: list[int] = []

    def extra() -> list[Received]:
        asked.append(len(network.tokens))
        return []

    with recording(tmp_path, network, Rules(keep_free=0, chunk_bytes=3000, part_bytes=6000), extra=extra) as recorder:
        recorder.step()
        come(recorder, *(state(n) for n in range(500)))
        before = list(asked)
    assert len(recorder.parts.files) > 2
    assert asked == before


def test_files_that_are_full_when_they_begin_do_not_keep_it_from_going_on(tmp_path: Path) -> None:
    network = Network()
    with recording(tmp_path, network, Rules(keep_free=0, chunk_bytes=1, part_bytes=1)) as recorder:
        come(recorder, state(0))
        recorder.step()
        recorder.step()
    assert state(0) in list(read(tmp_path))


def test_what_cannot_be_had_costs_nothing_else(tmp_path: Path) -> None:
    def broken() -> list[Received]:
        raise RuntimeError("no answer")

    network = Network()
    with recording(tmp_path, network, extra=broken) as recorder:
        recorder.step()
        come(recorder, state(0))
    assert state(0) in list(read(tmp_path))


def test_a_bus_that_takes_no_status_stops_nothing(tmp_path: Path) -> None:
    network, stop = Network(), threading.Event()
    with recording(tmp_path, network) as recorder:
        network.broken = RuntimeError("closed")
        network.time.on_wait = lambda now: stop.set() if now > 2 else None
        come(recorder, state(0))
        recorder.run(stop)
    assert state(0) in list(read(tmp_path))


def test_an_id_that_can_be_no_part_of_a_key_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="service id"), recording(tmp_path, Network(), instance="a b"):
        pass
