"""Two agents, servers or services where there should be one: told by whoever is there, and the first one counts."""

import dataclasses
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest

from fleet_bus import Role, keys, open_session
from fleet_bus.messages import Event, EventKind, Label, ReachTube, ServiceStatus, StateSample
from fleet_bus.messages.state import ENCODING
from fleet_bus.pubsub import Received, declare_cached_publisher, declare_recovering_subscriber, subscribe
from fleet_bus.router import Router
from tests.integration.conftest import Start, serving
from tests.waiting import wait_until
from vehicle_agent import svea

pytestmark = pytest.mark.integration

PROFILE = svea.profile()
PATIENT = 60.0


@contextmanager
def driving(endpoint: str, vehicle: str, epoch: int, stop: threading.Event) -> Iterator[None]:
    """An agent that stands still, in a session of its own, until ``stop``."""
    with ExitStack() as opened:
        session = opened.enter_context(open_session(Role.AGENT, [endpoint]))
        profiles = declare_cached_publisher(session, keys.profile(vehicle), PROFILE.encoding(), cache=1)
        states = declare_cached_publisher(session, keys.state(vehicle), ENCODING, cache=1000)
        opened.enter_context(profiles)
        opened.enter_context(states)
        profiles.put(PROFILE.encode())

        def drive() -> None:
            start, seq = time.time_ns(), 0
            while not stop.wait(PROFILE.sample_time):
                sample = StateSample(epoch, seq, start + seq * PROFILE.sample_time_ns, np.zeros(4), np.zeros(2))
                states.put(dataclasses.replace(sample).encode())
                seq += 1

        thread = threading.Thread(target=drive)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()


@contextmanager
def events(endpoint: str, *keys_: str) -> Iterator[list[Event]]:
    """Events as they come."""
    found: list[Event] = []
    with ExitStack() as opened:
        session = opened.enter_context(open_session(Role.VIEWER, [endpoint]))
        for key in keys_:
            opened.enter_context(
                declare_recovering_subscriber(
                    session,
                    key,
                    lambda r: found.append(Event.decode(r.payload, r.encoding)),
                    history=32,
                    late_publishers=True,
                )
            )
        yield found


def test_two_live_agents_are_told_contradicted_and_forgiven(router: Router) -> None:
    (endpoint,) = router.endpoints
    labels: list[Label] = []

    def note(received: Received) -> None:
        labels.append(ReachTube.decode(received.payload, received.encoding).label)

    first, second = threading.Event(), threading.Event()
    with ExitStack() as opened:
        server = opened.enter_context(serving(endpoint))
        told = opened.enter_context(events(endpoint, keys.ALL_EVENTS))
        viewer = opened.enter_context(open_session(Role.VIEWER, [endpoint]))
        opened.enter_context(subscribe(viewer, keys.ALL_TUBES, note))
        opened.enter_context(driving(endpoint, "car", 1, first))
        wait_until(lambda: len(labels) > 3, PATIENT)
        assert Label.CONTRADICTED not in labels
        with driving(endpoint, "car", 2, second):
            wait_until(lambda: any(e.kind is EventKind.TWO_SOURCES for e in told), PATIENT)
            labels.clear()
            wait_until(lambda: len(labels) > 10, PATIENT)
            assert set(labels[1:]) == {Label.CONTRADICTED}
        wait_until(lambda: any(e.kind is EventKind.ONE_SOURCE for e in told), PATIENT)
        labels.clear()
        wait_until(lambda: len(labels) > 3, PATIENT)
        assert Label.CONTRADICTED not in labels[1:]
        assert {epoch for epoch, _ in server.fleet.window_keys("car")} == {1}
        assert server.rejections.snapshot()["other_source"] > 0
        first.set()


def test_two_servers_tell_of_each_other_whatever_their_ids(router: Router) -> None:
    (endpoint,) = router.endpoints
    with events(endpoint, keys.ALL_SERVICE_EVENTS) as told:
        for first, second in (("one", "two"), ("same", "same")):
            told.clear()
            with serving(endpoint, first) as one, serving(endpoint, second) as two:
                wait_until(lambda: one.status().problems and two.status().problems, PATIENT)
                wait_until(lambda: len([e for e in told if e.kind is EventKind.SECOND_SERVER]) >= 2, PATIENT)
                assert second in one.status().problems[0]
                assert first in two.status().problems[0]


def test_one_server_alone_has_no_problem(router: Router) -> None:
    (endpoint,) = router.endpoints
    statuses: list[ServiceStatus] = []
    with serving(endpoint) as server, open_session(Role.VIEWER, [endpoint]) as viewer:
        key = keys.service_status("reach", "reach-test")
        with subscribe(viewer, key, lambda r: statuses.append(ServiceStatus.decode(r.payload, r.encoding))):
            wait_until(lambda: len(statuses) > 1, PATIENT)
        assert all(status.problems == [] for status in statuses)
        assert server.status().problems == []


def test_a_second_side_info_service_counts_once_the_first_is_gone(router: Router, start: Start) -> None:
    (endpoint,) = router.endpoints
    stop = threading.Event()
    with serving(endpoint) as server, events(endpoint, keys.ALL_EVENTS) as told, driving(endpoint, "car", 1, stop):
        first = start("side-info", "parking-lot", "--id", "first", "--router", endpoint)
        wait_until(lambda: server.fleet.scenario_source("parking-lot"), PATIENT)
        writer = server.fleet.scenario_source("parking-lot")
        start("side-info", "parking-lot", "--id", "second", "--router", endpoint)
        wait_until(lambda: any(e.kind is EventKind.TWO_SOURCES and "parking-lot" in e.message for e in told), PATIENT)
        assert server.rejections.snapshot()["other_source"] > 0
        assert server.fleet.scenario_source("parking-lot") == writer
        assert first.end() == 0
        wait_until(lambda: server.fleet.scenario_source("parking-lot") != writer, PATIENT)
        assert not [event for event in told if event.kind is EventKind.SCENARIO_REFUSED]
        stop.set()
