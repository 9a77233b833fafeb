"""``fleet record`` beside a router, agents and a server; what it recorded, read and played again."""

import json
import signal
import threading
from functools import partial
from pathlib import Path

import pytest

from fleet_bus import Role, keys, open_session
from fleet_bus.messages import (
    Assignment,
    ReachTube,
    ScenarioDocument,
    ServiceStatus,
    StateFlag,
    StateSample,
    VehicleProfile,
)
from fleet_bus.pubsub import Received, declare_recovering_subscriber, query_cache, subscribe
from fleet_bus.router import Router
from fleet_bus.zenoh_bus import open_bus
from fleet_recorder import layout
from fleet_recorder.files import Folder
from fleet_recorder.parts import Rules
from fleet_recorder.reader import Reading, read
from fleet_recorder.recorder import Recorder
from tests.integration.conftest import Start, run_fleet, serving
from tests.waiting import DEADLINE, wait_until

pytestmark = [pytest.mark.integration, pytest.mark.slow]


def of(messages: list[Received], key: str) -> list[Received]:
    return [m for m in messages if m.key == key]


def test_what_is_on_the_bus_is_in_the_files_to_the_byte_and_plays_again(
    router: Router, start: Start, tmp_path: Path
) -> None:
    endpoint = router.endpoints[0]
    start("side-info", "parking-lot", "--router", endpoint).expect("publishes")
    start("agent", "--vehicle", "car", "--router", endpoint).expect("agents ready")
    folder, summary = tmp_path / "out", tmp_path / "summary.json"
    recording = start(
        "record", "-o", str(folder), "--rotate-minutes", "0.05", "--router", endpoint, "--json", str(summary)
    )
    recording.expect(f"recorder recorder-1 writes to {folder}")
    heard: list[Received] = []
    with open_session(Role.VIEWER, [endpoint]) as session, serving(endpoint):
        with subscribe(session, "**", heard.append):
            wait_until(lambda: len(of(heard, keys.tube("car"))) > 60 and len([*folder.iterdir()]) > 1)
            # A tube of a sample is there after it; both are in the recording before it ends.
            count = len(heard)
            wait_until(lambda: len(heard) > count + 20)
    assert recording.end() == 0
    files = sorted(folder.iterdir())
    found = list(read(folder))
    samples = of(found, keys.state("car"))
    ours = {(m.key, m.payload, m.encoding, m.timestamp_ns) for m in found}
    # Of the last moment some may have come after the recorder was told to end.
    for key in (keys.state("car"), keys.tube("car"), keys.truth("car")):
        for message in of(heard, key)[:-20]:
            assert (message.key, message.payload, message.encoding, message.timestamp_ns) in ours
    decoded = [StateSample.decode(m.payload, m.encoding) for m in samples]
    assert [s.seq for s in decoded] == list(range(len(decoded))), "with the history that the agent's cache held"
    assert decoded[0].flags & StateFlag.HISTORY
    assert len({m.source for m in samples}) == 1 != len({m.source for m in found})
    for key, decode in (
        (keys.profile("car"), VehicleProfile.decode),
        (keys.document("parking-lot"), ScenarioDocument.decode),
        (keys.assignment("parking-lot", "car"), Assignment.decode),
        (keys.service_status("recorder", "recorder-1"), ServiceStatus.decode),
        (keys.service_status("reach", "reach-test"), ServiceStatus.decode),
        (keys.tube("car"), ReachTube.decode),
    ):
        assert of(found, key), key
        for message in of(found, key):
            decode(message.payload, message.encoding)
    assert [layout.is_alive(m) for m in of(found, keys.alive("car"))] == [True]
    # Each file stands on its own.
    for path in files[1:]:
        carried = {m.received.key for m in Reading(path) if m.carried}
        wanted = {keys.profile("car"), keys.document("parking-lot"), keys.assignment("parking-lot", "car")}
        assert carried >= {*wanted, keys.alive("car")}
    told = json.loads(summary.read_text(encoding="utf-8"))
    assert (told["received"], told["recorded"], told["lost"]) == (len(found), len(found), 0)
    assert told["files"] == [str(path) for path in files]


def test_a_recording_played_as_fast_as_it_goes_loses_nothing_and_a_server_works_on_it(
    router: Router, start: Start, tmp_path: Path
) -> None:
    endpoint = router.endpoints[0]
    with Folder(tmp_path / "out") as folder:
        connect = partial(open_bus, Role.SERVICE, [endpoint])
        agent = start("agent", "--vehicle", "car", "--history", "300", "--router", endpoint)
        agent.expect("agents ready")
        stop = threading.Event()
        with Recorder(folder, Rules(keep_free=0), connect) as recorder:
            thread = threading.Thread(target=recorder.run, args=(stop,))
            thread.start()
            wait_until(lambda: recorder.summary().recorded > 400)
            assert agent.end() == 0
            stop.set()
            thread.join(DEADLINE)
    samples = [m for m in read(tmp_path / "out") if m.key == keys.state("car")]
    with Router(["tcp/127.0.0.1:0"]) as other:
        start("reach", "--router", *other.endpoints).expect("ready")
        heard: list[Received] = []
        with open_session(Role.VIEWER, other.endpoints) as session:
            with (
                declare_recovering_subscriber(session, keys.ALL_STATES, heard.append, history=1),
                declare_recovering_subscriber(session, keys.ALL_TUBES, heard.append, history=1),
            ):
                player = start(
                    "replay", str(tmp_path / "out"), "--speed", "max", "--linger", "600", "--router", *other.endpoints
                )  # fmt: skip
                wait_until(lambda: len(of(heard, keys.state("car"))) >= len(samples))
                wait_until(lambda: of(heard, keys.tube("car")))
                # Who comes later finds what is in the cache.
                cached = query_cache(session, keys.state("car"), max_samples=10_000, timeout=10.0)
                player.process.send_signal(signal.SIGINT)
                assert player.end() == 0
    assert [m.payload for m in of(heard, keys.state("car"))] == [m.payload for m in samples]
    assert [m.payload for m in cached] == [m.payload for m in samples][-1200:]
    last = StateSample.decode(samples[-1].payload)
    tube = ReachTube.decode(of(heard, keys.tube("car"))[-1].payload)
    assert (tube.epoch, tube.vehicle) == (last.epoch, "car")


def test_without_a_router_it_is_said() -> None:
    done = run_fleet("record", "-o", "/tmp", "--router", "tcp/127.0.0.1:1")
    assert done.returncode == 1
    assert "no router answers" in done.stderr
