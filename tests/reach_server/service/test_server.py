"""The reach server on a bus in memory, with a clock that a test moves: no network and no real time."""

import threading
from collections.abc import Callable

import numpy as np
import pytest

from fleet_bus import keys
from fleet_bus.bus import Publisher
from fleet_bus.messages import Event, EventKind, Label, ReachTube, ServiceStatus, StateSample, VehicleProfile
from fleet_bus.messages.state import ENCODING
from reach_server.numeric.types import FloatArray
from reach_server.service.server import ReachServer
from tests.memory_bus import Network, Time
from tests.reach_server.drives import START, SVEA, history
from tests.reach_server.service.fleet_desk import SMALL
from tests.waiting import wait_until

SECOND = round(1 / SVEA.dt)


class Car:
    """An agent that publishes the samples of a drive."""

    def __init__(self, network: Network, vehicle: str) -> None:
        bus = network.bus()
        self._token = bus.alive(keys.alive(vehicle))
        self._profiles: Publisher = bus.publisher(keys.profile(vehicle), VehicleProfile.encoding(), cache=1)
        self._states: Publisher = bus.publisher(keys.state(vehicle), ENCODING, cache=1000)
        self._profiles.put(SMALL.encode())
        self._next = 0

    def drive(self, samples: int) -> None:
        for _ in range(samples):
            self.push(np.zeros(4))

    def push(self, off: FloatArray) -> None:
        """Publish the next sample, its state (4,) off by something."""
        k, drive = self._next, history(0)
        sample = StateSample(1, k, START + k * SVEA.dt_ns, drive.measured[k] + off, drive.inputs[k])
        self._states.put(sample.encode())
        self._next += 1

    def vanish(self) -> None:
        self._token.close()


@pytest.fixture
def network() -> Network:
    return Network(Time(0.0, START))


def serve(network: Network, seconds: float, each_sample: Callable[[int], object]) -> ReachServer:
    """A server that has run for so long by its clock; ``each_sample`` is called once a sample time, with its number."""
    stop, done, began = threading.Event(), [0], network.time.now

    def waited(now: float) -> None:
        while done[0] * SVEA.dt <= now - began:
            each_sample(done[0])
            done[0] += 1
        if now - began >= seconds:
            stop.set()

    network.time.on_wait = waited
    with ReachServer("one", clock=network.time, connect=network.bus) as server:
        server.run(stop)
    return server


def tubes(network: Network) -> list[ReachTube]:
    return [ReachTube.decode(m.payload, m.encoding) for m in network.puts if m.key.endswith("/tube")]


def events(network: Network) -> list[tuple[float, EventKind]]:
    found = [Event.decode(m.payload, m.encoding) for m in network.puts if m.key.endswith("/event")]
    return [((event.t - START) / 1e9, event.kind) for event in found]


def test_each_sample_gets_a_tube_and_each_second_a_status(network: Network) -> None:
    car = Car(network, "car")
    car.drive(200)
    network.time.now = 200 * SVEA.dt
    server = serve(network, 3.0, lambda k: car.drive(1))
    found = tubes(network)
    assert [tube.seq for tube in found] == list(range(found[0].seq, found[0].seq + len(found)))
    assert len(found) >= 3 * SECOND - 1
    assert {tube.label for tube in found} == {Label.GUARANTEED}
    assert (found[0].server, found[0].compute_seconds) == ("one", 0.0)
    key = keys.service_status("reach", "one")
    statuses = [ServiceStatus.decode(m.payload) for m in network.puts if m.key == key]
    assert [round((status.t - START) / 1e9) for status in statuses] == [10, 11, 12]
    last = server.status()
    assert last.counters["tubes"] == len(found)
    assert last.counters["failures"] == 0
    assert events(network) == []


def test_a_car_that_falls_silent_without_a_token_is_gone_once(network: Network) -> None:
    car = Car(network, "car")

    def each_sample(k: int) -> None:
        if k < SECOND:
            car.drive(1)
        elif k == SECOND:
            car.vanish()

    serve(network, 8.0, each_sample)
    gone = [t for t, kind in events(network) if kind is EventKind.VEHICLE_GONE]
    assert len(gone) == 1
    # Silence is told from after 2.5 s, and looked for once a second.
    assert 3.5 <= gone[0] <= 4.7


def test_what_came_before_the_server_is_had_from_the_cache(network: Network) -> None:
    car = Car(network, "car")
    with ReachServer("one", clock=network.time, connect=network.bus) as server:
        car.drive(100)
        # What arrived live is thrown away, as if the server had not heard it.
        assert sum(len(batch.vehicles) for batch in server.ingest.drain()) == 100
        car.drive(1)
        server.tick()
        assert len(server.fleet.window_keys("car")) == 1
        network.time.now += 1.0

        def fetched() -> bool:
            server.tick()
            return len(server.fleet.window_keys("car")) == 101

        wait_until(fetched)
    assert sorted(network.closed) == sorted([*network.declared][3:])


def test_two_servers_tell_of_each_other(network: Network) -> None:
    with ReachServer("other", clock=network.time, connect=network.bus) as other:
        status = network.bus().publisher(keys.service_status("reach", "other"), ServiceStatus.encoding(), cache=1)
        serve(network, 1.0, lambda k: status.put(other.status().encode()))
    assert [kind for _, kind in events(network)].count(EventKind.SECOND_SERVER) >= 1


def test_a_round_that_fails_is_counted_and_the_next_one_works(
    network: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    car = Car(network, "car")
    process, rounds = ReachServer.tick, [0]

    def fail_once(server: ReachServer) -> None:
        rounds[0] += 1
        if rounds[0] == 10:
            raise RuntimeError("injected")
        process(server)

    monkeypatch.setattr(ReachServer, "tick", fail_once)
    server = serve(network, 1.0, lambda k: car.drive(1))
    assert server.status().counters["failures"] == 1
    assert server.status().counters["stored"] >= SECOND - 1
