"""Caches, recovery and liveliness over a real router; each pitfall of Zenoh hidden here has its test."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
import zenoh
from zenoh import ext

from fleet_bus.codec import check_encoding
from fleet_bus.errors import MessageError
from fleet_bus.pubsub import (
    CachedPublisher,
    Received,
    declare_cached_publisher,
    declare_recovering_subscriber,
    query_cache,
    subscribe,
)
from fleet_bus.router import Router
from fleet_bus.sessions import Role, open_session
from tests.fleet_bus.publishing import ALL_STATES, ENCODING, STATE, cached, numbers_of, publishing, put_numbers
from tests.waiting import DEADLINE, wait_until

pytestmark = pytest.mark.integration


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


@contextmanager
def outage(
    received: list[Received], cache: int, heartbeat: float = 1.0
) -> Iterator[tuple[tuple[str, ...], zenoh.Session, CachedPublisher]]:
    """A publisher and a recovering subscriber whose router has gone once the first number had ``received``: where the
    router was, the publisher's session, and the publisher."""
    with ExitStack() as opened:
        with Router(["tcp/127.0.0.1:0"]) as first:
            endpoints = first.endpoints
            service = opened.enter_context(open_session(Role.SERVICE, endpoints))
            agent = opened.enter_context(open_session(Role.AGENT, endpoints))
            opened.enter_context(declare_recovering_subscriber(service, ALL_STATES, received.append, history=10))
            publisher = opened.enter_context(
                declare_cached_publisher(agent, STATE, ENCODING, cache=cache, heartbeat=heartbeat)
            )
            wait_until(lambda: received, meanwhile=lambda: publisher.put(b"-1"))
        yield endpoints, agent, publisher


def test_a_gap_of_a_router_outage_is_filled_in_order_once() -> None:
    received: list[Received] = []
    with outage(received, cache=1000) as (endpoints, _, publisher), publishing(publisher) as put:
        wait_until(lambda: len(put) > 100)
        gap = len(put)
        with Router(endpoints):
            wait_until(lambda: numbers_of(received)[-1] > gap)
    numbers = [number for number in numbers_of(received) if number >= 0]
    assert numbers == list(range(len(numbers)))


def test_what_was_put_last_before_falling_silent_in_an_outage_arrives() -> None:
    received: list[Received] = []
    with outage(received, cache=100, heartbeat=0.2) as (endpoints, agent, publisher):
        wait_until(lambda: not list(agent.info.routers_zid()))
        put_numbers(publisher, range(30))
        never = threading.Event()
        # Longer than a heartbeat, so that one announces the last sample to nobody.
        never.wait(0.5)
        with Router(endpoints):
            wait_until(lambda: numbers_of(received)[-30:] == list(range(30)))


def test_a_gap_longer_than_the_cache_begins_again_where_the_cache_does() -> None:
    received: list[Received] = []
    with outage(received, cache=40, heartbeat=0.2) as (endpoints, agent, publisher):
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
