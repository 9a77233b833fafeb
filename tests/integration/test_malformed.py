"""Bad messages are counted by reason, and everything else goes on."""

import dataclasses
import time

import msgpack
import numpy as np
import pytest
import zenoh

from fleet_bus import Role, keys, open_session
from fleet_bus.messages import Assignment, Event, EventKind, ScenarioDocument, StateSample
from fleet_bus.messages.state import ENCODING
from fleet_bus.pubsub import declare_cached_publisher, declare_recovering_subscriber
from fleet_bus.router import Router
from reach_server.service.server import ReachServer
from side_info.documents.scenario import Scenario
from tests.integration.conftest import serving
from tests.waiting import wait_until
from vehicle_agent import svea

pytestmark = pytest.mark.integration

PROFILE = svea.profile()


def sample(seq: int, **changes: object) -> StateSample:
    good = StateSample(1, seq, 10**18 + seq * PROFILE.sample_time_ns, np.array([0.0, 0, 0, 0.5]), np.zeros(2))
    return dataclasses.replace(good, **changes)  # type: ignore[arg-type]


def replaced(payload: bytes, number: float, by: float) -> bytes:
    return payload.replace(np.float64(number).tobytes(), np.float64(by).tobytes())


def put(session: zenoh.Session, vehicle: str, payload: bytes, encoding: str = ENCODING) -> None:
    # What is dropped under load was never sent, and would be missed here.
    session.put(keys.state(vehicle), payload, encoding=encoding, congestion_control=zenoh.CongestionControl.BLOCK)


def events_of(server: ReachServer, session: zenoh.Session, kind: EventKind) -> list[Event]:
    found: list[Event] = []
    with declare_recovering_subscriber(
        session, keys.ALL_EVENTS, lambda r: found.append(Event.decode(r.payload, r.encoding)), history=32
    ):
        wait_until(lambda: any(event.kind == kind for event in found))
    return [event for event in found if event.kind == kind]


def test_each_reason_is_counted_and_good_samples_go_through(router: Router) -> None:
    endpoint = router.endpoints[0]
    bomb = b"\x91" * 3000
    bad = {
        "shape": [sample(100, x=np.zeros(7)).encode()[:-8] + b"\0" * 7],
        # No encoder makes these two.
        "not_finite": [replaced(sample(101).encode(), 0.5, np.nan)],
        "range": [replaced(sample(105).encode(), 0.5, -2e30)],
        "too_large": [np.random.default_rng(0).bytes(1_000_000)],
        "malformed": [bomb, msgpack.packb({"d": b"x" * 50})[:-3], b"\xdd\xff\xff\xff\xff"],
        "fields": [msgpack.packb({"e": 1})],
        "profile": [sample(102, x=np.zeros(5)).encode()],
    }
    with serving(endpoint) as server, open_session(Role.SERVICE, [endpoint]) as session:
        with declare_cached_publisher(session, keys.profile("car"), PROFILE.encoding(), cache=1) as profiles:
            profiles.put(PROFILE.encode())
            wait_until(lambda: server.fleet.profile_of("car") is not None)
            good = list(range(30))
            for seq in good[:15]:
                put(session, "car", sample(seq).encode())
            for payloads in bad.values():
                for payload in payloads:
                    put(session, "car", payload)
            put(session, "car", sample(103).encode(), ENCODING.replace("v1", "v2"))
            put(session, "car", sample(104).encode(), "application/json")
            for seq in good[15:]:
                put(session, "car", sample(seq).encode())
            expected = {reason: len(payloads) for reason, payloads in bad.items()} | {"version": 1, "encoding": 1}
            expected["shape"], expected["malformed"] = 0, 4
            wait_until(lambda: len(server.fleet.window_keys("car")) == len(good))
            wait_until(lambda: sum(server.rejections.snapshot().values()) >= 11)
            counted = server.rejections.snapshot()
            assert [seq for _, seq in server.fleet.window_keys("car")] == good
            assert {reason: counted.get(reason, 0) for reason in expected} == expected
            assert server.status().refused == counted


def test_a_vehicle_without_profile_is_reported_and_served_when_it_comes(router: Router) -> None:
    endpoint = router.endpoints[0]
    with serving(endpoint) as server, open_session(Role.SERVICE, [endpoint]) as session:
        for seq in range(25):
            put(session, "stranger", sample(seq).encode())
        with open_session(Role.VIEWER, [endpoint]) as viewer:
            (event,) = events_of(server, viewer, EventKind.UNKNOWN_VEHICLE)
        assert "fleet/stranger/profile" in event.message
        with declare_cached_publisher(session, keys.profile("stranger"), PROFILE.encoding(), cache=1) as profiles:
            profiles.put(PROFILE.encode())
            wait_until(lambda: server.fleet.profile_of("stranger") is not None)
            put(session, "stranger", sample(25).encode())
            wait_until(lambda: len(server.fleet.window_keys("stranger")) == 26)


def test_a_profile_that_contradicts_the_samples_is_reported(router: Router) -> None:
    endpoint = router.endpoints[0]
    with serving(endpoint) as server, open_session(Role.SERVICE, [endpoint]) as session:
        with declare_cached_publisher(session, keys.profile("slow"), PROFILE.encoding(), cache=1) as profiles:
            profiles.put(PROFILE.encode())
            wait_until(lambda: server.fleet.profile_of("slow") is not None)
            for seq in range(25):
                put(session, "slow", sample(seq, t=10**18 + seq * 10**8).encode())
            with open_session(Role.VIEWER, [endpoint]) as viewer:
                (event,) = events_of(server, viewer, EventKind.PROFILE_CONTRADICTED)
            assert "0.1 s" in event.message
            assert "0.05 s" in event.message


def test_a_malformed_profile_is_reported(router: Router) -> None:
    endpoint = router.endpoints[0]
    with serving(endpoint) as server, open_session(Role.SERVICE, [endpoint]) as session:
        with declare_cached_publisher(session, keys.profile("odd"), PROFILE.encoding(), cache=1) as profiles:
            profiles.put(msgpack.packb({"class": "svea", "state": {"x": "m"}}))
            with open_session(Role.VIEWER, [endpoint]) as viewer:
                (event,) = events_of(server, viewer, EventKind.PROFILE_REFUSED)
            assert "sample_time" in event.message
        assert server.rejections.snapshot()["fields"] == 1


def test_a_scenario_that_names_an_unknown_state_is_reported(router: Router) -> None:
    endpoint = router.endpoints[0]
    scenario = Scenario.load("parking-lot")
    profile = PROFILE.model_copy(update={"maps_to": {}})
    with serving(endpoint) as server, open_session(Role.SERVICE, [endpoint]) as session:
        with (
            declare_cached_publisher(session, keys.profile("car"), profile.encoding(), cache=1) as profiles,
            declare_cached_publisher(
                session, keys.document(scenario.name), ScenarioDocument.encoding(), cache=1
            ) as documents,
            declare_cached_publisher(
                session, keys.assignment(scenario.name, "car"), Assignment.encoding(), cache=1
            ) as assignments,
        ):
            profiles.put(profile.encode())
            documents.put(
                ScenarioDocument(scenario=scenario.name, version=scenario.version, text=scenario.text).encode()
            )
            assignments.put(Assignment(scenario=scenario.name, vehicle="car", time_zero=time.time_ns()).encode())
            with open_session(Role.VIEWER, [endpoint]) as viewer:
                (event,) = events_of(server, viewer, EventKind.SCENARIO_REFUSED)
            assert "maps_to" in event.message
