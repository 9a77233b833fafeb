"""Counts by size agree with counting one by one, and what is read belongs together."""

import threading

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fleet_bus.histogram import Histogram

BOUNDS = (0.0, 0.5, 1.0, 10.0)


@given(st.lists(st.lists(st.sampled_from([-1.0, 0.0, 0.25, 0.5, 0.75, 1.0, 10.0, 11.0]))))
def test_it_counts_as_one_by_one(batches: list[list[float]]) -> None:
    counted = Histogram(BOUNDS)
    for batch in batches:
        counted.add(batch)
    values = [value for batch in batches for value in batch]
    counts, total = counted.read()
    assert counts == [sum(value <= bound for value in values) for bound in (*BOUNDS, np.inf)]
    assert total == sum(values)


def test_one_number_will_do() -> None:
    counted = Histogram(BOUNDS)
    counted.add(0.7)
    assert counted.read() == ([0, 0, 1, 1, 1], 0.7)


def test_what_another_thread_reads_belongs_together() -> None:
    counted, done, torn = Histogram(BOUNDS), threading.Event(), []

    def read() -> None:
        while not done.is_set():
            counts, total = counted.read()
            if total != counts[-1]:
                torn.append((counts, total))

    reader = threading.Thread(target=read)
    reader.start()
    for _ in range(2000):
        counted.add(np.ones(3))
    done.set()
    reader.join()
    assert torn == []
    assert counted.read() == ([0, 0, 6000, 6000, 6000], 6000.0)
