"""What services tell Prometheus, scraped over HTTP as it does, of services on a bus in memory."""

import functools
import threading
import urllib.request
from collections.abc import Callable, Iterable

import numpy as np
from prometheus_client.metrics_core import Metric
from prometheus_client.parser import text_string_to_metric_families

from fleet_bus import metrics
from fleet_bus.messages import parse_profile
from reach_server.service.metrics import metrics as of_server
from reach_server.service.server import ReachServer
from side_info import Scenario
from side_info.service.metrics import metrics as of_side_info
from side_info.service.service import SideInfoService
from tests.memory_bus import Network
from tests.side_info.corpus import DOCUMENT
from vehicle_agent.agent import Agent, run
from vehicle_agent.filters import PassThrough
from vehicle_agent.metrics import metrics as of_agents
from vehicle_agent.recording import Recording
from vehicle_agent.sources import RecordingSource

Values = dict[tuple[str, tuple[tuple[str, str], ...]], float]


def fetch(url: str) -> str:
    """The body of what a URL answers."""
    with urllib.request.urlopen(url, timeout=60) as answer:
        body: bytes = answer.read()
    return body.decode()


def scrape(kind: str, read: Callable[[], Iterable[Metric]]) -> str:
    """What a service says, in the text format."""
    with metrics.serve(metrics.registry(kind, "one", read), "0") as url:
        return fetch(url)


def values(text: str) -> Values:
    """Samples by name and sorted labels."""
    found: Values = {}
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            key = sample.name, tuple(sorted(sample.labels.items()))
            assert key not in found, key
            found[key] = sample.value
    return found


@functools.cache
def reach_text() -> str:
    """What a reach server says before anything has come."""
    network = Network()
    server = ReachServer("one", clock=network.time, connect=network.bus)
    return scrape("reach", lambda: of_server(server.counters))


@functools.cache
def side_info_text() -> str:
    """What a side-info service says after a second."""
    network, stop = Network(), threading.Event()
    network.time.on_wait = lambda now: stop.set() if now > 1.0 else None
    service = SideInfoService(network.bus(), [Scenario.parse(DOCUMENT)], {}, "one", clock=network.time)
    service.run(stop)
    return scrape("side-info", lambda: of_side_info(lambda: service.newest_status))


@functools.cache
def agent_text() -> str:
    """What an agent says that has had three readings, of which one is beyond what a message may hold."""
    network = Network()
    profile = parse_profile(
        {
            "class": "cart",
            "state": {"x": "m"},
            "inputs": {"u": "m/s"},
            "sample_time": 0.1,
            "window": 8,
            "future_inputs": "plan",
        }
    )
    recording = Recording(
        np.arange(3) / 10, np.array([[0.0], [1e31], [2.0]]), np.zeros((3, 1)), np.zeros(3, dtype=np.int64),
        ("x",), ("m",), ("u",), ("m/s",),
    )  # fmt: skip
    agents = [Agent(network.bus(), "cart1", profile, RecordingSource(recording), PassThrough(), network.time)]
    run(agents, threading.Event(), clock=network.time)
    return scrape("agent", lambda: of_agents(agents))


def every_text() -> dict[str, str]:
    """What each kind of service says."""
    return {"reach": reach_text(), "side-info": side_info_text(), "agent": agent_text()}
