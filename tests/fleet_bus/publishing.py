"""Numbers as payloads, put and received."""

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import zenoh

from fleet_bus.pubsub import (
    CachedPublisher,
    Received,
    query_cache,
)
from tests.waiting import DEADLINE

STATE = "fleet/a/state"
ALL_STATES = "fleet/*/state"
ENCODING = "application/msgpack;fleet.state.v1"


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
