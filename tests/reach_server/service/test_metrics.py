"""What a reach server tells Prometheus while it works, on a bus in memory, scraped over HTTP."""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from fleet_bus import metrics
from fleet_bus.messages import EventKind, Label
from reach_server.service.metrics import metrics as of_server
from reach_server.service.server import ReachServer
from reach_server.service.stages import STAGES, Stages
from tests.memory_bus import Network, Time
from tests.reach_server.drives import START, SVEA
from tests.reach_server.service.test_server import Car
from tests.scrapes import Values, fetch, reach_text, values

SECOND = round(1 / SVEA.dt)


@pytest.fixture
def network() -> Network:
    return Network(Time(0.0, START))


class Slow(Time):
    """Whoever looks at it spends a microsecond."""

    def monotonic(self) -> float:
        self.now += 1e-6
        return self.now


def one(found: Values, name: str, **labels: str) -> float:
    return found[name, tuple(sorted(labels.items()))]


def by(found: Values, name: str, label: str) -> dict[str, float]:
    """Values by a label, zeros left out."""
    return {dict(labels)[label]: value for (known, labels), value in found.items() if known == name and value}


def serve_and_scrape(network: Network, samples: int, each_sample: Callable[[int], object]) -> tuple[Values, Values]:
    """What a server says in the middle of its work and at the end of so many sample times."""
    stop, done = threading.Event(), [0]
    scraped: list[Values] = []
    network.time.now = 200 * SVEA.dt
    server = ReachServer("one", clock=network.time, connect=network.bus)
    with metrics.serve(metrics.registry("reach", "one", lambda: of_server(server.counters)), "0") as url, server:

        def waited(now: float) -> None:
            while (200 + done[0]) * SVEA.dt <= now:
                each_sample(done[0])
                done[0] += 1
            if done[0] >= samples // 2 and not scraped:
                scraped.append(values(fetch(url)))
            if done[0] >= samples:
                stop.set()

        network.time.on_wait = waited
        server.run(stop)
        scraped.append(values(fetch(url)))
    return scraped[0], scraped[1]


@pytest.mark.slow
def test_it_says_what_happens(network: Network) -> None:
    car = Car(network, "car")
    car.drive(200)
    wild = network.bus().publisher("fleet/car/state", "application/msgpack;fleet.state.v1", cache=1)

    def each_sample(k: int) -> None:
        car.drive(1)
        if k == SECOND:
            wild.put(b"nonsense")

    middle, end = serve_and_scrape(network, 4 * SECOND, each_sample)
    assert one(end, "fleet_reach_states_total") == 200 + 4 * SECOND + 1
    assert by(end, "fleet_refused_total", "reason") == {"malformed": 1}
    tubes = one(end, "fleet_reach_tubes_total", label="guaranteed", method="set_membership")
    assert 4 * SECOND - 1 <= tubes <= 4 * SECOND + 1
    assert tubes == sum(by(end, "fleet_reach_tubes_total", "label").values())
    assert one(middle, "fleet_reach_tubes_total", label="guaranteed", method="set_membership") < tubes
    assert one(end, "fleet_reach_tube_latency_seconds_count") == tubes
    assert one(end, "fleet_reach_batch_samples_sum") == one(end, "fleet_reach_stored_total")
    checked, inside = one(end, "fleet_reach_checked_total"), one(end, "fleet_reach_inside_total")
    assert checked == inside >= 4 * SECOND - 2
    assert (one(end, "fleet_reach_misses_total"), one(end, "fleet_reach_expected_misses_total")) == (0, 0)
    assert by(end, "fleet_reach_vehicles", "state") == {"tube": 1}
    assert by(end, "fleet_reach_newest_tubes", "label") == {"guaranteed": 1}
    assert one(end, "fleet_reach_engines") == 1
    assert one(end, "fleet_reach_round_timestamp_seconds") == pytest.approx(network.time.time_ns() / 1e9, abs=0.1)
    # A counter never falls.
    falls = {k for k, v in middle.items() if k[0].endswith(("_total", "_count", "_bucket", "_sum")) and end[k] < v}
    assert falls == set()


@pytest.mark.slow
def test_a_vehicle_that_waits_and_one_whose_bounds_are_wrong(network: Network) -> None:
    car, young = Car(network, "car"), Car(network, "young")
    car.drive(200)
    wild = Car(network, "wild")
    wild.drive(200)

    def each_sample(k: int) -> None:
        car.drive(1)
        if k == 3 * SECOND:
            young.drive(1)
        if k > 0 and k % 2:
            # Off by far more than the noise that its profile states, by less than a jump.
            wild.push(np.array([0.0, 0.15, 0.0, 0.0]))
        else:
            wild.drive(1)

    _, end = serve_and_scrape(network, 6 * SECOND, each_sample)
    states = by(end, "fleet_reach_vehicles", "state")
    assert states["waiting"] + states["tube"] == 3
    assert by(end, "fleet_reach_newest_tubes", "label")[str(Label.CONTRADICTED)] == 1
    assert one(end, "fleet_reach_misses_total") > 0
    assert one(end, "fleet_reach_checked_total") > one(end, "fleet_reach_misses_total")
    assert by(end, "fleet_reach_events_total", "kind").keys() & {str(EventKind.MISS), str(EventKind.DATA_CONTRADICTED)}


@pytest.mark.slow
def test_the_time_of_rounds_is_divided_by_stage_and_other_threads_may_ask_meanwhile() -> None:
    network = Network(Slow(0.0, START))
    car = Car(network, "car")
    car.drive(200)
    began, stop, asked = 200 * SVEA.dt, threading.Event(), [0]
    network.time.now = began
    network.time.on_wait = lambda now: car.drive(1) if now < began + 3.0 else stop.set()
    server = ReachServer("one", clock=network.time, connect=network.bus)

    def ask() -> None:
        while not stop.is_set():
            names = {family.name for family in of_server(server.counters)}
            assert len(names) > 20
            asked[0] += 1

    with ThreadPoolExecutor(1) as pool, server:
        asking = pool.submit(ask)
        try:
            server.run(stop)
        finally:
            stop.set()
        asking.result()
    assert asked[0] > 0
    spent = server.counters().seconds
    assert all(spent[stage] > 0 for stage in STAGES)
    assert sum(spent.values()) < network.time.now - began


def test_all_that_can_be_counted_is_there_before_it_happens() -> None:
    found = values(reach_text())
    assert {dict(labels)["kind"] for name, labels in found if name == "fleet_reach_events_total"} == set(EventKind)
    assert {dict(labels)["label"] for name, labels in found if name == "fleet_reach_newest_tubes"} == set(Label)
    assert {dict(labels)["stage"] for name, labels in found if name == "fleet_reach_stage_seconds_total"} == set(STAGES)


def test_no_label_names_a_vehicle() -> None:
    names = {key for name, labels in values(reach_text()) for key, _ in labels if name.startswith("fleet_")}
    assert names == {"kind", "id", "version", "reason", "label", "method", "le", "stage", "state"}


def test_stages_take_the_time_since_the_one_before() -> None:
    time = Time()
    stages = Stages(time)
    time.now = 5.0
    stages.begin()
    for stage, seconds in (("decode", 1.0), ("sets", 2.0), ("sets", 0.5)):
        time.now += seconds
        stages.passed(stage)
    assert {stage: spent for stage, spent in stages.seconds.items() if spent} == {"decode": 1.0, "sets": 2.5}
