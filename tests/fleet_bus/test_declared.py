"""What is declared on a session: tokens and callbacks, and that closing ends them."""

import gc
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import pytest
import zenoh
from structlog.testing import capture_logs

from fleet_bus.pubsub import (
    Declared,
    Received,
    declare_alive,
    declare_cached_publisher,
    declare_recovering_subscriber,
    query_cache,
    subscribe,
    watch_alive,
)
from fleet_bus.router import Router
from fleet_bus.sessions import Role, open_session
from tests.fleet_bus.publishing import ALL_STATES, ENCODING, STATE, cached, put_numbers
from tests.waiting import DEADLINE, wait_until

pytestmark = pytest.mark.integration


@contextmanager
def agent_process(endpoint: str) -> Iterator[subprocess.Popen[bytes]]:
    """Another process with a token and one cached sample."""
    program = f"""
import sys
from fleet_bus.pubsub import declare_alive, declare_cached_publisher
from fleet_bus.sessions import Role, open_session
with (
    open_session(Role.AGENT, [{endpoint!r}]) as session,
    declare_cached_publisher(session, {STATE!r}, "text/plain", cache=1) as publisher,
    declare_alive(session, "fleet/a/alive"),
):
    publisher.put(b"0")
    sys.stdin.read()
"""
    with subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE) as process:
        try:
            yield process
        finally:
            process.kill()


def test_a_frozen_agent_is_gone_after_its_lease_and_delays_nobody_else(
    router: Router, agent: zenoh.Session, service: zenoh.Session
) -> None:
    seen: list[tuple[str, bool]] = []
    received: list[Received] = []
    with (
        watch_alive(service, "fleet/*/alive", lambda key, alive: seen.append((key, alive))),
        declare_cached_publisher(agent, "fleet/b/state", ENCODING, cache=10) as publisher,
        agent_process(router.endpoints[0]) as process,
    ):
        put_numbers(publisher, range(10))
        wait_until(lambda: cached(service, 1) and seen)
        process.send_signal(signal.SIGSTOP)
        assert query_cache(service, STATE, max_samples=1, timeout=0.3) == []
        with declare_recovering_subscriber(service, ALL_STATES, received.append, history=10):
            wait_until(lambda: len(received) == 10)
            put_numbers(publisher, [10])
            wait_until(lambda: len(received) == 11)
        wait_until(lambda: seen == [("fleet/a/alive", True), ("fleet/a/alive", False)])
    assert {sample.key for sample in received} == {"fleet/b/state"}


def test_watch_alive_tells_what_is_there_comes_and_goes(agent: zenoh.Session, service: zenoh.Session) -> None:
    seen: queue.Queue[tuple[str, bool]] = queue.Queue()
    there = declare_alive(agent, "fleet/a/alive")
    with watch_alive(service, "fleet/*/alive", lambda key, alive: seen.put((key, alive))):
        assert seen.get(timeout=DEADLINE) == ("fleet/a/alive", True)
        with declare_alive(agent, "fleet/b/alive"):
            assert seen.get(timeout=DEADLINE) == ("fleet/b/alive", True)
        assert seen.get(timeout=DEADLINE) == ("fleet/b/alive", False)
        there.close()
        assert seen.get(timeout=DEADLINE) == ("fleet/a/alive", False)


def test_a_failing_callback_is_logged_and_hears_the_next_sample(agent: zenoh.Session) -> None:
    calls: list[bytes] = []

    def fail(sample: Received) -> None:
        calls.append(sample.payload)
        raise ValueError("no such luck")

    with capture_logs() as logs, subscribe(agent, STATE, fail):
        agent.put(STATE, b"1")
        agent.put(STATE, b"2")
        wait_until(lambda: len(calls) == 2)
    assert [(entry["event"], entry["key"], entry["log_level"]) for entry in logs] == [
        ("callback failed", STATE, "error")
    ]


def test_a_callback_is_not_called_once_closing_has_returned(agent: zenoh.Session) -> None:
    began, goes_on = threading.Event(), threading.Event()
    calls: list[bytes] = []
    torn_down = threading.Event()
    late: list[bytes] = []

    def slow(sample: Received) -> None:
        calls.append(sample.payload)
        began.set()
        goes_on.wait(10)
        if torn_down.is_set():
            late.append(sample.payload)

    last = threading.Event()
    with subscribe(agent, "fleet/z/state", lambda _: last.set()):
        subscriber = subscribe(agent, STATE, slow)
        putting = threading.Thread(target=lambda: put_all(agent, [b"1", b"2", b"3"]))
        putting.start()
        assert began.wait(5)

        def close() -> None:
            subscriber.close()
            torn_down.set()

        closing = threading.Thread(target=close)
        closing.start()
        # It waits for the call that is under way.
        assert not torn_down.wait(0.1)
        goes_on.set()
        closing.join(10)
        putting.join(10)
        assert torn_down.is_set()
        before = len(calls)
        wait_until(last.is_set, meanwhile=lambda: agent.put("fleet/z/state", b""))
    assert late == []
    assert len(calls) == before


def put_all(session: zenoh.Session, payloads: Sequence[bytes]) -> None:
    for payload in payloads:
        session.put(STATE, payload)


def test_what_is_queued_for_a_callback_is_dropped_by_closing(agent: zenoh.Session, service: zenoh.Session) -> None:
    seen: list[bytes] = []
    subscribers: list[Declared] = []
    late: list[bytes] = []
    closed = threading.Event()

    def close_at_the_first(sample: Received) -> None:
        (late if closed.is_set() else seen).append(sample.payload)
        subscribers[0].close()
        closed.set()

    subscribers.append(subscribe(service, STATE, close_at_the_first))
    after = threading.Event()
    with subscribe(service, "fleet/z/state", lambda _: after.set()):
        wait_until(closed.is_set, meanwhile=lambda: put_all(agent, [b"x"] * 1000))
        wait_until(after.is_set, meanwhile=lambda: agent.put("fleet/z/state", b""))
    assert len(seen) == 1
    assert late == []


def test_what_is_declared_outlives_the_name_of_its_session(router: Router, service: zenoh.Session) -> None:
    received: list[Received] = []
    with subscribe(open_session(Role.AGENT, router.endpoints), STATE, received.append):
        gc.collect()
        wait_until(lambda: received, meanwhile=lambda: service.put(STATE, b"1"))


def test_closing_ends_it_and_may_be_repeated(agent: zenoh.Session) -> None:
    received: list[Received] = []
    publisher = declare_cached_publisher(agent, STATE, ENCODING, cache=1)
    subscriber = declare_recovering_subscriber(agent, STATE, received.append, history=1)
    token = declare_alive(agent, "fleet/a/alive")
    for declared in (subscriber, token, publisher):
        declared.close()
        declared.close()
    agent.put(STATE, b"1")
    assert not received
    with pytest.raises(zenoh.ZError):
        publisher.put(b"1")


def test_closing_after_the_session_is_harmless(router: Router) -> None:
    with open_session(Role.SERVICE, router.endpoints) as session:
        publisher = declare_cached_publisher(session, STATE, ENCODING, cache=1)
        subscriber = subscribe(session, STATE, lambda _: None)
    publisher.close()
    subscriber.close()
