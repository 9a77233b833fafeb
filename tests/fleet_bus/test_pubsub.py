"""Caches, recovery and liveliness over a real router; each pitfall of Zenoh hidden here has its test."""

import gc
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest
import zenoh
from structlog.testing import capture_logs
from zenoh import ext

from fleet_bus.codec import check_encoding
from fleet_bus.errors import MessageError
from fleet_bus.pubsub import (
    CachedPublisher,
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
from tests.waiting import DEADLINE, wait_until

pytestmark = pytest.mark.integration

STATE = "fleet/a/state"
ALL_STATES = "fleet/*/state"
ENCODING = "application/msgpack;fleet.state.v1"


@pytest.fixture
def router() -> Iterator[Router]:
    with Router(["tcp/127.0.0.1:0"]) as running:
        yield running


@pytest.fixture
def service(router: Router) -> Iterator[zenoh.Session]:
    with open_session(Role.SERVICE, router.endpoints) as session:
        yield session


@pytest.fixture
def agent(router: Router) -> Iterator[zenoh.Session]:
    with open_session(Role.AGENT, router.endpoints) as session:
        wait_until(lambda: list(session.info.routers_zid()))
        yield session


def put_numbers(publisher: CachedPublisher, numbers: Sequence[int]) -> None:
    for number in numbers:
        publisher.put(str(number).encode())


def numbers_of(received: Sequence[Received]) -> list[int]:
    return [int(sample.payload) for sample in received]


@contextmanager
def publishing(publisher: CachedPublisher, period: float = 0.01) -> Iterator[list[int]]:
    """Puts 0, 1, 2 … every ``period`` seconds in a thread; yields the list of what was put so far."""
    put: list[int] = []
    stop = threading.Event()

    def work() -> None:
        while not stop.wait(period):
            put.append(len(put))
            put_numbers(publisher, put[-1:])

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield put
    finally:
        stop.set()
        thread.join()


def cached(session: zenoh.Session, count: int, key: str = STATE) -> list[Received]:
    return query_cache(session, key, max_samples=count, timeout=DEADLINE)


def test_a_sample_carries_key_encoding_and_time_of_the_put(agent: zenoh.Session, service: zenoh.Session) -> None:
    received: list[Received] = []
    before = time.time_ns()
    with (
        subscribe(service, ALL_STATES, received.append),
        declare_cached_publisher(agent, STATE, ENCODING, cache=1) as publisher,
    ):
        wait_until(lambda: received, meanwhile=lambda: publisher.put(b"\x00\xff"))
    sample = received[0]
    assert (sample.key, sample.payload, sample.encoding) == (STATE, b"\x00\xff", ENCODING)
    assert sample.timestamp_ns is not None
    assert before - 1_000_000 <= sample.timestamp_ns <= time.time_ns() + 1_000_000


def test_late_subscriber_begins_with_the_newest_of_the_cache(agent: zenoh.Session, service: zenoh.Session) -> None:
    received: list[Received] = []
    with declare_cached_publisher(agent, STATE, ENCODING, cache=100) as publisher:
        put_numbers(publisher, range(150))
        wait_until(lambda: len(cached(service, 100)) == 100)
        with declare_recovering_subscriber(service, ALL_STATES, received.append, history=20):
            wait_until(lambda: len(received) == 20)
            put_numbers(publisher, range(150, 160))
            wait_until(lambda: len(received) == 30)
    assert numbers_of(received) == list(range(130, 160))


def test_no_history_means_none(agent: zenoh.Session, service: zenoh.Session) -> None:
    received: list[Received] = []
    with declare_cached_publisher(agent, STATE, ENCODING, cache=100, heartbeat=60.0) as publisher:
        put_numbers(publisher, range(10))
        wait_until(lambda: len(cached(service, 100)) == 10)
        with declare_recovering_subscriber(service, ALL_STATES, received.append, history=0):
            wait_until(lambda: received, meanwhile=lambda: publisher.put(b"10"))
    assert numbers_of(received)[0] == 10


def test_history_of_a_publisher_in_the_same_session_does_not_hang(agent: zenoh.Session) -> None:
    received: list[Received] = []
    with declare_cached_publisher(agent, STATE, ENCODING, cache=1000) as publisher:
        put_numbers(publisher, range(1000))
        with declare_recovering_subscriber(agent, ALL_STATES, received.append, history=1000):
            wait_until(lambda: len(received) == 1000)
        assert numbers_of(cached(agent, 1000)) == list(range(1000))
    assert numbers_of(received) == list(range(1000))


def test_what_an_agent_put_before_it_ever_met_a_router_arrives_in_order() -> None:
    received: list[Received] = []
    with Router(["tcp/127.0.0.1:0"]) as first:
        endpoints = first.endpoints
    with (
        open_session(Role.AGENT, endpoints) as agent,
        declare_cached_publisher(agent, STATE, ENCODING, cache=100) as publisher,
    ):
        put_numbers(publisher, range(50))
        with (
            Router(endpoints),
            open_session(Role.SERVICE, endpoints) as service,
            declare_recovering_subscriber(service, ALL_STATES, received.append, history=100),
        ):
            wait_until(lambda: len(received) == 50)
    assert numbers_of(received) == list(range(50))


@contextmanager
def subscribed_before_the_agent_connects(
    router: Router, tmp_path: Path, received: list[Received], *, late_publishers: bool = False
) -> Iterator[tuple[CachedPublisher, Callable[[], Router]]]:
    """A publisher without a router beside a subscriber that has one, and how to bring the two together."""
    with Router(["tcp/127.0.0.1:0"]) as gone:
        elsewhere = gone.endpoints
    config = tmp_path / "second.json5"
    config.write_text(f"{{connect: {{endpoints: ['{router.endpoints[0]}']}}}}")
    with (
        open_session(Role.SERVICE, router.endpoints) as service,
        declare_recovering_subscriber(
            service, ALL_STATES, received.append, history=1000, late_publishers=late_publishers
        ),
        open_session(Role.AGENT, elsewhere) as agent,
        declare_cached_publisher(agent, STATE, ENCODING, cache=1000, heartbeat=0.5) as publisher,
    ):
        yield publisher, lambda: Router(elsewhere, config_file=config)


@pytest.mark.parametrize("late_publishers", [False, True])
def test_past_of_a_silent_late_publisher_comes_by_itself(router: Router, tmp_path: Path, late_publishers: bool) -> None:
    received: list[Received] = []
    with subscribed_before_the_agent_connects(router, tmp_path, received, late_publishers=late_publishers) as (
        publisher,
        connect,
    ):
        put_numbers(publisher, range(100))
        with connect():
            wait_until(lambda: len(received) == 100)
    assert numbers_of(received) == list(range(100))


def test_past_of_a_late_publisher_that_goes_on_is_in_its_cache_only(
    router: Router, service: zenoh.Session, tmp_path: Path
) -> None:
    received: list[Received] = []
    with subscribed_before_the_agent_connects(router, tmp_path, received) as (publisher, connect):
        put_numbers(publisher, range(-100, 0))
        with publishing(publisher, 0.002), connect():
            wait_until(lambda: received)
            past = numbers_of(cached(service, 1000))
    begin = numbers_of(received)[0]
    assert begin > 0
    assert past[: 100 + begin + 1] == list(range(-100, begin + 1))


def test_a_gap_of_a_router_outage_is_filled_in_order_once() -> None:
    received: list[Received] = []
    with Router(["tcp/127.0.0.1:0"]) as first:
        endpoints = first.endpoints
        service = open_session(Role.SERVICE, endpoints)
        agent = open_session(Role.AGENT, endpoints)
        subscriber = declare_recovering_subscriber(service, ALL_STATES, received.append, history=10)
        publisher = declare_cached_publisher(agent, STATE, ENCODING, cache=1000)
        wait_until(lambda: received, meanwhile=lambda: publisher.put(b"-1"))
    with service, agent, subscriber, publisher, publishing(publisher) as put:
        wait_until(lambda: len(put) > 100)
        gap = len(put)
        with Router(endpoints):
            wait_until(lambda: numbers_of(received)[-1] > gap)
    numbers = [number for number in numbers_of(received) if number >= 0]
    assert numbers == list(range(len(numbers)))


def test_what_was_put_last_before_falling_silent_in_an_outage_arrives() -> None:
    received: list[Received] = []
    with Router(["tcp/127.0.0.1:0"]) as first:
        endpoints = first.endpoints
        service = open_session(Role.SERVICE, endpoints)
        agent = open_session(Role.AGENT, endpoints)
        subscriber = declare_recovering_subscriber(service, ALL_STATES, received.append, history=10)
        publisher = declare_cached_publisher(agent, STATE, ENCODING, cache=100, heartbeat=0.2)
        wait_until(lambda: received, meanwhile=lambda: publisher.put(b"-1"))
    with service, agent, subscriber, publisher:
        wait_until(lambda: not list(agent.info.routers_zid()))
        put_numbers(publisher, range(30))
        never = threading.Event()
        # Longer than a heartbeat, so that one announces the last sample to nobody.
        never.wait(0.5)
        with Router(endpoints):
            wait_until(lambda: numbers_of(received)[-30:] == list(range(30)))


def test_a_gap_longer_than_the_cache_begins_again_where_the_cache_does() -> None:
    received: list[Received] = []
    with Router(["tcp/127.0.0.1:0"]) as first:
        endpoints = first.endpoints
        service = open_session(Role.SERVICE, endpoints)
        agent = open_session(Role.AGENT, endpoints)
        subscriber = declare_recovering_subscriber(service, ALL_STATES, received.append, history=10)
        publisher = declare_cached_publisher(agent, STATE, ENCODING, cache=40, heartbeat=0.2)
        wait_until(lambda: received, meanwhile=lambda: publisher.put(b"-1"))
    with service, agent, subscriber, publisher:
        wait_until(lambda: not list(agent.info.routers_zid()))
        put_numbers(publisher, range(100))
        with Router(endpoints):
            wait_until(lambda: numbers_of(received)[-1] == 99)
    assert [number for number in numbers_of(received) if number >= 0] == list(range(60, 100))


def test_query_cache_returns_the_newest_in_order(agent: zenoh.Session, service: zenoh.Session) -> None:
    with (
        declare_cached_publisher(agent, STATE, ENCODING, cache=500) as publisher,
        declare_cached_publisher(agent, "fleet/b/state", ENCODING, cache=5) as other,
    ):
        put_numbers(publisher, range(600))
        put_numbers(other, range(9))
        wait_until(lambda: len(cached(service, 1000, ALL_STATES)) == 505)
        assert numbers_of(cached(service, 1000)) == list(range(100, 600))
        assert numbers_of(cached(service, 7)) == list(range(593, 600))
        assert {sample.key for sample in cached(service, 3, ALL_STATES)} == {STATE, "fleet/b/state"}
        assert {sample.encoding for sample in cached(service, 3)} == {ENCODING}
        assert len({sample.timestamp_ns for sample in cached(service, 500)}) == 500


def test_query_cache_of_nobody_is_empty_at_once(service: zenoh.Session) -> None:
    start = time.monotonic()
    assert query_cache(service, STATE, max_samples=10, timeout=2 * DEADLINE) == []
    # Not a measurement: an answer that was waited for would take all of its time.
    assert time.monotonic() - start < DEADLINE


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


def test_a_delete_comes_without_an_encoding_of_ours_live_and_out_of_a_cache(
    agent: zenoh.Session, service: zenoh.Session
) -> None:
    live: list[Received] = []
    late: list[Received] = []
    cache = ext.CacheConfig(5)
    with subscribe(service, STATE, live.append):
        publisher = ext.declare_advanced_publisher(agent, STATE, encoding=ENCODING, cache=cache)
        wait_until(lambda: live, meanwhile=lambda: publisher.put(b"1"))
        publisher.delete()
        wait_until(lambda: live[-1].payload == b"")
        with declare_recovering_subscriber(service, STATE, late.append, history=5):
            wait_until(lambda: late and late[-1].payload == b"")
        publisher.undeclare()  # type: ignore[no-untyped-call]
    for received in (live, late):
        assert received[-1].encoding == "zenoh/bytes"
        with pytest.raises(MessageError, match="encoding"):
            check_encoding(received[-1].encoding, "fleet.state", 1)


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


@contextmanager
def linked_routers(tmp_path: Path) -> Iterator[tuple[str, str]]:
    """Two routers that are linked, by their endpoints."""
    file = tmp_path / "linked.json5"
    with Router(["tcp/127.0.0.1:0"]) as first:
        file.write_text(f"{{connect: {{endpoints: ['{first.endpoints[0]}']}}}}", encoding="utf-8")
        with Router(["tcp/127.0.0.1:0"], config_file=file) as second:
            yield first.endpoints[0], second.endpoints[0]


def test_over_two_linked_routers_readers_with_history_hear_everything_once(tmp_path: Path) -> None:
    plain: list[Received] = []
    recovered: list[Received] = []
    with (
        linked_routers(tmp_path) as routers,
        open_session(Role.AGENT, routers) as agent,
        open_session(Role.SERVICE, routers[1:]) as service,
        subscribe(service, STATE, plain.append),
        declare_recovering_subscriber(service, ALL_STATES, recovered.append, history=10),
        declare_cached_publisher(agent, STATE, ENCODING, cache=2000) as publisher,
    ):
        wait_until(lambda: len(list(agent.info.routers_zid())) == 2)
        numbers = iter(range(10_000))
        # From the first double on, both ways are in use.
        wait_until(
            lambda: len(plain) > len({sample.payload for sample in plain}),
            meanwhile=lambda: put_numbers(publisher, [next(numbers)]),
        )
        put_numbers(publisher, range(10_000, 10_020))
        wait_until(lambda: recovered and recovered[-1].payload == b"10019")
        asked = numbers_of(cached(service, 2000))
    heard = numbers_of(recovered)
    assert len(heard) == len(set(heard))
    assert asked[-20:] == heard[-20:] == list(range(10_000, 10_020))
    assert len(asked) == len(set(asked))


def test_without_history_a_silent_publisher_sends_its_whole_cache(agent: zenoh.Session, service: zenoh.Session) -> None:
    received: list[Received] = []
    with declare_cached_publisher(agent, STATE, ENCODING, cache=50, heartbeat=0.2) as publisher:
        put_numbers(publisher, range(50))
        wait_until(lambda: len(cached(service, 100)) == 50)
        with declare_recovering_subscriber(service, ALL_STATES, received.append, history=0):
            wait_until(lambda: len(received) == 50)
    assert numbers_of(received) == list(range(50))


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
