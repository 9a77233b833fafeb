"""The server, looked at by clients that share no code with Foxglove's SDK; the bus is in memory."""

import logging
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
import structlog
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from fleet_bus import keys
from fleet_bus.errors import SessionError
from fleet_bus.messages import Event, EventKind, ScenarioDocument
from fleet_bus.messages import tube as tube_message
from fleet_foxglove import bridge as bridge_module
from fleet_foxglove import topics
from fleet_foxglove.bridge import Bridge
from fleet_foxglove.messages import ALL_TOPICS, Scene
from tests.fleet_bus.messages.examples import T0, a_profile, a_sample, a_tube
from tests.fleet_foxglove import received
from tests.fleet_foxglove.client import Client, connected
from tests.fleet_foxglove.test_scene import lot
from tests.memory_bus import MemoryBus, MemoryHandle, Network
from tests.waiting import DEADLINE, wait_until


@contextmanager
def bridged(network: Network, **options: Any) -> Iterator[Bridge]:
    with Bridge(network.bus(), port=0, clock=network.time, **options) as bridge:
        yield bridge


@contextmanager
def watching(bridge: Bridge, *wanted: str) -> Iterator[Client]:
    """A client whose subscriptions the server has taken, if nobody else has the last one."""
    with connected(bridge.port, len(ALL_TOPICS)) as client:
        client.subscribe(*wanted)
        wait_until(bridge._channels[wanted[-1]].has_sinks)
        yield client


def test_the_server_says_what_there_is_and_takes_nothing() -> None:
    with bridged(Network()) as bridge, connected(bridge.port, len(ALL_TOPICS)) as client:
        assert set(client.channels) == ALL_TOPICS
        assert client.info["capabilities"] == []
        assert client.info["name"] == "fleet-reach"
        schemas = {topic: channel["schemaName"] for topic, channel in client.channels.items()}
        assert schemas == {
            topics.SCENE: "foxglove.SceneUpdate",
            topics.REGIONS: "foxglove.SceneUpdate",
            topics.TRANSFORMS: "foxglove.FrameTransform",
            topics.ORIGIN: "foxglove.FrameTransform",
            topics.LOG: "foxglove.Log",
            topics.NUMBERS: "fleet.numbers",
        }


def test_a_client_of_the_old_protocol_is_turned_away() -> None:
    with bridged(Network()) as bridge:
        for protocols in ([Subprotocol("foxglove.websocket.v1")], None):
            with pytest.raises(InvalidStatus) as caught:
                connect(f"ws://127.0.0.1:{bridge.port}", subprotocols=protocols, open_timeout=DEADLINE)
            assert caught.value.response.status_code == 400


def test_a_client_sees_the_outline_of_the_tube_and_the_bytes_that_are_recorded() -> None:
    network = Network()
    rng = np.random.default_rng(1)
    sent = a_tube(center=rng.normal(0, 1e6, (3, 4)), outline=rng.normal(0, 1, (3, 5, 2)))
    messages = (received.document(keys.profile("svea1"), a_profile()), received.tube(sent))
    recorder = Scene()
    recording = {made.topic: made for what in messages for made in recorder.scene_messages(what)}
    with bridged(network) as bridge, watching(bridge, topics.SCENE) as client:
        for what in messages:
            network.deliver(what)
        bridge.turn()
        message = client.next()
    assert message.payload == recording[topics.SCENE].payload
    assert message.t_ns == recording[topics.SCENE].t_ns == received.ARRIVED
    lines = message.content["entities"][0]["lines"]
    for line, center, outline in zip(lines, sent.center, sent.outline, strict=True):
        assert (line["pose"]["position"]["x"], line["pose"]["position"]["y"]) == tuple(center[:2])
        found = [[point["x"], point["y"]] for point in line["points"]]
        assert found == np.asarray(outline, dtype=np.float32).astype(float).tolist()


def test_of_what_comes_between_two_turns_the_newest_is_shown() -> None:
    network = Network()
    with bridged(network) as bridge, watching(bridge, topics.NUMBERS) as client:
        for seconds in (1.0, 2.0, 3.0):
            network.deliver(received.tube(a_tube(compute_seconds=seconds)))
        network.deliver(received.tube(a_tube(vehicle="svea2")))
        bridge.turn()
        network.deliver(received.tube(a_tube(compute_seconds=4.0)))
        bridge.turn()
        found = [(m.content["vehicle"], m.content["compute_ms"]) for m in (client.next(), client.next(), client.next())]
    assert found == [("svea1", 3000.0), ("svea2", 10.0), ("svea1", 4000.0)]
    assert bridge.thinned == 2


def test_what_a_stranger_puts_on_a_key_hides_nothing_and_is_counted() -> None:
    network = Network()
    with bridged(network) as bridge, watching(bridge, topics.SCENE, topics.TRANSFORMS) as client:
        network.deliver(received.tube(a_tube()))
        key = keys.tube("svea1")
        network.deliver(received.received(key, b"\xc1", tube_message.ENCODING, "stranger"))
        network.deliver(received.received(key, a_tube().encode(), "application/msgpack;fleet.tube.v2", "newer"))
        network.deliver(received.tube(a_tube(vehicle="svea2", t=2**32 * 10**9)))
        bridge.turn()
        assert client.next().content["entities"][0]["id"] == "tube/svea1"
    assert bridge.rejections.snapshot() == {"malformed": 1, "version": 1, "range": 1}


def test_states_may_come_a_little_before_their_profile() -> None:
    network = Network()
    with bridged(network) as bridge, watching(bridge, topics.TRANSFORMS) as client:
        network.deliver(received.state("svea1", a_sample()))
        network.deliver(received.state("svea2", a_sample()))
        bridge.turn()
        network.time.now += bridge_module.PROFILE_SECONDS + 0.1
        network.deliver(received.document(keys.profile("svea1"), a_profile()))
        network.deliver(received.state("svea1", a_sample()))
        network.deliver(received.state("svea2", a_sample()))
        bridge.turn()
        assert client.next().content["child_frame_id"] == "vehicle/svea1"
    assert bridge.rejections.snapshot() == {"no_profile": 1}


def test_what_the_sdk_says_goes_to_the_log_of_the_process() -> None:
    with structlog.testing.capture_logs() as logged:
        with bridged(Network()) as bridge:
            with pytest.raises(InvalidStatus):
                connect(f"ws://127.0.0.1:{bridge.port}", open_timeout=DEADLINE)
            wait_until(lambda: logged)
    assert "handshake failed" in logged[0]["message"]
    assert logging.getLogger("foxglove").handlers == []
    assert logging.getLogger("foxglove").propagate


def test_the_frame_of_a_vehicle_comes_before_what_stands_in_it() -> None:
    network = Network()
    with bridged(network) as bridge, watching(bridge, topics.SCENE, topics.TRANSFORMS) as client:
        network.deliver(received.tube(a_tube()))
        network.deliver(received.state("svea1", a_sample()))
        network.deliver(received.document(keys.profile("svea1"), a_profile()))
        bridge.turn()
        assert [client.next().topic, client.next().topic] == [topics.TRANSFORMS, topics.SCENE]
    assert bridge.rejections.snapshot() == {}


def test_a_latecomer_gets_what_lasts_and_the_first_one_what_was_logged() -> None:
    network = Network()
    event = Event(kind=EventKind.MISS, vehicle="svea1", t=T0, source="reach-1", message="outside")
    with bridged(network, draw_regions=lot(("x", "y"))) as bridge:
        network.deliver(received.document(keys.profile("svea1"), a_profile()))
        document = ScenarioDocument(scenario="lot", version=1, text="-")
        network.deliver(received.document(keys.document("lot"), document))
        network.deliver(received.document(keys.event("svea1"), event))
        network.deliver(received.tube(a_tube()))
        bridge.turn()
        with watching(bridge, topics.REGIONS, topics.ORIGIN, topics.LOG) as first:
            network.time.now += bridge_module.AGAIN_SECONDS
            bridge.turn()
            came = {message.topic: message for message in (first.next(), first.next(), first.next())}
            assert came[topics.LOG].content["message"] == "miss: outside"
            assert came[topics.REGIONS].content["entities"][0]["id"] == "scenario/lot"
            assert came[topics.ORIGIN].content["child_frame_id"] == "fleet"
            with watching(bridge, topics.LOG, topics.NUMBERS) as second:
                network.deliver(received.document(keys.event("svea1"), event.model_copy(update={"message": "again"})))
                bridge.turn()
                # Not what the first one has seen.
                assert second.next().content["message"] == "miss: again"
                assert first.next(lambda m: m.topic == topics.LOG).content["message"] == "miss: again"


def test_nothing_is_encoded_while_nobody_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []
    real = Scene.scene_messages

    def noted(self: Scene, *arguments: Any) -> Any:
        found = list(real(self, *arguments))
        made.extend(message.topic for message in found)
        return found

    monkeypatch.setattr(Scene, "scene_messages", noted)
    network = Network()
    with bridged(network) as bridge:
        network.deliver(received.tube(a_tube()))
        bridge.turn()
        assert made == [topics.ORIGIN]
        with watching(bridge, topics.SCENE):
            network.deliver(received.tube(a_tube()))
            bridge.turn()
        assert made == [topics.ORIGIN, topics.SCENE]


@pytest.mark.slow
def test_a_client_that_takes_nothing_keeps_nobody_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bridge_module, "BACKLOG", 16)
    network = Network()
    outline = np.random.default_rng(0).normal(0, 1, (3, 1000, 2))
    turns = size = 0
    with bridged(network) as bridge, watching(bridge, topics.SCENE):
        # The first client reads nothing from here on, and more comes than sockets and the backlog hold.
        with watching(bridge, topics.SCENE, topics.NUMBERS) as client:
            while size < 30_000_000:
                network.deliver(received.tube(a_tube(seq=turns, outline=outline)))
                bridge.turn()
                message = client.next(lambda m: m.topic == topics.SCENE)
                size += len(message.payload)
                turns += 1
            about = {pair["key"]: pair["value"] for pair in message.content["entities"][0]["metadata"]}
            assert about["sample"] == f"3/{turns - 1}"


def test_it_takes_turns_at_its_rate_until_it_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    network = Network()
    stop = threading.Event()
    turns: list[float] = []
    # How long each turn takes: less than its time, more, and less again.
    lengths = [0.02, 0.01, 0.12, 0.02, 0.0]

    def turn(self: Bridge) -> None:
        turns.append(network.time.now)
        network.time.now += lengths[len(turns) - 1]
        if len(turns) == len(lengths):
            stop.set()

    monkeypatch.setattr(Bridge, "turn", turn)
    with bridged(network, rate=20.0) as bridge:
        bridge.run(stop)
    assert np.allclose(turns, [0.05, 0.10, 0.15, 0.27, 0.32])


class BrokenBus(MemoryBus):
    """Fails at the subscription with number ``fails_at``, from 1."""

    fails_at = 0

    def subscriber(self, *arguments: Any, **options: Any) -> MemoryHandle:
        self.fails_at -= 1
        if self.fails_at == 0:
            raise SessionError("the session is closed")
        return super().subscriber(*arguments, **options)


def test_a_start_that_fails_at_any_step_leaves_nothing_open() -> None:
    network = Network()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    for fails_at in range(1, 7):
        bus = BrokenBus(network, "one")
        bus.fails_at = fails_at
        with pytest.raises(SessionError, match="the session is closed"):
            with Bridge(bus, port=port):
                pytest.fail("it began")
        assert network.subscribers == {}
        assert logging.getLogger("foxglove").handlers == []
    # Its port was given back each time.
    with Bridge(BrokenBus(network, "one"), port=port) as bridge:
        assert bridge.port == port


def test_too_many_messages_at_once_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bridge_module, "MOST_WAITING", 2)
    network = Network()
    event = Event(kind=EventKind.MISS, vehicle="svea1", t=T0, source="reach-1", message="outside")
    with bridged(network) as bridge:
        for vehicle in ("a", "b", "c", "a"):
            network.deliver(received.tube(a_tube(vehicle=vehicle)))
            network.deliver(received.document(keys.event(vehicle), event))
        assert bridge.rejections.snapshot() == {"overflow": 3}


def test_a_port_in_use_is_said_and_nothing_stays_open() -> None:
    network = Network()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(SessionError, match=rf"port {port} of 127\.0\.0\.1 is in use.*--port"):
            with Bridge(network.bus(), port=port):
                pytest.fail("it began")
    assert network.subscribers == {}
    # It is free again, and the second start finds nothing of the first.
    with Bridge(network.bus(), port=port) as bridge:
        assert bridge.port == port


def test_a_host_that_does_not_exist_is_said() -> None:
    with pytest.raises(SessionError, match=r"nothing can listen on nowhere\.invalid"):
        with Bridge(Network().bus(), host="nowhere.invalid", port=0):
            pytest.fail("it began")


def test_its_end_closes_the_port_the_clients_and_the_subscriptions() -> None:
    network = Network()
    with bridged(network) as bridge:
        port = bridge.port
        with connected(port, len(ALL_TOPICS)) as client:
            bridge.__exit__()
            with pytest.raises(ConnectionClosed):
                client.next()
        assert network.subscribers == {}
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", port), DEADLINE)
