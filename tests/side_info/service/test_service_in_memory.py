"""The side-info service on a bus in memory, with a clock that a test moves: no network and no real time."""

import itertools
import threading
from collections.abc import Callable

import numpy as np
import pytest

from fleet_bus import keys
from fleet_bus.bus import Publisher
from fleet_bus.messages import Assignment, ScenarioDocument, ServiceStatus, StateFlag, StateSample
from fleet_bus.messages.state import ENCODING
from side_info import Scenario
from side_info.service.service import SideInfoService
from tests.memory_bus import Network, Time
from tests.side_info.corpus import DOCUMENT

LOT = Scenario.parse(DOCUMENT)
NEW, NONE = StateFlag.NEW_TRAJECTORY, StateFlag.NONE


def serve(service: SideInfoService, network: Network, seconds: float, at: dict[float, Callable[[], object]]) -> None:
    """Run a service for so long by its clock; ``at`` says what happens when."""
    stop, waiting = threading.Event(), sorted(at.items())

    def waited(now: float) -> None:
        while waiting and waiting[0][0] <= now:
            waiting.pop(0)[1]()
        if now >= seconds:
            stop.set()

    network.time.on_wait = waited
    service.run(stop)
    assert not waiting


def put(publisher: Publisher, epoch: int, *samples: tuple[int, StateFlag]) -> None:
    for t, flags in samples:
        publisher.put(StateSample(epoch, t, t, np.zeros(2), np.zeros(0), flags).encode())


def assignments(network: Network) -> list[tuple[str, int]]:
    found = [Assignment.decode(m.payload, m.encoding) for m in network.puts if "/assignment/" in m.key]
    return [(assignment.vehicle, assignment.time_zero) for assignment in found]


def test_the_status_comes_every_second() -> None:
    network = Network()
    serve(SideInfoService(network.bus(), [LOT], {}, "a", clock=network.time), network, 3.5, {})
    key = keys.service_status("side-info", "a")
    found = [ServiceStatus.decode(message.payload) for message in network.puts if message.key == key]
    assert len(found) == 4
    assert [b.t - a.t for a, b in itertools.pairwise(found)] == pytest.approx([10**9] * 3, abs=21 * 10**6)
    assert {(s.kind, s.instance, s.gauges["scenarios"]) for s in found} == {("side-info", "a", 1)}


@pytest.mark.parametrize("back", [-3600.0, 3600.0])
def test_a_clock_that_is_set_does_not_silence_the_status(back: float) -> None:
    network = Network()
    instants: list[float] = []
    network.on_put = lambda: instants.append(network.time.now)

    class Set(Time):
        def time_ns(self) -> int:
            return 10**18 + round((self.now + (back if self.now > 1.5 else 0.0)) * 1e9)

    network.time = Set()
    serve(SideInfoService(network.bus(), [], {}, "a", clock=network.time), network, 4.0, {})
    assert max(b - a for a, b in itertools.pairwise(instants)) < 1.1


def test_time_zero_is_taken_from_the_cache_then_moved_and_not_by_a_second_source() -> None:
    network = Network()
    agent, stranger = network.bus(), network.bus()
    states = agent.publisher(keys.state("svea1"), ENCODING, cache=100)
    forged = stranger.publisher(keys.state("svea1"), ENCODING, cache=100)
    put(states, 1, (1000, NEW), (1050, NONE))
    service = SideInfoService(network.bus(), [LOT], {"*": "lot"}, "a", history=1, clock=network.time)
    serve(
        service, network, 10.0,
        {
            1.0: lambda: put(states, 1, (2000, NEW)),
            1.5: lambda: put(forged, 7, (3000, NEW)),
            2.0: lambda: put(states, 1, (2050, NONE)),
        },
    )  # fmt: skip
    # The first source has been silent for so long at the end that the other one counts.
    assert assignments(network) == [("svea1", 1000), ("svea1", 2000), ("svea1", 3000)]


def test_plain_queries_get_the_newest_documents_while_the_service_runs() -> None:
    network, found = Network(), []
    service = SideInfoService(network.bus(), [LOT], {}, "a", clock=network.time)
    serve(service, network, 1.0, {0.5: lambda: found.extend(network.ask(keys.ALL_DOCUMENTS))})
    document = ScenarioDocument(scenario=LOT.name, version=LOT.version, text=LOT.text)
    assert found == [(keys.document("lot"), document.encode(), ScenarioDocument.encoding())]
    assert network.ask(keys.ALL_DOCUMENTS) == []
    assert sorted(network.closed) == sorted(network.declared)
