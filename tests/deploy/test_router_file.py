"""The shipped router configuration: it serves every vehicle alike, and no reader relies on what it filters."""

import json
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import msgpack
import numpy as np
import pytest
import zenoh
from zenoh import ext

from fleet_bus import Role, keys, open_session
from fleet_bus.messages import StateSample
from fleet_bus.messages.state import ENCODING, MAX_BYTES
from fleet_bus.pubsub import Received, declare_cached_publisher, declare_recovering_subscriber, query_cache, subscribe
from fleet_bus.router import Router
from tests.deploy.units import DEPLOY
from tests.integration.conftest import run_fleet, serving
from tests.waiting import wait_until
from vehicle_agent import svea

FILE = DEPLOY / "router.json5"
ANY_PORT = ["tcp/127.0.0.1:0"]
PROFILE = svea.profile()
pytestmark = pytest.mark.integration


def settings(path: str) -> object:
    return json.loads(zenoh.Config.from_file(FILE).get_json(path))


@pytest.fixture
def shipped() -> Iterator[Router]:
    with Router(ANY_PORT, config_file=FILE) as router:
        yield router


def sample(seq: int) -> bytes:
    return StateSample(1, seq, 10**18 + seq * PROFILE.sample_time_ns, np.zeros(4), np.zeros(2)).encode()


def too_large(seq: int) -> bytes:
    plan = np.zeros((MAX_BYTES // 16 + 1, 2))
    numbers = np.concatenate([np.zeros(6), plan.ravel(), np.zeros(2)]).tobytes()
    # No sample that is encoded is as large as that.
    header = struct.pack("<QQqIHHHHxxxx", 1, seq, 10**18 + seq * PROFILE.sample_time_ns, 0, 4, 2, len(plan), 0)
    big: bytes = msgpack.packb({"d": header + numbers})
    assert len(big) > MAX_BYTES
    return big


def test_it_thins_nothing() -> None:
    assert settings("downsampling") == []


def test_it_asks_for_nothing_that_it_does_not_get(shipped: Router) -> None:
    assert shipped.warnings == ()


KEYS: dict[str, Callable[[str], str]] = {
    "state": keys.state,
    "profile": keys.profile,
    "truth": keys.truth,
    "tube": keys.tube,
    "event": keys.event,
    "document": keys.document,
    "assignment": lambda vehicle: keys.assignment("lot", vehicle),
    "status": lambda instance: keys.service_status("reach", instance),
    # What it thinned before was a key that nobody puts; nor may it any other.
    "anything": lambda vehicle: f"reach/{vehicle}/outline",
}


@pytest.mark.parametrize("kind", list(KEYS))
def test_every_vehicle_is_heard_as_often_as_any_other(kind: str, shipped: Router) -> None:
    vehicles = [f"car{i}" for i in range(5)]
    heard: list[Received] = []
    last: list[Received] = []
    with (
        open_session(Role.AGENT, shipped.endpoints) as agent,
        open_session(Role.VIEWER, shipped.endpoints) as viewer,
        subscribe(viewer, "**", lambda r: (last if r.key == "end" else heard).append(r)),
    ):
        wait_until(lambda: last, meanwhile=lambda: agent.put("end", b""))
        for number in range(20):
            for vehicle in vehicles:
                agent.put(KEYS[kind](vehicle), str(number).encode(), congestion_control=zenoh.CongestionControl.BLOCK)
        last.clear()
        wait_until(lambda: last, meanwhile=lambda: agent.put("end", b""))
    for vehicle in vehicles:
        assert [r.payload for r in heard if r.key == KEYS[kind](vehicle)] == [str(n).encode() for n in range(20)]


def test_it_stops_states_that_are_too_large_live_and_from_a_cache(shipped: Router) -> None:
    heard: list[Received] = []
    with (
        open_session(Role.AGENT, shipped.endpoints) as agent,
        open_session(Role.SERVICE, shipped.endpoints) as service,
        declare_cached_publisher(agent, keys.state("car"), ENCODING, cache=50) as publisher,
        declare_recovering_subscriber(service, keys.ALL_STATES, heard.append, history=50),
    ):
        numbers = iter(range(10_000))
        wait_until(lambda: heard, meanwhile=lambda: publisher.put(sample(next(numbers))))
        publisher.put(too_large(next(numbers)))
        wait_until(lambda: len(query_cache(service, keys.state("car"), max_samples=50, timeout=2.0)) > 0)
        end = next(numbers)
        publisher.put(sample(end))
        wait_until(lambda: heard[-1].payload == sample(end))
    assert max(len(received.payload) for received in heard) <= MAX_BYTES


@pytest.mark.parametrize("filtered", ["", '["put"]', '["put", "reply"]'], ids=["nothing", "puts", "puts and replies"])
def test_a_reader_holds_sizes_whatever_the_router_filters(filtered: str, tmp_path: Path) -> None:
    rule = f"{{flows: ['ingress'], messages: {filtered}, key_exprs: ['fleet/*/state'], size_limit: {MAX_BYTES}}}"
    file = tmp_path / "router.json5"
    file.write_text(f"{{low_pass_filter: [{rule if filtered else ''}]}}", encoding="utf-8")
    with (
        Router(ANY_PORT, config_file=file) as router,
        serving(router.endpoints[0]) as server,
        open_session(Role.AGENT, router.endpoints) as agent,
        declare_cached_publisher(agent, keys.profile("car"), PROFILE.encoding(), cache=1) as profiles,
        declare_cached_publisher(agent, keys.state("car"), ENCODING, cache=50) as publisher,
    ):
        profiles.put(PROFILE.encode())
        wait_until(lambda: server.fleet.profile_of("car") is not None, 10.0)
        for seq in range(30):
            publisher.put(too_large(seq) if seq == 15 else sample(seq))
        wait_until(lambda: (1, 29) in server.fleet.window_keys("car"), 10.0)
        assert [seq for _, seq in server.fleet.window_keys("car")] == [seq for seq in range(30) if seq != 15]
        # What only puts stop comes all the same: a reader fetches what it missed.
        expected = 0 if "reply" in filtered else 1
        assert server.rejections.snapshot().get("too_large", 0) == expected


def test_a_delete_is_refused_counted_and_changes_nothing() -> None:
    cache = ext.CacheConfig(50)
    with (
        Router(ANY_PORT, config_file=FILE) as router,
        open_session(Role.AGENT, router.endpoints) as agent,
        declare_cached_publisher(agent, keys.profile("car"), PROFILE.encoding(), cache=1) as profiles,
    ):
        profiles.put(PROFILE.encode())
        publisher = ext.declare_advanced_publisher(agent, keys.state("car"), encoding=ENCODING, cache=cache)
        for seq in range(20):
            publisher.put(sample(seq))
        publisher.delete()
        wait_until(lambda: list(agent.info.routers_zid()))
        with serving(router.endpoints[0]) as server:
            # Out of the cache, then live.
            wait_until(lambda: len(server.fleet.window_keys("car")) == 20, 10.0)
            wait_until(lambda: server.rejections.snapshot().get("encoding", 0) == 1, 10.0)
            publisher.delete()
            wait_until(lambda: server.rejections.snapshot().get("encoding", 0) == 2, 10.0)
            agent.delete(keys.profile("car"))
            wait_until(lambda: server.rejections.snapshot().get("encoding", 0) == 3, 10.0)
            assert server.fleet.profile_of("car") is not None
            assert [seq for _, seq in server.fleet.window_keys("car")] == list(range(20))
        publisher.undeclare()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("plugins: {rest: {http_port: 8000}, storage_manager: {}}", "plugins (rest, storage_manager) are ignored"),
        (
            "downsampling: [{messages: ['put'], flows: ['egress'], rules: [{key_expr: 'reach/*/tube', freq: 10}]}]",
            "downsampling of reach/*/tube is one rate for all keys together",
        ),
    ],
    ids=["plugins", "downsampling"],
)
def test_what_a_file_asks_for_in_vain_is_said(text: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "router.json5"
    file.write_text(f"{{{text}}}", encoding="utf-8")
    with Router(ANY_PORT, config_file=file) as router:
        (warning,) = router.warnings
    assert said in warning


def test_the_command_says_so_on_stderr(tmp_path: Path) -> None:
    file = tmp_path / "router.json5"
    # It ends at once, since it cannot listen there.
    file.write_text("{plugins: {rest: {}}, listen: {endpoints: ['tcp/192.0.2.77:7447']}}", encoding="utf-8")
    done = run_fleet("router", "--config", str(file))
    assert done.returncode == 1
    assert "warning: plugins (rest) are ignored" in done.stderr


def test_one_key_may_be_thinned(tmp_path: Path) -> None:
    file = tmp_path / "router.json5"
    rule = "{messages: ['put'], flows: ['egress'], rules: [{key_expr: 'reach/car/tube', freq: 10}]}"
    file.write_text(f"{{downsampling: [{rule}]}}", encoding="utf-8")
    with Router(ANY_PORT, config_file=file) as router:
        assert router.warnings == ()
