"""Sessions: who opens without a router, who waits, and what is said when none answers."""

import json
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
import zenoh

from fleet_bus.errors import SessionError, Stopped, UsageError
from fleet_bus.pubsub import Received, declare_alive, declare_cached_publisher, subscribe, watch_alive
from fleet_bus.router import Router
from fleet_bus.sessions import Role, check_endpoint, open_session, why_not_connected
from tests.waiting import DEADLINE, wait_until

pytestmark = pytest.mark.integration


@pytest.fixture
def free_endpoint() -> str:
    """An endpoint where nobody listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def router() -> Iterator[Router]:
    with Router(["tcp/127.0.0.1:0"]) as running:
        yield running


@pytest.mark.parametrize("role", [Role.SERVICE, Role.VIEWER])
def test_client_without_router_says_how_to_get_one(role: Role, free_endpoint: str) -> None:
    with pytest.raises(SessionError) as refused:
        open_session(role, [free_endpoint], timeout=0.2)
    assert str(refused.value) == (
        f"no router answers at {free_endpoint}: start one with `fleet router`, or name the right one with --router"
    )


def test_client_takes_the_first_router_that_answers(free_endpoint: str, router: Router) -> None:
    with open_session(Role.SERVICE, [free_endpoint, *router.endpoints]) as session:
        assert len(list(session.info.routers_zid())) == 1


def test_client_waits_for_a_router_that_is_late(free_endpoint: str) -> None:
    with ThreadPoolExecutor(1) as pool:
        opening = pool.submit(open_session, Role.SERVICE, [free_endpoint], timeout=2 * DEADLINE)
        with pytest.raises(TimeoutError):
            opening.result(timeout=0.2)
        with Router([free_endpoint]), opening.result(timeout=DEADLINE) as session:
            assert list(session.info.routers_zid())


def test_a_port_that_accepts_and_is_mute_is_no_router() -> None:
    with socket.socket() as mute:
        mute.bind(("127.0.0.1", 0))
        mute.listen()
        with pytest.raises(SessionError, match="no router answers"):
            open_session(Role.SERVICE, [f"tcp/127.0.0.1:{mute.getsockname()[1]}"], timeout=0.5)


@pytest.fixture
def mute_endpoint() -> Iterator[tuple[str, socket.socket]]:
    """An endpoint that accepts connections and says nothing."""
    with socket.socket() as mute:
        mute.bind(("127.0.0.1", 0))
        mute.listen()
        mute.settimeout(10)
        yield f"tcp/127.0.0.1:{mute.getsockname()[1]}", mute


def test_waiting_ends_when_told_to(free_endpoint: str) -> None:
    stop = threading.Event()
    with ThreadPoolExecutor(1) as pool:
        opening = pool.submit(open_session, Role.SERVICE, [free_endpoint], timeout=60.0, stop=stop)
        stop.set()
        with pytest.raises(Stopped):
            opening.result(timeout=10)


def test_waiting_for_a_mute_router_ends_when_told_to(mute_endpoint: tuple[str, socket.socket]) -> None:
    endpoint, mute = mute_endpoint
    stop = threading.Event()
    with ThreadPoolExecutor(1) as pool:
        opening = pool.submit(open_session, Role.SERVICE, [endpoint], timeout=60.0, stop=stop)
        connection, _ = mute.accept()
        with connection:
            # Now Zenoh waits for an answer, for a minute.
            stop.set()
            with pytest.raises(Stopped):
                opening.result(timeout=10)


@pytest.mark.parametrize("role", list(Role))
def test_nothing_is_opened_by_who_was_told_to_end_before(role: Role, router: Router) -> None:
    stop = threading.Event()
    stop.set()
    with pytest.raises(Stopped):
        open_session(role, router.endpoints, stop=stop)


def test_a_session_that_opens_too_late_is_closed(router: Router, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[zenoh.Session] = []
    begun, goes_on, stop = threading.Event(), threading.Event(), threading.Event()
    really_open = zenoh.open

    def open_slowly(config: zenoh.Config) -> zenoh.Session:
        begun.set()
        goes_on.wait(10)
        opened.append(really_open(config))
        return opened[-1]

    monkeypatch.setattr(zenoh, "open", open_slowly)
    with ThreadPoolExecutor(1) as pool:
        opening = pool.submit(open_session, Role.SERVICE, router.endpoints, stop=stop)
        assert begun.wait(5)
        stop.set()
        with pytest.raises(Stopped):
            opening.result(timeout=10)
        goes_on.set()
    wait_until(lambda: opened and opened[0].is_closed())


@pytest.mark.parametrize("role", list(Role))
def test_sessions_reserve_no_shared_memory(role: Role, router: Router, monkeypatch: pytest.MonkeyPatch) -> None:
    configs: list[zenoh.Config] = []
    really_open = zenoh.open

    def open_and_note(config: zenoh.Config) -> zenoh.Session:
        configs.append(config)
        return really_open(config)

    monkeypatch.setattr(zenoh, "open", open_and_note)
    with open_session(role, router.endpoints):
        (config,) = configs
        assert json.loads(config.get_json("transport/shared_memory/enabled")) is False


def test_an_agent_without_a_router_can_say_why(free_endpoint: str, router: Router) -> None:
    with open_session(Role.AGENT, [free_endpoint]) as alone, open_session(Role.AGENT, router.endpoints) as joined:
        assert "no router answers" in str(why_not_connected(alone, [free_endpoint]))
        wait_until(lambda: why_not_connected(joined, router.endpoints) is None)


def test_agent_opens_without_router_and_connects_when_one_comes(free_endpoint: str) -> None:
    with open_session(Role.AGENT, [free_endpoint]) as agent:
        assert not list(agent.info.routers_zid())
        with Router([free_endpoint]):
            wait_until(lambda: list(agent.info.routers_zid()))


def test_agent_listens_to_nobody(router: Router) -> None:
    with (
        open_session(Role.AGENT, router.endpoints) as first,
        open_session(Role.AGENT, router.endpoints) as second,
    ):
        wait_until(lambda: list(first.info.routers_zid()) and list(second.info.routers_zid()))
        assert not list(first.info.peers_zid())
        assert not list(second.info.peers_zid())


def test_agent_hears_services_but_not_other_agents(router: Router) -> None:
    heard: list[str] = []
    with (
        open_session(Role.AGENT, router.endpoints) as agent,
        open_session(Role.AGENT, router.endpoints) as other,
        open_session(Role.SERVICE, router.endpoints) as service,
        subscribe(agent, "**", lambda sample: heard.append(sample.key)),
    ):
        wait_until(lambda: list(other.info.routers_zid()))
        wait_until(lambda: len(heard) >= 20, meanwhile=lambda: (other.put("a", b""), service.put("b", b"")))
    assert set(heard) == {"b"}


@pytest.mark.parametrize(
    "endpoint",
    [
        "",
        "nonsense",
        "tcp/127.0.0.1",
        "tcp/host:abc",
        "tcp/127.0.0.1:65536",
        "tcp/:7447",
        "xyz/a:1",
        "127.0.0.1:7447",
    ],
)
@pytest.mark.parametrize("role", list(Role))
def test_malformed_endpoint_is_refused_by_name(role: Role, endpoint: str) -> None:
    with pytest.raises(UsageError) as refused:
        open_session(role, [endpoint])
    assert repr(endpoint) in str(refused.value)


@pytest.mark.parametrize(
    "endpoint",
    [
        "tcp/localhost:7447",
        "tcp/[::]:7447",
        "tls/router.example.org:7447",
        "quic/[fe80::1%eth0]:7447",
        "tcp/127.0.0.1:7447#so_sndbuf=65000",
        "unixsock-stream//run/fleet.sock",
    ],
)
def test_endpoint_that_zenoh_understands_is_kept(endpoint: str) -> None:
    assert check_endpoint(endpoint) == endpoint


@pytest.mark.parametrize("namespace", ["", "site/*", "/site", "site//lab"])
def test_malformed_namespace_is_refused(namespace: str) -> None:
    with pytest.raises(UsageError, match="is not a namespace"):
        open_session(Role.AGENT, [], namespace=namespace)


def test_namespace_is_invisible_inside_and_separates_outside(router: Router) -> None:
    inside: list[Received] = []
    outside: list[Received] = []
    with (
        open_session(Role.SERVICE, router.endpoints, namespace="site/lab") as here,
        open_session(Role.SERVICE, router.endpoints) as everywhere,
        open_session(Role.AGENT, router.endpoints, namespace="site/lab") as agent,
        subscribe(here, "fleet/*/state", inside.append),
        subscribe(everywhere, "**", outside.append),
        declare_cached_publisher(agent, "fleet/a/state", "text/plain", cache=1) as publisher,
    ):
        wait_until(lambda: inside and outside, meanwhile=lambda: publisher.put(b"x"))
    assert inside[0].key == "fleet/a/state"
    assert outside[0].key == "site/lab/fleet/a/state"


@pytest.mark.parametrize("role", [Role.SERVICE, Role.VIEWER])
def test_session_comes_back_with_its_declarations_after_an_outage(role: Role) -> None:
    received: list[Received] = []
    seen: list[tuple[str, bool]] = []
    with Router(["tcp/127.0.0.1:0"]) as router:
        endpoints = router.endpoints
        listener = open_session(role, endpoints)
        agent = open_session(Role.AGENT, endpoints)
        subscriber = subscribe(listener, "fleet/*/state", received.append)
        watcher = watch_alive(listener, "fleet/*/alive", lambda key, alive: seen.append((key, alive)))
        publisher = declare_cached_publisher(agent, "fleet/a/state", "text/plain", cache=1)
        token = declare_alive(agent, "fleet/a/alive")
        wait_until(lambda: received and seen, meanwhile=lambda: publisher.put(b"before"))
    wait_until(lambda: seen[-1] == ("fleet/a/alive", False))
    with Router(endpoints), listener, agent, subscriber, watcher, publisher, token:
        wait_until(lambda: received[-1].payload == b"after", meanwhile=lambda: publisher.put(b"after"))
        wait_until(lambda: seen[-1] == ("fleet/a/alive", True))
        assert seen == [("fleet/a/alive", alive) for alive in (True, False, True)]
